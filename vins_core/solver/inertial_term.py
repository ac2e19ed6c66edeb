"""All IMU factors of a window, linearised together."""

from __future__ import annotations

import numpy as np

from ..factors import imu
from .layout import Layout
from .problem import States, WindowProblem


class InertialTerm:
    """The index structure of one problem's IMU factors."""

    def __init__(self, problem: WindowProblem, layout: Layout):
        slots, motions = zip(*problem.imu)
        self._first = first = np.array(slots)
        self._batch = imu.IMU.batch(len(motions), imu.ACTIVE, backend="vm")
        self._batch.data[:] = imu.measurement(motions, problem.gravity_m_s2)
        self._whitening = np.stack([motion.whitening for motion in motions])
        blocks = [layout.columns(kind, k) for k in (first, first + 1) for kind in ("pose", "speed_bias")]
        self.columns = np.concatenate(blocks, 1)  # (K, 30)

    def rows(self, states: States) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals (K, 15) and Jacobians (K, 15, 30)."""
        whitened = self._evaluate(states)
        return whitened[:, :, -1], whitened[:, :, :-1]

    def linearize(self, states: States, products: np.ndarray) -> tuple[float, np.ndarray]:
        """Fills [J r]' [J r] of every factor, (K, 31, 31); returns cost and whitened residuals (K, 15)."""
        whitened = self._evaluate(states)
        np.matmul(whitened.transpose(0, 2, 1), whitened, products)
        r = whitened[:, :, -1]
        return 0.5 * float(np.vdot(r, r)), r

    def _evaluate(self, states: States) -> np.ndarray:
        """[J r], whitened, (K, 15, 31)."""
        batch, first = self._batch, self._first
        batch.inputs[0].T[:] = states.poses[first]
        batch.inputs[1].T[:] = states.speed_biases[first]
        batch.inputs[2].T[:] = states.poses[first + 1]
        batch.inputs[3].T[:] = states.speed_biases[first + 1]
        batch.evaluate()
        return self._whitening @ batch.system.transpose(2, 1, 0)
