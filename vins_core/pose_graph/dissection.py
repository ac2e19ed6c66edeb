"""Nested dissection: in which order to eliminate keyframes, so that little fills in.

A set of keyframes is cut in two halves of equal size, at the median of the coordinate (x, y, z or time) that is cut by
the fewest edges.  The ends of these edges on one side separate the halves; they are eliminated last, so neither half
fills in the other, and each is cut further.  Loops join what is near in space and odometry what is near in time,
which is why cuts through space and time are cheap.

The tree of separators is the tree of a multifrontal factorisation (cholesky.py): each is a `Front`.  With it the
factor of 10,000 keyframes and 2,000 loops takes half the operations of minimum degree, whose tree would have to be
found first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

LEAF = 40
"""Sets that small are eliminated together: a dense front of them costs less than a further cut."""


@dataclass(frozen=True)
class Front:
    """Nodes eliminated together, and the later ones that they touch by then."""

    own: np.ndarray  # (s,) int64
    border: np.ndarray  # (u,) int64, in order of elimination
    children: tuple[int, ...]  # fronts whose border is among own and border


def dissect(i: np.ndarray, j: np.ndarray, coordinates: np.ndarray) -> tuple[Front, ...]:
    """Fronts in order of elimination for n nodes at `coordinates` (n, c) and edges (i, j)."""
    parts: list[tuple[np.ndarray, tuple[int, ...]]] = []
    side = np.empty(len(coordinates), np.int8)

    def split(nodes: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[int, ...]:
        """Append the fronts of `nodes`, whose edges are (i, j); returns the roots of their trees."""
        children: tuple[int, ...] = ()
        if len(nodes) > LEAF:
            left, separator = _best_cut(nodes, i, j, coordinates, side)
            side[nodes], side[left], side[separator] = 1, 0, 2
            halves = []
            for k in (0, 1):
                inside = (side[i] == k) & (side[j] == k)
                halves.append((nodes[side[nodes] == k], i[inside], j[inside]))
            children = sum((split(*half) for half in halves), ())
            nodes = separator
        if not len(nodes):
            return children
        parts.append((nodes, children))
        return (len(parts) - 1,)

    split(np.arange(len(coordinates)), i, j)
    return _with_borders(parts, i, j)


def _best_cut(
    nodes: np.ndarray, i: np.ndarray, j: np.ndarray, coordinates: np.ndarray, side: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(left half, separator) of the coordinate whose separator is smallest."""
    best: tuple[np.ndarray, np.ndarray] | None = None
    half = len(nodes) // 2
    for values in coordinates[nodes].T:
        left = nodes[np.argpartition(values, half)[:half]]
        side[nodes], side[left] = 1, 0
        cut = np.flatnonzero(side[i] != side[j])
        i_is_left = side[i[cut]] == 0
        ends = (
            np.unique(np.where(i_is_left, i[cut], j[cut])),
            np.unique(np.where(i_is_left, j[cut], i[cut])),
        )
        separator = min(ends, key=len)
        if best is None or len(separator) < len(best[1]):
            best = left, separator
    assert best is not None
    return best


def _with_borders(parts: list[tuple[np.ndarray, tuple[int, ...]]], i: np.ndarray, j: np.ndarray) -> tuple[Front, ...]:
    if not parts:
        return ()
    order = np.concatenate([own for own, _ in parts])
    n = len(order)
    turn = np.empty(n, np.int64)
    turn[order] = np.arange(n)
    links = sp.csr_matrix((np.ones(2 * len(i), np.int8), (np.concatenate([i, j]), np.concatenate([j, i]))), (n, n))
    fronts: list[Front] = []
    last = -1
    for own, children in parts:
        last += len(own)
        touched = np.concatenate([links[own].indices, *(fronts[c].border for c in children)])
        turns = np.unique(turn[touched])
        fronts.append(Front(own, order[turns[turns > last]], children))
    return tuple(fronts)
