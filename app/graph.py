"""The pose graph at a frame: before, after, and as it would be with edges switched off, forced or added.

Worked out in a thread, the latest wish wins; nothing of the run is changed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from vins_core.geometry import poses, so3
from vins_core.mapping.closure import Closure, conclude
from vins_core.mapping.study import LoopStudy
from vins_core.mapping.truth import true_poses
from vins_core.params import PoseGraph as Settings
from vins_core.pose_graph.edges import Edges, active_edges
from vins_core.pose_graph.graph import Pair, PoseGraph, add_loop, disable, force
from vins_core.pose_graph.optimize import evaluate, optimize
from vins_core.report import PoseGraphReport
from vins_core.sensors import Trajectory

from .context import RunView
from .loops import has_loops
from .series import align_se3

MAP_POINTS = 4000
"""Landmarks of a loaded map that are drawn, about."""


@dataclass(frozen=True)
class Edits:
    """What the user changed about edges, by their keyframes, the earlier one first."""

    disabled: frozenset[Pair] = frozenset()
    forced: frozenset[Pair] = frozenset()

    def __bool__(self) -> bool:
        return bool(self.disabled or self.forced)

    def switched(self, pair: Pair) -> Edits:
        """Off, or on again."""
        return replace(self, disabled=self.disabled ^ {pair}, forced=self.forced - {pair})

    def pressed(self, pair: Pair) -> Edits:
        """Forced, or as it was again."""
        return replace(self, forced=self.forced ^ {pair}, disabled=self.disabled - {pair})


@dataclass(frozen=True)
class EdgeRow:
    """A loop in the graph."""

    pair: Pair
    error_m: tuple[float, float]  # by the odometry alone, and in the graph
    error_deg: tuple[float, float]
    weight: float  # that the robust loss leaves it in the graph


@dataclass(frozen=True)
class GraphView:
    """What the page shows; arrays have one row per keyframe of the graph."""

    frame: int  # of the run, at which the graph was like this
    edits: Edits
    before: np.ndarray  # (n, 3) m by the odometry, in the world of its session
    after: np.ndarray  # (n, 3) m, in the graph's world
    session: np.ndarray  # (n,)
    base: np.ndarray  # (n,) bool, of the map that the run began with
    edges: tuple[EdgeRow, ...]
    ate_m: tuple[float, float] | None  # of the keyframes: odometry, graph; None without truth
    map_points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    """(m, 3) m, landmarks of the map that the run began with, in the graph's world."""
    edited: np.ndarray | None = None  # (n, 3) m after the edits
    edited_ate_m: float | None = None
    report: PoseGraphReport | None = None  # of the optimisation after the edits

    def edge(self, pair: Pair) -> EdgeRow | None:
        return next((e for e in self.edges if e.pair == pair), None)


def graph_view(run: RunView, frame: int, edits: Edits) -> GraphView | None:
    """None while there is no graph."""
    closure = run.reader.state(frame).closure if has_loops(run) else None
    if closure is None or not len(closure.graph):
        return None
    settings = run.header.params_at(frame).pose_graph
    graph = _graph(run, frame, closure)
    loops = _loops(settings, graph)
    alone, together = (evaluate(settings, g, loops) for g in (replace(graph, optimized=graph.T_vio), graph))
    edges = tuple(
        EdgeRow((i, j), (a, b), (c, d), w)
        for i, j, a, b, c, d, w in zip(
            loops.i.tolist(), loops.j.tolist(), alone.error_m.tolist(), together.error_m.tolist(),
            alone.error_deg.tolist(), together.error_deg.tolist(), together.weight.tolist(),
        )
    )  # fmt: skip
    base = np.array([s.base for s in graph.sessions], bool)[graph.session]
    before, after = graph.T_vio[:, :3], graph.T_corrected[:, :3]
    ate = [_ate(p, graph, base, run.truth) for p in (before, after)]
    known = None if ate[0] is None or ate[1] is None else (ate[0], ate[1])
    view = GraphView(frame, edits, before, after, graph.session, base, edges, known, _map_points(run))
    if not edits:
        return view
    optimized, report = optimize(settings, edited(settings, graph, edits, run.loops))
    p = optimized.T_corrected[:, :3]
    return replace(view, edited=p, edited_ate_m=_ate(p, graph, base, run.truth), report=report)


def edited(settings: Settings, graph: PoseGraph, edits: Edits, study: LoopStudy) -> PoseGraph:
    """The graph with the user's edges; forcing two keyframes without an edge adds the one that PnP found for them."""
    present = set(map(tuple, graph.loops.tolist()))
    for pair in sorted(edits.disabled & present):
        graph = disable(graph, *pair)
    for earlier, later in sorted(edits.forced):
        if later >= len(graph):
            continue
        if (earlier, later) not in present:
            T_i_j = study.pair(later, earlier).candidates[0].T_match_query
            if T_i_j is None:
                continue
            graph = add_loop(settings, graph, earlier, later, T_i_j[:3], T_i_j[3:])
        graph = force(graph, earlier, later)
    return graph


def _graph(run: RunView, frame: int, closure: Closure) -> PoseGraph:
    """At the end of a run, the best it knows of its path."""
    if frame < len(run) - 1 or not run.complete:
        return closure.graph
    return conclude(run.header.params_at(frame), closure)[0]


def _loops(settings: Settings, graph: PoseGraph) -> Edges:
    """All loops, those that are disabled too."""
    edges = active_edges(settings, replace(graph, disabled=frozenset()))
    return edges[edges.is_loop]


@lru_cache(maxsize=2)
def _map_points(run: RunView) -> np.ndarray:
    """What optimisation never moves: landmarks of a loaded map, thinned."""
    places = run.reader.places
    if places is None or not len(places.graph):
        return np.zeros((0, 3), np.float32)
    graph, found = places.graph, []
    T_g_o = poses.correction(graph.T_corrected, graph.T_vio)
    for T, keyframe in zip(T_g_o, places.keyframes):
        found.append(T[:3] + so3.rotate(T[3:], keyframe.points_w))
    points = np.concatenate(found)
    return points[:: max(1, len(points) // MAP_POINTS)].astype(np.float32)


def _ate(p: np.ndarray, graph: PoseGraph, base: np.ndarray, truth: Trajectory | None) -> float | None:
    """RMSE of the run's own keyframes after rigid alignment, m."""
    at = true_poses(truth, graph.t_ns)[:, :3]
    known = np.isfinite(at[:, 0]) & ~base
    if known.sum() < 3:
        return None
    R, t = align_se3(p[known], at[known])
    return float(np.sqrt(np.mean(np.sum((p[known] @ R.T + t - at[known]) ** 2, axis=1))))
