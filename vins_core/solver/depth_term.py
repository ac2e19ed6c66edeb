"""What a depth camera says of the landmarks of a window: depths that pull, and depths that are held.

A measured depth adds its information to the landmark's own diagonal (factors/depth.py), weighted by the robust loss of
the projections.  A held landmark is no variable: its row of W and its gradient vanish, so that the Schur complement
takes nothing back from what its projections say of the poses, and no step moves it.
"""

from __future__ import annotations

import numpy as np

from ..factors import depth
from ..factors.robust import Loss
from .problem import Depths, States

HELD_INFORMATION = 1e12
"""Of an inverse depth that is held, 1/(1/m)^2: what reports and covariances read."""

LandmarkPart = tuple[np.ndarray, np.ndarray, np.ndarray]
"""(W, h, g_l) of solver/linearize.py."""


class DepthTerm:
    """The index structure of one problem's depths."""

    def __init__(self, depths: Depths, loss: Loss):
        self._depths, self._loss = depths, loss
        self._batch = depth.DEPTH.batch(len(depths.landmark), ("inv_depth",))
        self._batch.data[:] = depth.measurement(depths.depth_m, depths.sigma)

    def linearize(
        self, states: States, landmarks: LandmarkPart, curved: bool = False
    ) -> tuple[float, np.ndarray, LandmarkPart]:
        """Cost, whitened residuals (K,) before the loss, and `landmarks` with what the depths add."""
        W, h, g_l = landmarks
        cost, r = 0.0, np.zeros(0)
        if len(self._depths.landmark):
            landmark, loss = self._depths.landmark, self._loss
            self._batch.inputs[0][0] = states.inv_depths[landmark]
            self._batch.evaluate()
            J, r = self._batch.system[:, 0].copy()
            s = r * r
            weight = loss.weight(s) ** 2
            bend = loss.bend(s)[1] ** 2 if curved else 1.0
            h, g_l = h.copy(), g_l.copy()
            h[landmark] += weight * bend * J * J  # each landmark has one depth at most
            g_l[landmark] += weight * J * r
            cost = 0.5 * float(np.sum(loss.rho(s)))
        if len(self._depths.held):
            W, h, g_l = W.copy(), h.copy(), g_l.copy()
            W[self._depths.held], h[self._depths.held], g_l[self._depths.held] = 0.0, HELD_INFORMATION, 0.0
        return cost, r, (W, h, g_l)
