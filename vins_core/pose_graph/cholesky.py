"""Sparse Cholesky factorisation by dense fronts (Duff and Reid's multifrontal method), in NumPy and LAPACK.

Each front F gathers what H and its children say about its own nodes (1) and its border (2), then

    L_11 L_11' = F_11,     L_21 = F_21 L_11'^-1,     F_22 - L_21 L_21'  goes to the front that eliminates the border

All arithmetic happens in dense matrices of some hundred columns, where BLAS is at its best; the price is a fixed
cost per front, so the fronts must not be tiny (dissection.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, lapack

from .dissection import Front


@dataclass(frozen=True)
class _Plan:
    """One front in scalars: nodes times columns a node."""

    own: np.ndarray  # rows of the unknown vector that are eliminated here
    border: np.ndarray  # rows that are updated
    source: np.ndarray  # entries of the values of H ...
    target: np.ndarray  # ... and where they go in the front, column by column
    children: tuple[tuple[int, np.ndarray], ...]  # front, and the rows of this one that its border is


class BlockCholesky:
    """Solves H x = b for matrices with one pattern of square blocks.

    n nodes with `size` columns each; H has the n diagonal blocks and the blocks (i_k, j_k) with their transposes,
    each pair at most once.
    """

    def __init__(self, fronts: tuple[Front, ...], i: np.ndarray, j: np.ndarray, size: int):
        self._plans = _plan(fronts, i, j, size)
        self._factors: list[tuple[np.ndarray, np.ndarray]] = []

    def factorize(self, diagonal: np.ndarray, off_diagonal: np.ndarray) -> bool:
        """Blocks (n, size, size) and (k, size, size); False when H is not positive definite."""
        values = np.concatenate([diagonal.ravel(), off_diagonal.ravel()])
        self._factors = []
        updates: dict[int, np.ndarray] = {}
        for number, plan in enumerate(self._plans):
            s = len(plan.own)
            width = s + len(plan.border)
            entries = np.zeros(width * width)
            entries[plan.target] = values[plan.source]
            F = entries.reshape(width, width, order="F")  # only the lower triangle means anything
            for child, rows in plan.children:
                entries[(rows[:, None] * width + rows).ravel()] += updates.pop(child).ravel(order="F")
            L11, failed = lapack.dpotrf(F[:s, :s], lower=1)
            if failed:
                self._factors = []
                return False
            L21 = np.zeros((0, s))
            if len(plan.border):
                L21 = blas.dtrsm(1.0, L11, F[s:, :s], side=1, lower=1, trans_a=1)
                updates[number] = blas.dsyrk(-1.0, L21, beta=1.0, c=F[s:, s:], lower=1)
            self._factors.append((L11, L21))
        return True

    def solve(self, b: np.ndarray) -> np.ndarray:
        """x of the last factorised H, for b (n, size)."""
        x = b.reshape(-1).copy()
        for plan, (L11, L21) in zip(self._plans, self._factors, strict=True):
            y = blas.dtrsv(L11, x[plan.own], lower=1)
            x[plan.own] = y
            x[plan.border] -= L21 @ y
        for plan, (L11, L21) in zip(reversed(self._plans), reversed(self._factors), strict=True):
            x[plan.own] = blas.dtrsv(L11, x[plan.own] - x[plan.border] @ L21, lower=1, trans=1)
        return x.reshape(b.shape)


def _plan(fronts: tuple[Front, ...], i: np.ndarray, j: np.ndarray, size: int) -> list[_Plan]:
    n = sum(len(f.own) for f in fronts)
    turn, front_of = np.empty(n, np.int64), np.empty(n, np.int64)
    first = 0
    for number, front in enumerate(fronts):
        turn[front.own] = first + np.arange(len(front.own))
        front_of[front.own] = number
        first += len(front.own)
    # a block is entered where its earlier node is eliminated, below the diagonal: (later, earlier)
    row, column = np.concatenate([np.arange(n), i]), np.concatenate([np.arange(n), j])
    swap = turn[row] < turn[column]
    later, earlier = np.where(swap, column, row), np.where(swap, row, column)
    order = np.argsort(front_of[earlier], kind="stable")
    ends = np.searchsorted(front_of[earlier][order], np.arange(len(fronts) + 1))

    a, b = np.divmod(np.arange(size * size), size)  # row and column inside a block of H
    local = np.full(n, -1)
    plans = []
    for number, front in enumerate(fronts):
        nodes = np.concatenate([front.own, front.border])
        local[nodes] = np.arange(len(nodes))
        width = len(nodes) * size
        blocks = order[ends[number] : ends[number + 1]]
        r, c, flip = local[later[blocks], None], local[earlier[blocks], None], swap[blocks, None]
        target = (c * size + np.where(flip, a, b)) * width + r * size + np.where(flip, b, a)
        plans.append(
            _Plan(
                _scalars(front.own, size),
                _scalars(front.border, size),
                (blocks[:, None] * size * size + np.arange(size * size)).ravel(),
                target.ravel(),
                tuple(
                    (child, _scalars(local[fronts[child].border], size))
                    for child in front.children
                    if len(fronts[child].border)
                ),
            )
        )
    return plans


def _scalars(nodes: np.ndarray, size: int) -> np.ndarray:
    return (nodes[:, None] * size + np.arange(size)).ravel()
