"""All edges of a graph as one table: ties to previous keyframes, then loops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import params
from ..geometry import poses
from .graph import Pair, PoseGraph


@dataclass(frozen=True)
class Edges:
    """e edges; `i` is the earlier keyframe, in whose frame the relative pose is measured."""

    i: np.ndarray  # (e,) int64
    j: np.ndarray  # (e,) int64
    T_i_j: np.ndarray  # (e, 7) p and q wxyz
    is_loop: np.ndarray  # (e,) bool
    is_forced: np.ndarray  # (e,) bool

    def __len__(self) -> int:
        return len(self.i)

    def __getitem__(self, rows: np.ndarray) -> Edges:
        return Edges(self.i[rows], self.j[rows], self.T_i_j[rows], self.is_loop[rows], self.is_forced[rows])


def active_edges(settings: params.PoseGraph, graph: PoseGraph) -> Edges:
    """Every edge that is not disabled: odometry first, ordered by (distance in the session, keyframe), then loops."""
    i, j = sequential_pairs(graph, settings.sequential_edges)
    T_vio, n = graph.T_vio, len(i)
    pairs = np.concatenate([np.stack([i, j], 1), graph.loops])
    edges = Edges(
        pairs[:, 0],
        pairs[:, 1],
        np.concatenate([poses.between(T_vio[i], T_vio[j]), graph.T_loops]),
        np.arange(len(pairs)) >= n,
        _among(pairs, graph.forced, graph) & (np.arange(len(pairs)) >= n),
    )
    return edges[~_among(pairs, graph.disabled, graph)] if graph.disabled else edges


def sequential_pairs(graph: PoseGraph, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Every keyframe with up to `count` previous ones of its session (REFERENCE Q2): earlier and later index."""
    n, session = len(graph), graph.session
    later = [np.arange(step, n) for step in range(1, min(count, n - 1) + 1)]
    same = [j[session[j] == session[j - step]] for step, j in enumerate(later, start=1)]
    i = [j - step for step, j in enumerate(same, start=1)]
    none = [np.zeros(0, np.int64)]
    return np.concatenate(none + i), np.concatenate(none + same)


def _among(pairs: np.ndarray, chosen: frozenset[Pair], graph: PoseGraph) -> np.ndarray:
    """Which rows of (e, 2) are in the set."""
    if not chosen:
        return np.zeros(len(pairs), bool)
    n = max(len(graph), 1)
    keys = np.array(sorted(i * n + j for i, j in chosen))
    return np.isin(pairs[:, 0] * n + pairs[:, 1], keys)
