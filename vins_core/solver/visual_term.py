"""All projections of a window, linearised together.

Projections are sorted by (anchor, observer).  Within such a pair every row of J has the same camera columns, so the
pair adds one small J'J to H: for 1300 projections of 11 frames some fifty products of 12 x 12 instead of one of
66 x 66 whose rows are mostly zero.  Landmark sums run over the rows of each landmark (visual_rows.py).
"""

from __future__ import annotations

import numpy as np

from ..factors import reprojection
from . import backend
from .layout import Layout
from .problem import States, WindowProblem
from .visual_rows import RowIndex


class VisualTerm:
    """The index structure of one problem's projections."""

    def __init__(self, problem: WindowProblem, layout: Layout):
        order = np.lexsort((problem.projections.observer, problem.projections.anchor))
        table = problem.projections[order]
        n = len(table)
        new_pair = np.diff(table.anchor * layout.n_poses + table.observer, prepend=-1) != 0
        first = np.flatnonzero(new_pair)
        length = np.diff(first, append=n)
        self.pair = pair = np.repeat(np.arange(len(first)), length)  # (N,) row of `columns`

        blocks = [layout.columns("pose", table.anchor[first]), layout.columns("pose", table.observer[first])]
        if layout.n_extrinsics:
            blocks.append(layout.columns("extrinsic", np.full(len(first), table.camera)))
        self.columns = np.concatenate(blocks, 1)  # (pairs, c)

        # both rows of every projection of a pair below each other: one matrix a pair
        place = first[pair] + np.arange(n)
        self.index = RowIndex(
            table,
            reprojection.FACTORS[problem.residual],
            reprojection.measurement(problem.residual, table.rays_i, table.rays_j, problem.sqrt_info),
            problem.loss,
            row=order,
            place=np.stack([place, place + length[pair]]),
            start=np.stack([block[pair, 0] for block in blocks]),
            n_landmarks=problem.n_landmarks,
            width=layout.visual,
        )
        self._rows = backend.current().rows(self.index)
        pairs = [self._rows.packed[2 * a : 2 * (a + k)] for a, k in zip(first.tolist(), length.tolist())]
        self._pairs = [(Jr.T, Jr) for Jr in pairs]

    def linearize(
        self, states: States, products: np.ndarray, curved: bool
    ) -> tuple[float, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Fills [J r]' [J r] of every pair, (pairs, c + 1, c + 1); returns cost, residuals (2, N) and (W, h, g_l)."""
        rows = self._rows.evaluate(states, curved)
        for (Jr_t, Jr), product in zip(self._pairs, products):
            np.dot(Jr_t, Jr, product)
        with np.errstate(all="ignore"):
            cost = 0.5 * float(self.index.loss.rho(rows.squared).sum())
        return cost, rows.residuals, (rows.W, rows.h, rows.g_l)
