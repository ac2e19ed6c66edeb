"""Everything a frame decided, in the order of deciding: what `compare` walks and a what-if is judged by.

A decision follows from gates (keyframe, initialisation, health), or it is about members, each with a gate of its own
(which landmarks are rejected, which eigenvalues count).  Advisory gates decide nothing and are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..params import Params
from ..report import (
    DEPTH_LOSSES,
    DEPTH_USES,
    LANDMARK_STATUSES,
    LOSS_REASONS,
    DepthLoss,
    DepthReport,
    DepthUse,
    FrameReport,
    Gate,
    GpsReport,
    InitReport,
    KeyframeReport,
    LandmarkReport,
    LandmarkStatus,
    LoopReport,
    LossReason,
    MarginalizationReport,
    SolveReport,
    Status,
    TrackReport,
)

STAGES = (
    "input",
    "front end",
    "keyframe",
    "initialization",
    "solve",
    "landmarks",
    "health",
    "marginalization",
    "status",
    "loop",
    "gps",
)
"""The order in which a frame goes through them."""

LOSS_KNOBS = {
    LossReason.FLOW: "frontend.klt_window",
    LossReason.FLOW_BACK: "frontend.flow_back_px",
    LossReason.BORDER: "frontend.border_px",
    LossReason.RANSAC: "frontend.F_threshold",
    LossReason.MASK: "frontend.min_dist",
    LossReason.OUTLIER: "window.max_error_px",
    LossReason.RESET: "frontend.max_gap_s",
}
"""The parameter that a loss of this kind depends on most."""

DEPTH_KNOBS = {DepthLoss.MISSING: "frontend.depth_min_patch_share", DepthLoss.EDGE: "frontend.depth_max_variation"}
USE_KNOBS = {DepthUse.UNSTEADY: "depth.max_disagreement", DepthUse.GATED: "depth.max_chi2"}

_OUTLIER = LANDMARK_STATUSES.index(LandmarkStatus.OUTLIER)


@dataclass(frozen=True)
class Decision:
    """`outcome` is what was decided; two decisions agree when their outcomes are equal.

    For a decision about members the outcome holds their ids, and `judge(id)` is the gate of one of them, if known.
    """

    stage: str
    name: str
    outcome: str | int | bool | tuple[int, ...]
    gates: tuple[Gate, ...] = ()
    knob: str = ""  # where no gate names one
    judge: Callable[[int], Gate | None] | None = None


def decisions(report: FrameReport, params: Params) -> Iterator[Decision]:
    """What the frame of `report`, computed with `params`, decided."""
    yield Decision("input", "time of the frame", report.t_ns, knob="frontend.freq")
    yield Decision("input", "images", tuple(i.t_ns for i in report.images), knob="frontend.freq")
    yield from _tracks(report.tracks)
    if report.keyframe:
        yield _keyframe(report.keyframe)
    yield Decision("initialization", "window is full", report.status is not Status.FILLING, knob="window.size")
    attempt = report.initialization
    yield Decision("initialization", "attempted", attempt is not None, knob="init.retry_s")
    if attempt:
        yield from _initialization(attempt)
    if report.window:
        yield Decision("solve", "frames in the window", tuple(report.window.frames.tolist()), knob="window.size")
        again = tuple(sorted(r.query for r in report.relocalizations))
        yield Decision("solve", "loops in the window", again, knob="loop.relocalize")
    if report.depth:
        yield from _depths(report.depth)
    if report.calibration:
        yield Decision("solve", "td", *_verdict(report.calibration.td_gates), knob="online.td")
        yield Decision("solve", "extrinsics", *_verdict(report.calibration.extrinsic_gates), knob="online.extrinsics")
    if report.solve:
        yield from _solve(report.solve, params)
    if report.landmarks and report.solve:
        yield _rejected(report.landmarks, report.solve, params)
    if report.health:
        yield Decision("health", "health", *_verdict(report.health.gates))
    if report.marginalization:
        yield from _marginalization(report.marginalization, params)
    yield Decision("status", "status", str(report.status))
    yield from _loops(report)
    if report.gps:
        yield from _gps(report.gps)


def _verdict(gates: tuple[Gate, ...]) -> tuple[str, tuple[Gate, ...]]:
    """What follows from gates that must all pass, and those that take part."""
    deciding = tuple(g for g in gates if g.decides)
    failed = [g.name for g in deciding if not g.passed]
    return f"fails at {', '.join(failed)}" if failed else "passes", deciding


def _tracks(tracks: TrackReport) -> Iterator[Decision]:
    for gate in tracks.gates:
        if gate.decides:
            yield Decision("front end", gate.name, "passes" if gate.passed else "fails", (gate,))
    for index, reason in enumerate(LOSS_REASONS):
        ids = np.sort(tracks.lost_ids[tracks.lost_reason == index])
        yield Decision("front end", f"tracks lost: {reason}", tuple(ids.tolist()), knob=LOSS_KNOBS.get(reason, ""))
    yield Decision("front end", "new tracks", tracks.n_new, knob="frontend.max_cnt")
    for index, loss in enumerate(DEPTH_LOSSES if len(tracks.depth_loss) else ()):
        ids = tracks.ids[tracks.depth_loss == index]
        yield Decision("front end", f"no depth: {loss}", tuple(ids.tolist()), knob=DEPTH_KNOBS.get(loss, ""))


def _keyframe(report: KeyframeReport) -> Decision:
    return Decision("keyframe", "keyframe", "keyframe" if report.is_keyframe else "no keyframe", report.gates)


def _initialization(attempt: InitReport) -> Iterator[Decision]:
    for stage in attempt.stages:
        outcome, gates = _verdict(stage.gates)
        yield Decision("initialization", stage.name, outcome if stage.outcome else "passes", gates)
    yield Decision("initialization", "reference frame", attempt.reference_slot)
    yield Decision("initialization", "initialised", attempt.succeeded)


def _solve(solve: SolveReport, params: Params) -> Iterator[Decision]:
    ids = np.unique(solve.visual_ids)
    yield Decision("solve", "landmarks solved", tuple(ids.tolist()), knob="window.min_observations")
    yield Decision("solve", "observations used", len(solve.visual_ids))
    for n, (ratio, *to_go_on) in enumerate(step_gates(solve, params), 1):
        verdict = "accepted" if solve.iterations[n - 1].accepted else "rejected"
        yield Decision("solve", f"step {n}", verdict, (ratio,))
        goes_on = "goes on" if n < len(solve.iterations) else _ending(solve)
        yield Decision("solve", f"after step {n}", goes_on, tuple(to_go_on))
    yield Decision("solve", "termination", _ending(solve))


def _depths(report: DepthReport) -> Iterator[Decision]:
    for index, use in enumerate(DEPTH_USES):
        ids = report.ids[report.use == index]
        yield Decision("solve", f"depth {use}", tuple(ids.tolist()), knob=USE_KNOBS.get(use, "depth.variant"))


def step_gates(solve: SolveReport, params: Params) -> Iterator[tuple[Gate, ...]]:
    """For each step of the solver: what accepts it, then what lets the solver go on after it."""
    cost = solve.before.total
    for n, step in enumerate(solve.iterations, 1):
        gates: tuple[Gate, ...] = (
            Gate("gain ratio", step.gain_ratio, ">", params.solver.min_gain_ratio, "solver.min_gain_ratio"),
            Gate("iterations", n, "<", params.window.max_iterations, "window.max_iterations"),
        )
        if step.accepted:
            fall = (cost - step.cost) / cost if cost > 0 else 0.0
            tolerance = params.solver.function_tolerance
            gates += (Gate("fall of the cost", fall, ">=", tolerance, "solver.function_tolerance"),)
            cost = step.cost
        yield gates


def _ending(solve: SolveReport) -> str:
    """`converged: the cost fell by ...` and `stopped after 8 iterations` without the settings they quote."""
    return solve.termination.partition(":")[0].partition(" after ")[0]


def _rejected(landmarks: LandmarkReport, solve: SolveReport, params: Params) -> Decision:
    ids = landmarks.ids[landmarks.status == _OUTLIER]

    def error(id: int) -> Gate | None:
        errors = solve.visual_error_px[solve.visual_ids == id].astype(float)
        if not len(errors):
            return None
        limit = params.window.max_error_px
        return Gate("mean reprojection error", float(errors.mean()), "<=", limit, "window.max_error_px", "px460")

    return Decision("landmarks", "landmarks rejected", tuple(ids.tolist()), knob="window.max_error_px", judge=error)


def _marginalization(report: MarginalizationReport, params: Params) -> Iterator[Decision]:
    yield Decision("marginalization", "kind", report.kind, knob="window.size")
    yield Decision("marginalization", "blocks dropped", report.m)
    first = len(report.eigenvalues) - report.rank
    judge = partial(_eigenvalue, report.eigenvalues, params.marginalization.eigen_threshold)
    kept = tuple(range(first, len(report.eigenvalues)))
    yield Decision("marginalization", "eigenvalues kept", kept, knob="marginalization.eigen_threshold", judge=judge)


def _loops(report: FrameReport) -> Iterator[Decision]:
    closure = report.closure
    for found in report.relocalizations:
        yield Decision("loop", f"pose of keyframe {found.query} by the window", *_verdict(found.gates))
    if closure is None:
        return
    later = tuple(e.later for e in closure.edges)
    yield Decision("loop", "new edges", later, knob="loop.enabled")
    yield Decision("loop", "refined edges", tuple(e.later for e in closure.edges if e.refined), knob="loop.relocalize")
    yield Decision("loop", "keyframe offered", closure.loop is not None)
    if closure.loop:
        yield from _loop(closure.loop)
    yield Decision("loop", "graph optimised", closure.graph is not None, knob="pose_graph.period_s")


def _loop(report: LoopReport) -> Iterator[Decision]:
    """The candidates of a keyframe, in the order of verification."""
    yield Decision("loop", "keyframe", *_verdict(report.gates))
    matches = tuple(c.match for c in report.candidates)
    yield Decision("loop", "candidates", tuple(sorted(matches)), knob="loop.candidates")
    yield Decision("loop", "first candidate", matches[0] if matches else -1, knob="loop.order")
    for candidate in report.candidates:
        outcome, _ = _verdict(candidate.gates)  # one that is advice here may decide there
        yield Decision("loop", f"candidate {candidate.match}", outcome, candidate.gates)
    yield Decision("loop", "loop with", report.accepted.match if report.accepted else -1)


def _gps(report: GpsReport) -> Iterator[Decision]:
    """The fixes in order of time, then what they led to."""
    for fix in report.fixes:
        yield Decision("gps", f"fix at {fix.t_ns} ns", str(fix.verdict), fix.gates)
    for revision in report.revised:
        yield Decision("gps", f"earlier fix at {revision.t_ns} ns", str(revision.verdict), knob="gps.max_chi2")
    yield Decision("gps", "what GPS does", str(report.status), tuple(g for g in report.gates if g.decides))


def _eigenvalue(values: np.ndarray, threshold: float, index: int) -> Gate | None:
    if not 0 <= index < len(values):
        return None
    return Gate("eigenvalue", float(values[index]), ">", threshold, "marginalization.eigen_threshold")
