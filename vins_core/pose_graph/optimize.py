"""One optimisation of the pose graph, and what its edges say about it.

`optimize` reads nothing but its arguments, so it may run beside the frames; `graph.adopt` brings its result to a
graph that has grown meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import params
from ..geometry import poses
from ..report import GraphCost, IterationReport, PoseGraphReport
from . import levenberg_marquardt
from .edges import Edges, active_edges
from .graph import PoseGraph, frozen
from .linearize import Linearizer
from .problem import Problem, assemble, pose_problem


@dataclass(frozen=True)
class EdgeErrors:
    """What edges say about a graph as it is."""

    edges: Edges
    error_m: np.ndarray  # (e,) distance between measured and estimated relative position
    error_deg: np.ndarray  # (e,) same of the rotation; about gravity with 4 DoF
    weight: np.ndarray  # (e,) rho': 1 = counts in full, 0 = ignored
    cost: GraphCost


def optimize(settings: params.PoseGraph, graph: PoseGraph) -> tuple[PoseGraph, PoseGraphReport]:
    """Distribute what the loops say over the keyframes between them (seed 000.4, REFERENCE 17).

    The drift of a session becomes the correction of its last looped keyframe; later ones follow it.  Without loops
    the graph stays as it is.
    """
    problem = assemble(settings, graph)
    if not len(problem.free):
        return graph, _report(settings, graph, graph, problem, GraphCost(), GraphCost(), (), "not started: no loops")
    last = levenberg_marquardt.solve(settings, problem)
    optimized = with_nodes(graph, problem, last.nodes)
    why = levenberg_marquardt.terminate(settings, last) or ""
    return optimized, _report(settings, graph, optimized, problem, last.before, last.system.cost, last.reports, why)


def evaluate(settings: params.PoseGraph, graph: PoseGraph, edges: Edges | None = None) -> EdgeErrors:
    """Errors and weights of `edges` (all active ones), without moving anything."""
    edges = active_edges(settings, graph) if edges is None else edges
    problem = pose_problem(settings, graph, edges, np.zeros(0, np.int64))
    linearizer = Linearizer(problem)
    r = linearizer.residuals(problem.nodes)
    w_p, w_r = problem.data[-2:]
    return EdgeErrors(
        edges,
        np.linalg.norm(r[:3], axis=0) / w_p,
        np.rad2deg(np.linalg.norm(r[3:], axis=0) / w_r),
        linearizer.weights(r),
        linearizer.cost(r),
    )


def with_nodes(graph: PoseGraph, problem: Problem, nodes: np.ndarray) -> PoseGraph:
    """`graph` with the free keyframes of `problem` at `nodes` (n, size), later ones of their sessions following."""
    free, T_vio, session = problem.free, graph.T_vio, graph.session
    T_g_b = graph.T_corrected.copy()
    T_g_b[free] = problem.variant.poses(nodes[free], T_vio[free])
    sessions = list(graph.sessions)
    for number in np.unique(session[free]):
        last = free[session[free] == number][-1]
        drift = frozen(poses.correction(T_g_b[last], T_vio[last]))
        sessions[number] = replace(sessions[number], drift=drift)
        rest = last + 1 + np.flatnonzero(session[last + 1 :] == number)
        T_g_b[rest] = poses.compose(drift, T_vio[rest])
    return replace(graph, optimized=frozen(T_g_b), sessions=tuple(sessions))


def _report(
    settings: params.PoseGraph,
    graph: PoseGraph,
    optimized: PoseGraph,
    problem: Problem,
    before: GraphCost,
    after: GraphCost,
    iterations: tuple[IterationReport, ...],
    termination: str,
) -> PoseGraphReport:
    edges = active_edges(settings, graph)
    loops = edges[edges.is_loop]
    said = evaluate(settings, graph, loops), evaluate(settings, optimized, loops)
    return PoseGraphReport(
        dof=problem.variant.dof,
        n_keyframes=len(graph),
        n_free=len(problem.free),
        first_free=int(problem.free[0]) if len(problem.free) else -1,
        n_sequential=int(np.sum(~problem.edges.is_loop)),
        loops=np.stack([loops.i, loops.j], 1),
        forced=loops.is_forced,
        loop_error_m=np.stack([e.error_m for e in said], 1),
        loop_error_deg=np.stack([e.error_deg for e in said], 1),
        loop_weight=np.stack([e.weight for e in said], 1),
        before=before,
        after=after,
        iterations=iterations,
        termination=termination,
        session=len(graph.sessions) - 1,
        drift=optimized.sessions[-1].drift if optimized.sessions else poses.IDENTITY,
    )
