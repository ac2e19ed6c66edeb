"""The prior of marginalised frames, linearised at the current states."""

from __future__ import annotations

import numpy as np

from ..factors import prior
from .layout import Layout
from .problem import PriorFactor, States


class PriorTerm:
    """Where the parts of one prior are among the states and columns of a problem."""

    def __init__(self, factor: PriorFactor, layout: Layout):
        self._factor = factor
        blocks = factor.blocks
        starts = np.cumsum([0] + [b.size for b in blocks])
        poses = [k for k, b in enumerate(blocks) if b.kind in ("pose", "extrinsic")]
        speeds = [k for k, b in enumerate(blocks) if b.kind == "speed_bias"]
        offsets = [k for k, b in enumerate(blocks) if b.kind == "td"]
        # rows of the table (poses, extrinsics), and of the speed-biases
        self._pose_rows = [
            b.slot + (layout.n_poses if b.kind == "extrinsic" else 0) for b in (blocks[k] for k in poses)
        ]
        self._speed_rows = [blocks[k].slot for k in speeds]
        self._x0_poses = np.array([factor.x0[k] for k in poses]).reshape(-1, 7)
        self._x0_speeds = np.array([factor.x0[k] for k in speeds]).reshape(-1, 9)
        self._pose_columns = starts[poses][:, None] + np.arange(6)
        self._speed_columns = starts[speeds][:, None] + np.arange(9)
        self._td_columns, self._x0_td = starts[offsets], np.array([factor.x0[k][0] for k in offsets])

        # only the columns of rotations change with the states
        free = np.repeat([layout.is_free(b) for b in blocks], [b.size for b in blocks])
        self._turning = np.flatnonzero(free[self._pose_columns[:, 3]])
        theta = self._pose_columns[self._turning, 3:]
        self._J_theta = factor.J[:, theta].transpose(1, 0, 2)  # (turning, n, 3)
        self._theta = (np.cumsum(free) - 1)[theta]
        self._system = np.empty((len(factor.J), free.sum() + 1))
        self._system[:, :-1] = factor.J[:, free]
        self.columns = layout.columns_of([b for b in blocks if layout.is_free(b)])[None]  # (1, free)

    def rows(self, states: States) -> tuple[np.ndarray, np.ndarray]:
        """Residual (n,) and its Jacobian in the free columns (n, free); buffers, valid until the next call."""
        system = self._evaluate(states)
        return system[:, -1], system[:, :-1]

    def linearize(self, states: States, products: np.ndarray) -> tuple[float, np.ndarray]:
        """Fills [J r]' [J r], (1, free + 1, free + 1); returns cost and residual (n,)."""
        system = self._evaluate(states)
        np.dot(system.T, system, products[0])
        r = system[:, -1].copy()
        return 0.5 * float(r @ r), r

    def _evaluate(self, states: States) -> np.ndarray:
        """[J r], (n, free + 1)."""
        J0, system = self._factor.J, self._system
        poses = np.concatenate([states.poses, states.extrinsics])[self._pose_rows]
        d = prior.difference_poses(poses, self._x0_poses)
        dx = np.empty(J0.shape[1])
        dx[self._pose_columns] = d
        dx[self._speed_columns] = states.speed_biases[self._speed_rows] - self._x0_speeds
        if len(self._td_columns):
            dx[self._td_columns] = states.td_s - self._x0_td
        J_theta = self._J_theta @ prior.inverse_right_jacobian(d[self._turning, 3:])
        system[:, self._theta] = J_theta.transpose(1, 0, 2)
        system[:, -1] = self._factor.r + J0 @ dx
        return system
