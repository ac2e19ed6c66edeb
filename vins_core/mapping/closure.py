"""Loop closing on a page: what a frame adds to the map, and what the map says back (SPEC 7, HOUSE "Time travel").

    odometry -> keyframe -> loop? -> refined in the window while it is there -> edge -> pose graph -> drift

The odometry is never moved: the map gives it a drift correction T_g_o, one by the graph and one by the newest loop
(seed 000.3.3.5).  All scheduling is in recording time, so that a run repeats itself bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..clock import stopwatch
from ..geometry import poses
from ..loop import relocalize, step
from ..loop.keyframe import Keyframes, LoopKeyframe
from ..loop.relocalize import RelocalisationRequest
from ..loop.step import LoopState
from ..params import Params
from ..pose_graph.graph import PoseGraph, add_keyframe, add_loop, adopt, begin_session, shift
from ..pose_graph.optimize import optimize
from ..report import (
    ClosureReport,
    FrameReport,
    Gate,
    KeyframeEntry,
    LoopCandidate,
    LoopEdge,
    LoopOutcome,
    LoopReport,
    PoseGraphReport,
    RelocalizationReport,
    Timings,
)
from ..sensors import ImageRef, ImageSource
from ..window.state import WindowFrame, WindowState
from .places import Places


@dataclass(frozen=True)
class PendingLoop:
    """An accepted loop whose keyframe is still in the window, which may make its pose better."""

    edge: LoopEdge
    frame: int  # of the later keyframe


@dataclass(frozen=True)
class Optimization:
    """One that has begun: a pure function of the graph at that time (schedule.py)."""

    t_ns: int
    graph: PoseGraph


@dataclass(frozen=True)
class Closure:
    """What loop closing carries from frame to frame."""

    loops: LoopState
    graph: PoseGraph
    session_open: bool = False  # keyframes belong to the graph's last session; else they begin one
    pending: tuple[PendingLoop, ...] = ()
    requests: tuple[RelocalisationRequest, ...] = ()  # to the window
    optimization: Optimization | None = None
    begun_ns: int | None = None  # the last optimisation
    n_loops_begun: int = 0  # loops it knew
    fast_drift: np.ndarray = field(default_factory=lambda: poses.IDENTITY)  # (7,) T_g_o by the newest loop


def begin(places: Places) -> Closure:
    """Before the first frame: nothing, or the map that the run begins with."""
    limits, known = places.vocabulary.limits, places.keyframes
    loops = LoopState(Keyframes(known), limits, len(known), since=len(known))
    return Closure(loops, places.graph, n_loops_begun=places.graph.n_loops)


def interrupt(closure: Closure) -> Closure:
    """The odometry starts anew: what follows is a session of its own, which begins where this one was."""
    return replace(closure, session_open=False, requests=())


def close(
    params: Params,
    places: Places,
    images: ImageSource,
    closure: Closure,
    window: WindowState,
    image: ImageRef,
    report: FrameReport,
    ms: Timings,
) -> tuple[Closure, FrameReport]:
    """A frame that was solved, whose turn left `window`; `image` is that of the frame before it."""
    closure, judged = _refine(params, closure, report.relocalizations)
    closure, edges = _tie(params, closure, window)
    keyframe, loop = None, None
    if report.keyframe is not None and report.keyframe.is_keyframe:
        motion = report.window.motion if report.window and closure.session_open else None
        closure, keyframe, loop = _add_keyframe(params, places, images, closure, window, motion, image, ms)
    with stopwatch(ms, "graph"):
        closure, optimized = _optimize(params, places, closure, report.t_ns)
    drift = closure.graph.sessions[-1].drift if closure.graph.sessions else poses.IDENTITY
    said = ClosureReport(keyframe, loop, edges, optimized, drift, closure.fast_drift)
    return closure, replace(report, relocalizations=judged, closure=said)


def conclude(params: Params, closure: Closure) -> tuple[PoseGraph, PoseGraphReport]:
    """The graph with every loop that was accepted, optimised once more: the best the run knows of its path."""
    graph = closure.graph
    for loop in closure.pending:
        graph = _with_edge(params, graph, loop.edge)
    return optimize(params.pose_graph, graph)


def _refine(
    params: Params, closure: Closure, found: tuple[RelocalizationReport, ...]
) -> tuple[Closure, tuple[RelocalizationReport, ...]]:
    """Loops take the poses that the window found for them, where those stand the test again (R3)."""
    judged = tuple(_judge(params, closure, report) for report in found)
    accepted = {(r.match, r.query): r for r in judged if r.accepted}
    if not accepted:
        return closure, judged
    pending = []
    for loop in closure.pending:
        better = accepted.get((loop.edge.earlier, loop.edge.later))
        edge = replace(loop.edge, T_i_j=better.T_match_query, refined=True) if better else loop.edge
        pending.append(replace(loop, edge=edge))
    newest = max(accepted.values(), key=lambda r: r.query)
    assert newest.drift is not None
    return replace(closure, pending=tuple(pending), fast_drift=newest.drift), judged


def _judge(params: Params, closure: Closure, report: RelocalizationReport) -> RelocalizationReport:
    T_g_match = closure.graph.T_corrected[report.match]
    moved = relocalize.drift(params.pose_graph, T_g_match, report.T_w_match)
    return replace(report, gates=relocalize.recheck(params.loop, report), drift=moved)


def _drift_by(params: Params, graph: PoseGraph, earlier: int, later: int, T_i_j: np.ndarray) -> np.ndarray:
    """T_g_o that puts the later keyframe where a loop sees it."""
    T_g_j = poses.compose(graph.T_corrected[earlier], T_i_j)
    return shift(params.pose_graph, T_g_j, graph.T_vio[later])


def _tie(params: Params, closure: Closure, window: WindowState) -> tuple[Closure, tuple[LoopEdge, ...]]:
    """Loops whose keyframe has left the window become edges."""
    inside = {f.frame for f in window.frames}
    ready = tuple(loop.edge for loop in closure.pending if loop.frame not in inside)
    if not ready:
        return closure, ()
    graph, edges = closure.graph, []
    for edge in ready:
        graph = _with_edge(params, graph, edge)
        edges.append(replace(edge, T_i_j=graph.T_loops[-1].copy()))
    waiting = tuple(loop for loop in closure.pending if loop.frame in inside)
    requests = tuple(r for r in closure.requests if r.frame in inside)
    return replace(closure, graph=graph, pending=waiting, requests=requests), tuple(edges)


def _with_edge(params: Params, graph: PoseGraph, edge: LoopEdge) -> PoseGraph:
    return add_loop(params.pose_graph, graph, edge.earlier, edge.later, edge.T_i_j[:3], edge.T_i_j[3:])


def _add_keyframe(
    params: Params,
    places: Places,
    images: ImageSource,
    closure: Closure,
    window: WindowState,
    motion: np.ndarray | None,
    image: ImageRef,
    ms: Timings,
) -> tuple[Closure, KeyframeEntry | None, LoopReport]:
    """The second newest frame, which has just become a keyframe (REFERENCE L1); `motion`: covariance since the last."""
    slot = len(window.frames) - 2
    frame = window.frames[slot]
    T_w_b = np.concatenate([frame.p_w_b, frame.q_w_b])
    loops, judged = step.admit(params.loop, closure.loops, T_w_b, motion)
    if not all(g.passed for g in judged):
        return replace(closure, loops=loops), None, _left_out(frame, judged)
    with stopwatch(ms, "describe"):
        keyframe = places.describe(window, slot, images.load(image), params.loop.max_corners)
        keyframe = replace(keyframe, odometry=step.odometry(loops))
    with stopwatch(ms, "loop"):
        found = step.detect(params.loop, loops, keyframe)
        found = replace(found, gates=(*judged, *found.gates))
        loops = step.remember(loops, keyframe, found)
    closure, entry = _enter(replace(closure, loops=loops), keyframe)
    if found.accepted is not None:
        closure = _accept(params, closure, keyframe, found.accepted)
    return closure, entry, found


def _left_out(frame: WindowFrame, judged: tuple[Gate, ...]) -> LoopReport:
    return LoopReport(-1, frame.frame, frame.t_ns, 0, 0, None, judged, (), LoopOutcome.LEFT_OUT)


def _enter(closure: Closure, keyframe: LoopKeyframe) -> tuple[Closure, KeyframeEntry]:
    graph, fast = closure.graph, closure.fast_drift
    if not closure.session_open:
        continues = bool(graph.sessions) and not graph.sessions[-1].base
        graph = begin_session(graph, drift=graph.sessions[-1].drift if continues else poses.IDENTITY)
        fast = graph.sessions[-1].drift
    number = len(graph)
    graph = add_keyframe(graph, keyframe.frame, keyframe.t_ns, keyframe.T_w_b[:3], keyframe.T_w_b[3:])
    T_vio = graph.T_vio[number].copy()  # as the graph has it, to the last bit: the record restores the graph from it
    entry = KeyframeEntry(number, len(graph.sessions) - 1, keyframe.frame, keyframe.t_ns, T_vio)
    return replace(closure, graph=graph, session_open=True, fast_drift=fast), entry


def _accept(params: Params, closure: Closure, keyframe: LoopKeyframe, loop: LoopCandidate) -> Closure:
    assert loop.T_match_query is not None
    pending = PendingLoop(LoopEdge(loop.match, loop.query, loop.T_match_query, False), keyframe.frame)
    closure = replace(
        closure,
        pending=(*closure.pending, pending),
        fast_drift=_drift_by(params, closure.graph, loop.match, loop.query, loop.T_match_query),
    )
    if not params.loop.relocalize:
        return closure
    asked = relocalize.request(loop, keyframe, closure.loops.keyframes[loop.match])
    return replace(closure, requests=(*closure.requests, asked)[-params.loop.relocalize :])


def _optimize(params: Params, places: Places, closure: Closure, t_ns: int) -> tuple[Closure, PoseGraphReport | None]:
    """Use the result that is due; begin anew when loops have come in since the last beginning."""
    settings, report = params.pose_graph, None
    begun = closure.optimization
    if begun is not None and t_ns >= begun.t_ns + settings.delay_s * 1e9:
        optimized, report = places.optimizer.result(settings, begun.graph)
        closure = replace(closure, graph=adopt(closure.graph, optimized), optimization=None)
    rested = closure.begun_ns is None or t_ns >= closure.begun_ns + settings.period_s * 1e9
    if closure.optimization is None and rested and closure.graph.n_loops > closure.n_loops_begun:
        graph = closure.graph
        places.optimizer.prefetch(settings, graph)
        begun = Optimization(t_ns, graph)
        closure = replace(closure, optimization=begun, begun_ns=t_ns, n_loops_begun=graph.n_loops)
    return closure, report
