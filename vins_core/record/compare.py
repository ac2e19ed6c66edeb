"""Two runs side by side: what was set differently, what came of it, and the first decision that differs (SPEC 9.2).

Frames are matched by number, as those of a fork and its run are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import msgspec
import numpy as np

from ..errors import RecordingError
from ..evaluation.evaluate import Evaluation, evaluate, run_trajectory
from ..params import Params
from ..report import CostSplit, FrameReport, FrameSummary, Gate
from ..sensors import Trajectory
from . import header as headers
from .decisions import STAGES, Decision, decisions
from .header import Parent
from .reader import RunReader

MAX_DT_S = 0.006
"""A pose and its truth are at most this far apart."""


@dataclass(frozen=True)
class RunName:
    id: str
    path: str
    parent: Parent | None


@dataclass(frozen=True)
class Setting:
    """Something that was set, or was there, differently: a parameter, a version, a file."""

    key: str
    first: Any
    second: Any


@dataclass(frozen=True)
class Metrics:
    """A run in numbers; costs are means over the solved frames, milliseconds medians over all frames."""

    frames: int
    poses: int
    keyframes: int
    initialised_frame: int | None
    restarts: int
    cost: CostSplit | None
    landmarks: float | None
    ms: float | None
    accuracy: Evaluation | None  # None without truth
    accuracy_common: Evaluation | None  # over the frames where both runs have a pose


@dataclass(frozen=True)
class Side:
    """One run's side of a difference."""

    outcome: str  # in words
    value: float | None = None
    op: str = ""
    limit: float | None = None
    passed: bool | None = None
    ids: tuple[int, ...] = ()  # members that only this side has


@dataclass(frozen=True)
class Difference:
    """The first decision that differs: in which frame and stage, at which gate, and both sides of it."""

    frame: int
    t_ns: int
    stage: str
    decision: str
    gate: str  # the comparison that tipped it; the decision's name when none did
    knob: str
    unit: str
    first: Side
    second: Side
    cause: str  # "value", "limit", "value and limit", or "" when the decision has no gate
    sentence: str


@dataclass(frozen=True)
class NumberDifference:
    """The first number that differs while all decisions still agree."""

    frame: int
    t_ns: int
    stage: str
    path: str  # within the report, e.g. "solve.before.visual"
    first: float | None  # None for arrays
    second: float | None
    largest: float  # absolute difference; infinite where shapes differ or a number is missing on one side


@dataclass(frozen=True)
class Comparison:
    """What `vinspect compare` says."""

    runs: tuple[RunName, RunName]
    parameters: tuple[Setting, ...]
    calibration: tuple[Setting, ...]
    input: tuple[Setting, ...]  # recording, topics, start, duration
    environment: tuple[Setting, ...]  # versions, processor, back end: replays may differ in their last digits
    metrics: tuple[Metrics, Metrics]
    frames_compared: int
    first_difference: Difference | None
    first_number: NumberDifference | None  # only when it comes before the first decision that differs


def compare(first: RunReader, second: RunReader, progress: Callable[[float], None] = lambda _: None) -> Comparison:
    """Two runs, usually a run and its fork.  `progress` is told the share of frames looked at.

    Raises RunError when a frame of them is damaged.
    """
    settings = list(_settings(first, second))
    decision, number = first_difference(first, second, progress)

    def of(*prefixes: str) -> tuple[Setting, ...]:
        chosen = (s for s in settings if s.key.startswith(prefixes))
        return tuple(dataclasses.replace(s, key=s.key.removeprefix("params.")) for s in chosen)

    return Comparison(
        runs=(_name(first), _name(second)),
        parameters=of("params."),
        calibration=of("calibration."),
        input=of("recording", "topics.", "start_s", "duration_s"),
        environment=of("versions.", "cpu", "backend"),
        metrics=_metrics(first, second),
        frames_compared=min(len(first), len(second)),
        first_difference=decision,
        first_number=number,
    )


def first_difference(
    first: RunReader, second: RunReader, progress: Callable[[float], None] = lambda _: None
) -> tuple[Difference | None, NumberDifference | None]:
    """Walk both runs to the first decision that differs, and to the first number if that comes earlier."""
    number, n = None, min(len(first), len(second))
    for k in range(n):
        progress(k / n)
        if first.same_bytes(second, k):
            continue
        a, b = first.report(k), second.report(k)
        found = differing_decision(a, b, first.header.params_at(k), second.header.params_at(k))
        if number is None:
            number = differing_number(a, b)
            if number and found and not _precedes(number, found):
                number = None
        if found:
            return found, number
    return None, number


def differing_decision(a: FrameReport, b: FrameReport, params_a: Params, params_b: Params) -> Difference | None:
    """The first decision that differs in two reports of one frame."""
    for x, y in zip_longest(decisions(a, params_a), decisions(b, params_b)):
        if x is None or y is None or x.name != y.name:
            return _taken_by_one(a, x, y)
        if x.outcome != y.outcome:
            return _explain(a, x, y)
    return None


def differing_number(a: FrameReport, b: FrameReport) -> NumberDifference | None:
    """The first computed number that differs in two reports of one frame; limits are settings and do not count."""
    for stage, path, x, y in _numbers(a, b):
        if isinstance(x, np.ndarray) and isinstance(y, np.ndarray) and x.shape == y.shape and x.dtype == y.dtype:
            largest = float(np.nanmax(np.abs(x.astype(float) - y.astype(float)), initial=0.0))
            largest = largest if np.array_equal(x != x, y != y) else np.inf
            return NumberDifference(a.frame, a.t_ns, stage, path, None, None, largest)
        first, second = (float(v) if isinstance(v, (int, float)) else None for v in (x, y))
        largest = np.inf if first is None or second is None else abs(first - second)
        return NumberDifference(a.frame, a.t_ns, stage, path, first, second, largest)
    return None


def _taken_by_one(report: FrameReport, x: Decision | None, y: Decision | None) -> Difference:
    there = min((d for d in (x, y) if d), key=lambda d: STAGES.index(d.stage))
    first, second = (Side(_words(there.outcome) if d is there else "not decided") for d in (x, y))
    return Difference(
        report.frame,
        report.t_ns,
        there.stage,
        there.name,
        gate=there.name,
        knob=there.knob,
        unit="",
        first=first,
        second=second,
        cause="",
        sentence=f"frame {report.frame}, {there.stage}, {there.name}: {first.outcome} against {second.outcome}",
    )


def _explain(report: FrameReport, x: Decision, y: Decision) -> Difference:
    """Two outcomes of one decision, down to the gate that tipped it."""
    only_x, only_y = _only(x, y), _only(y, x)
    g, h = _tipped(x, y, only_x + only_y)
    known = g or h
    first, second = _side(x, g, only_x), _side(y, h, only_y)
    gate = known.name if known else x.name
    return Difference(
        report.frame,
        report.t_ns,
        x.stage,
        x.name,
        gate,
        (known.knob if known else "") or x.knob,
        known.unit if known else "",
        first,
        second,
        cause=" and ".join(w for w in ("value", "limit") if g and h and getattr(g, w) != getattr(h, w)),
        sentence=f"frame {report.frame}, {x.stage}, {gate}: {_told(first, known)} against {_told(second, known)}",
    )


def _tipped(x: Decision, y: Decision, ids: tuple[int, ...]) -> tuple[Gate | None, Gate | None]:
    """The gate that made the outcomes differ, on both sides."""
    for g, h in zip(x.gates, y.gates):
        if g.name == h.name and g.passed != h.passed:
            return g, h
    for id in ids if x.judge and y.judge else ():
        assert x.judge and y.judge
        g_or_none, h_or_none = x.judge(id), y.judge(id)
        if g_or_none or h_or_none:
            return g_or_none, h_or_none
    return None, None


def _only(x: Decision, y: Decision) -> tuple[int, ...]:
    if isinstance(x.outcome, tuple) and isinstance(y.outcome, tuple):
        return tuple(sorted(set(x.outcome) - set(y.outcome)))
    return ()


def _side(decision: Decision, gate: Gate | None, only: tuple[int, ...]) -> Side:
    outcome = _words(decision.outcome)
    if gate is None:
        count = decision.outcome if isinstance(decision.outcome, int) else None
        value = len(decision.outcome) if isinstance(decision.outcome, tuple) else count
        return Side(outcome, value, ids=only)
    return Side(outcome, gate.value, gate.op, gate.limit, gate.passed, only)


def _words(outcome: str | int | bool | tuple[int, ...]) -> str:
    if isinstance(outcome, bool):
        return "yes" if outcome else "no"
    return str(len(outcome)) if isinstance(outcome, tuple) else str(outcome)


def _told(side: Side, gate: Gate | None) -> str:
    if gate is None or side.limit is None:
        only = f", {len(side.ids)} of them only here" if side.ids else ""
        return f"{side.outcome}{only}"
    value = "not computed" if side.value is None else f"{side.value:.6g} {gate.unit}".strip()
    return f"{value} {side.op} {side.limit:g} ({side.outcome})"


_STAGE_OF = {
    "tracks": "front end",
    "keyframe": "keyframe",
    "initialization": "initialization",
    "solve": "solve",
    "window": "solve",
    "depth": "solve",
    "relocalizations": "loop",
    "closure": "loop",
    "gps": "gps",
    "pose": "status",  # withdrawn when the estimator has failed; its numbers are those of the window
    "landmarks": "landmarks",
    "health": "health",
    "marginalization": "marginalization",
}


def _precedes(number: NumberDifference, decision: Difference) -> bool:
    """Within a stage a number comes first only where the gate compared another value."""
    if number.frame != decision.frame:
        return number.frame < decision.frame
    a, b = STAGES.index(number.stage), STAGES.index(decision.stage)
    return a < b or (a == b and "value" in decision.cause)


def _numbers(a: FrameReport, b: FrameReport) -> Iterator[tuple[str, str, Any, Any]]:
    """(stage, path, first, second) of every number that differs, in the order of the stages."""
    names = sorted((f.name for f in dataclasses.fields(a)), key=lambda n: STAGES.index(_STAGE_OF.get(n, "input")))
    for name in names:
        if name != "status":
            stage = _STAGE_OF.get(name, "input")
            yield from ((stage, *found) for found in _leaves(getattr(a, name), getattr(b, name), name))


def _leaves(a: Any, b: Any, path: str) -> Iterator[tuple[str, Any, Any]]:
    """Numbers that differ in two trees; texts say what numbers and decisions say already."""
    if isinstance(a, Gate) and isinstance(b, Gate):
        yield from _leaves(a.value, b.value, f"{path}.{a.name}")
    elif dataclasses.is_dataclass(a) and type(a) is type(b):
        for f in dataclasses.fields(a):
            yield from _leaves(getattr(a, f.name), getattr(b, f.name), f"{path}.{f.name}")
    elif isinstance(a, tuple) and isinstance(b, tuple):
        for i, (x, y) in enumerate(zip_longest(a, b)):
            yield from _leaves(x, y, f"{path}[{i}]")
    elif isinstance(a, dict) and isinstance(b, dict):
        for key in a | b:
            yield from _leaves(a.get(key), b.get(key), f"{path}.{key}")
    elif isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        if (a.dtype, a.shape, a.tobytes()) != (b.dtype, b.shape, b.tobytes()):
            yield path, a, b
    elif not (isinstance(a, str) and isinstance(b, str)) and a != b and not (a != a and b != b):
        yield path, a, b


def _name(run: RunReader) -> RunName:
    return RunName(run.header.id, str(run.path), run.header.parent)


def _settings(first: RunReader, second: RunReader) -> Iterator[Setting]:
    """What differs in the headers, by dotted key."""
    a, b = (dict(_flat(msgspec.json.decode(headers.to_json(r.header)), "")) for r in (first, second))
    return (Setting(k, a.get(k), b.get(k)) for k in sorted(a | b) if a.get(k) != b.get(k))


def _flat(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _flat(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and any(isinstance(v, (dict, list)) for v in value):
        for i, inner in enumerate(value):
            yield from _flat(inner, f"{key}.{i}")
    else:
        yield key, value


def _metrics(first: RunReader, second: RunReader) -> tuple[Metrics, Metrics]:
    paths = [run_trajectory(r.summaries) for r in (first, second)]
    images = [{s.t_ns for s in r.summaries if s.pose is not None} for r in (first, second)]
    common = images[0] & images[1]  # on the IMU's clock their poses may be at different times
    truth = first.truth or second.truth
    return _measure(first, paths[0], common, truth), _measure(second, paths[1], common, truth)


def _measure(run: RunReader, path: Trajectory, common: set[int], truth: Trajectory | None) -> Metrics:
    rows = run.summaries
    solved = [s.after for s in rows if s.after]
    first_image_ns = run.report(0).images[0].t_ns if rows else None
    kept = np.array([s.t_ns in common for s in rows if s.pose is not None], bool)
    shared = Trajectory(path.t_ns[kept], path.p_w_b[kept], path.q_w_b[kept])
    return Metrics(
        frames=len(rows),
        poses=len(path),
        keyframes=sum(bool(s.is_keyframe) for s in rows),
        initialised_frame=next((s.frame for s in rows if s.initialization == ""), None),
        restarts=sum(s.health != "" for s in rows),
        cost=CostSplit(*(float(np.mean([getattr(c, n) for c in solved])) for n in ("visual", "imu", "prior", "depth")))
        if solved
        else None,
        landmarks=float(np.mean([s.n_landmarks for s in rows if s.after])) if solved else None,
        ms=float(np.median([_total_ms(s) for s in rows])) if rows else None,
        accuracy=_accuracy(path, truth, first_image_ns),
        accuracy_common=_accuracy(shared, truth, first_image_ns),
    )


def _total_ms(row: FrameSummary) -> float:
    return sum(row.ms.values())


def _accuracy(path: Trajectory, truth: Trajectory | None, first_image_ns: int | None) -> Evaluation | None:
    if truth is None:
        return None
    try:
        return evaluate(path, truth, MAX_DT_S, first_image_ns)
    except RecordingError:  # fewer than three poses with truth
        return None
