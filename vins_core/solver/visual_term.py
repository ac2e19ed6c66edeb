"""All projections of a window, linearised together.

Projections are sorted by (anchor, observer).  Within such a pair every row of J has the same camera columns, so the
pair adds one small J'J to H: for 1300 projections of 11 frames some fifty products of 12 x 12 instead of one of
66 x 66 whose rows are mostly zero.  Landmark sums run over the rows of each landmark.
"""

from __future__ import annotations

import numpy as np

from ..factors import reprojection
from .layout import Layout
from .problem import States, WindowProblem


class VisualTerm:
    """The index structure of one problem's projections."""

    def __init__(self, problem: WindowProblem, layout: Layout):
        self._loss = problem.loss
        order = np.lexsort((problem.projections.observer, problem.projections.anchor))
        self._order = order
        self.table = table = problem.projections[order]
        n = len(table)
        extrinsic = ("extrinsic",) if layout.n_extrinsics else ()
        factor = reprojection.FACTORS[problem.residual]
        self._batch = factor.batch(n, ("pose_i", "pose_j", *extrinsic, "inv_depth"), uniform=("extrinsic",))
        self._batch.data[:] = reprojection.measurement(problem.residual, table.rays_i, table.rays_j, problem.sqrt_info)

        new_pair = np.diff(table.anchor * layout.n_frames + table.observer, prepend=-1) != 0
        first = np.flatnonzero(new_pair)
        length = np.diff(first, append=n)
        self.pair = pair = np.repeat(np.arange(len(first)), length)  # (N,) row of `columns`
        blocks = [layout.columns("pose", table.anchor[first]), layout.columns("pose", table.observer[first])]
        if layout.n_extrinsics:
            blocks.append(layout.columns("extrinsic", np.full(len(first), table.camera)))
        self.columns = np.concatenate(blocks, 1)  # (pairs, c)

        # both rows of every factor of a pair side by side: the lanes of the pair's product
        c = self.columns.shape[1]
        self._lanes = np.empty(2 * n, np.int64)
        self._lanes[first[pair] + np.arange(n)] = np.arange(n)
        self._lanes[(first + length)[pair] + np.arange(n)] = n + np.arange(n)
        self._packed = np.empty((c + 1, 2 * n))
        self._products = np.empty((len(first), c + 1, c + 1))
        ends = zip((2 * first).tolist(), (2 * (first + length)).tolist())
        views = (self._packed[:, a:b] for a, b in ends)
        self._pairs = [(lanes, lanes.T, out) for lanes, out in zip(views, self._products)]

        self._in_W = table.landmark * layout.visual + self.columns.T[:, pair]  # (c, N)
        self._W_shape = (problem.n_landmarks, layout.visual)

    def rows(self, states: States) -> tuple[np.ndarray, np.ndarray, float]:
        """[J r] of every projection with the robust weight, (c + 2, 2, N); r without it (2, N); the cost.

        The last two columns are the inverse depth and the residual; the others belong to `columns[pair]`.
        The first array is a buffer: valid until the next call.
        """
        table, batch, loss = self.table, self._batch, self._loss
        poses = np.ascontiguousarray(states.poses.T)
        poses.take(table.anchor, 1, batch.inputs[0], "clip")
        poses.take(table.observer, 1, batch.inputs[1], "clip")
        batch.inputs[2][:] = states.extrinsics[table.camera]
        states.inv_depths.take(table.landmark, 0, batch.inputs[3][0], "clip")
        system = batch.system
        with np.errstate(all="ignore"):  # a point in the camera's plane gives no finite cost, and the step is rejected
            batch.evaluate()
            r = system[-1].copy()
            s = r[0] * r[0] + r[1] * r[1]
            system *= loss.weight(s)
            return system, r, 0.5 * float(loss.rho(s).sum())

    def linearize(
        self, states: States, JtJ: np.ndarray, Jtr: np.ndarray
    ) -> tuple[float, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Fills J'J and J'r of every pair, (pairs, c, c) and (pairs, c); returns cost, residuals, (W, h, g_l)."""
        system, unweighted, cost = self.rows(states)
        residuals = np.empty_like(unweighted)
        residuals[:, self._order] = unweighted
        c = len(system) - 2
        camera, depth, r, packed = system[:c], system[c], system[c + 1], self._packed
        camera.reshape(c, -1).take(self._lanes, 1, packed[:c], "clip")
        r.reshape(-1).take(self._lanes, 0, packed[c], "clip")
        for lanes, lanes_t, out in self._pairs:
            np.dot(lanes, lanes_t, out)
        JtJ[:] = self._products[:, :c, :c]
        Jtr[:] = self._products[:, c, :c]

        m, P = self._W_shape
        landmark = self.table.landmark
        coupling = camera[:, 0] * depth[0] + camera[:, 1] * depth[1]
        W = np.bincount(self._in_W.reshape(-1), coupling.reshape(-1), m * P).reshape(m, P)
        h = np.bincount(landmark, depth[0] * depth[0] + depth[1] * depth[1], m)
        g_l = np.bincount(landmark, depth[0] * r[0] + depth[1] * r[1], m)
        return cost, residuals, (W, h, g_l)
