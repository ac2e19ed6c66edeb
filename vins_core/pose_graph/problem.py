"""The graph as a least-squares problem: which keyframes may move, which edges pull at them and how hard.

    cost(x) = sum_e  v_e^2 rho_e(|w_e r_e(x)|^2) / 2

with rho the robust loss on loops that were not forced.  The weight of a loop stands in w, where the loss sees it, or
in v, where it does not (`pose_graph.loss_on`).

Position and turn of a connected part of the graph as a whole cannot be measured, so its earliest looped keyframe is
held, with all before it, and so are base sessions, which were optimised when their map was made (REFERENCE Q1).
Keyframes after the last loop of their session follow it rigidly and need no optimisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from .. import params
from ..factors.robust import Loss
from .edges import Edges, active_edges
from .graph import PoseGraph
from .variants import VARIANTS, Variant


@dataclass(frozen=True)
class Problem:
    variant: Variant
    nodes: np.ndarray  # (n, size) of all keyframes at the start
    free: np.ndarray  # (m,) int64 keyframes that may move, increasing
    edges: Edges  # those that pull at a free keyframe
    data: np.ndarray  # (n_data, e) of the variant's factor, with w_e
    outer: np.ndarray  # (e,) v_e
    robust: np.ndarray  # (e,) bool: the loss applies
    loss: Loss


def assemble(settings: params.PoseGraph, graph: PoseGraph) -> Problem:
    """The problem of optimising `graph` from where it is."""
    edges = active_edges(settings, graph)
    free = free_keyframes(graph, edges)
    may_move = np.zeros(len(graph), bool)
    may_move[free] = True
    pulls = may_move[edges.j] | (may_move[edges.i] & edges.is_loop)  # what only follows does not pull
    return pose_problem(settings, graph, edges[pulls], free)


def pose_problem(settings: params.PoseGraph, graph: PoseGraph, edges: Edges, free: np.ndarray) -> Problem:
    """The problem of given edges and free keyframes."""
    variant = VARIANTS[settings.dof]
    nodes = variant.nodes(graph.T_corrected, graph.T_vio)
    loop = np.where(edges.is_loop, settings.loop_weight, 1.0)
    inner, outer = (loop, np.ones_like(loop)) if settings.loss_on == "weighted" else (np.ones_like(loop), loop)
    w_p = inner / settings.sigma_m
    w_r = inner / np.deg2rad(settings.sigma_deg) * np.where(edges.is_loop, settings.loop_rotation_weight, 1.0)
    return Problem(
        variant,
        nodes,
        free,
        edges,
        variant.measurement(edges, nodes, graph.T_vio, w_p, w_r),
        outer,
        edges.is_loop & ~edges.is_forced,
        Loss(settings.loss, settings.loss_scale),
    )


def free_keyframes(graph: PoseGraph, edges: Edges) -> np.ndarray:
    """Keyframes between the earliest loop of their connected part and the last loop of their session, (m,)."""
    n = len(graph)
    loops = np.stack([edges.i, edges.j], 1)[edges.is_loop]
    if not len(loops):
        return np.zeros(0, np.int64)
    links = sp.coo_matrix((np.ones(len(edges), np.int8), (edges.i, edges.j)), shape=(n, n))
    _, part = connected_components(links, directed=False)
    earliest = np.full(part.max() + 1, n)
    np.minimum.at(earliest, part[loops.ravel()], loops.ravel())
    latest = np.full(len(graph.sessions), -1)
    np.maximum.at(latest, graph.session[loops.ravel()], loops.ravel())
    base = np.array([s.base for s in graph.sessions])
    k = np.arange(n)
    return np.flatnonzero((k > earliest[part]) & (k <= latest[graph.session]) & ~base[graph.session])
