"""All projections of one kind in a window, linearised together.

Projections are sorted by (anchor, observer).  Within such a pair every row of J has the same camera columns, so the
pair adds one small J'J to H: for 1300 projections of 11 frames some fifty products of 12 x 12 instead of one of
66 x 66 whose rows are mostly zero.  Landmark sums run over the rows of each landmark (visual_rows.py).
"""

from __future__ import annotations

import numpy as np

from ..factors import reprojection
from . import backend
from .layout import Layout
from .problem import Projections, States, WindowProblem
from .visual_rows import RowIndex

VisualResult = tuple[float, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Cost, residuals (2, N), and (W, h, g_l)."""


class VisualTerm:
    """The index structure of one of the problem's tables of projections."""

    def __init__(self, problem: WindowProblem, layout: Layout, table: Projections):
        order = np.lexsort((table.observer, table.anchor))
        table = table[order]
        n = len(table)
        pairs_in_order = table.anchor * layout.n_poses + table.observer
        if table.kind == "same":  # the same columns for all, whatever the frame
            pairs_in_order = np.zeros_like(pairs_in_order)
        new_pair = np.diff(pairs_in_order, prepend=-1) != 0
        first = np.flatnonzero(new_pair)
        length = np.diff(first, append=n)
        self.pair = pair = np.repeat(np.arange(len(first)), length)  # (N,) row of `columns`

        blocks = []
        if table.kind != "same":
            blocks += [layout.columns("pose", table.anchor[first]), layout.columns("pose", table.observer[first])]
        if layout.n_extrinsics:
            cameras = (table.camera,) if table.kind == "mono" else (table.camera, table.seen_by)
            blocks += [layout.columns("extrinsic", np.full(len(first), camera)) for camera in cameras]
        if layout.n_td:
            blocks.append(layout.columns("td", np.zeros(len(first), np.int64)))
        none = np.zeros((len(first), 0), np.int64)
        self.columns = np.concatenate(blocks, 1) if blocks else none  # (pairs, c)

        # both rows of every projection of a pair below each other: one matrix a pair
        place = first[pair] + np.arange(n)
        self.index = RowIndex(
            table,
            (reprojection.TIMED if layout.n_td else reprojection.KINDS)[table.kind][problem.residual],
            _measurement(problem, table, timed=layout.n_td > 0),
            problem.loss,
            row=order,
            place=np.stack([place, place + length[pair]]),
            start=np.array([block[pair, 0] for block in blocks], np.int64).reshape(-1, n),
            n_landmarks=problem.n_landmarks,
            width=layout.visual,
        )
        self._rows = backend.current().rows(self.index)
        pairs = [self._rows.packed[2 * a : 2 * (a + k)] for a, k in zip(first.tolist(), length.tolist())]
        self._pairs = [(Jr.T, Jr) for Jr in pairs]

    def linearize(self, states: States, products: np.ndarray, curved: bool) -> VisualResult:
        """Fills [J r]' [J r] of every pair, (pairs, c + 1, c + 1); returns cost, residuals (2, N) and (W, h, g_l)."""
        rows = self._rows.evaluate(states, curved)
        for (Jr_t, Jr), product in zip(self._pairs, products):
            np.dot(Jr_t, Jr, product)
        with np.errstate(all="ignore"):
            cost = 0.5 * float(self.index.loss.rho(rows.squared).sum())
        return cost, rows.residuals, (rows.W, rows.h, rows.g_l)


def _measurement(problem: WindowProblem, table: Projections, timed: bool) -> np.ndarray:
    """The data of the factor, (n_data, N)."""
    data = reprojection.measurement(problem.residual, table.rays_i, table.rays_j, problem.sqrt_info)
    if not timed:
        return data
    assert table.motion is not None
    seen = table.rays_i, table.rays_j, table.motion.velocity_i, table.motion.velocity_j
    moving = reprojection.motion(problem.residual, *seen, table.motion.td_s, problem.sqrt_info)
    return np.concatenate([data, moving])
