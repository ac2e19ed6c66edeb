"""What other limits would have decided, from the gates alone: no descriptor is touched (SPEC 9.3a).

Exact for limits; parameters that change values (descriptor, ratio, RANSAC ...) need the keyframes again (`detect`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from ..params import DECLARATIONS, Loop
from ..report import Gate, LoopCandidate, LoopReport
from . import gates
from .step import decide, retrieval_gates
from .vocabulary import ScoreLimits

LIMITS = frozenset(
    {"candidates", "order", "score", "min_score_ratio", "min_score", "min_neighbour_score", "min_matches"}
    | {"min_epipolar", "min_inliers", "max_rms_px", "max_sigma_m", "max_tilt_deg", "max_heading_deg", "max_distance_m"}
)
"""Parameters of `loop` that only set limits."""

_NAMES = list(gates.MEANING)
_VERIFICATION = frozenset(_NAMES[_NAMES.index("matches") :])


def rejudge(params: Loop, limits: ScoreLimits, report: LoopReport) -> LoopReport:
    """The report of `detect(..., evaluate_all=True)` as `params` would have had it.

    They may differ from those it was made with in LIMITS; `candidates` may only fall, for what was never looked at
    stays unknown.  Raises ValueError for a report without all gates.
    """
    if any(c.gates[-1].name != _NAMES[-1] for c in report.candidates):
        raise ValueError("only a report of `detect(..., evaluate_all=True)` says what other limits decide")
    own = tuple(
        gates.distinctive(params, g.value, limits) if g.name == "distinctive" else _limited(params, g)
        for g in report.gates
    )
    ranked = sorted(report.candidates, key=lambda c: (-c.score, c.match))[: params.candidates]
    judged = [_rejudged(params, limits, report, c, ranked) for c in ranked]
    if params.order == "oldest":
        judged.sort(key=lambda c: c.match)
    return decide(replace(report, gates=own), judged)


def smallest_change(judged: Iterable[Gate]) -> dict[str, Any] | None:
    """The least that parameters must move for all gates to pass, `section.name -> value`.

    None when a value is unknown, or no allowed setting of its parameter lets it pass.
    """
    change: dict[str, Any] = {}
    for gate in judged:
        if gate.passed or not gate.decides:
            continue
        if gate.knob == "loop.order":
            change[gate.knob] = "best"
            continue
        declared = DECLARATIONS[gate.knob]
        assert declared.low is not None and declared.high is not None
        if gate.value is None or not declared.low <= gate.value <= declared.high:
            return None
        value = declared.type(gate.value)
        choose = min if gate.op == ">=" else max
        change[gate.knob] = choose(value, change.get(gate.knob, value))
    return change


def _rejudged(
    params: Loop, limits: ScoreLimits, report: LoopReport, candidate: LoopCandidate, ranked: list[LoopCandidate]
) -> LoopCandidate:
    retrieval = retrieval_gates(
        params,
        limits,
        report.neighbour_score,
        report.keyframe - candidate.match - 1,
        candidate.score,
        1 + ranked.index(candidate),
        [c.score for c in ranked if c.match < candidate.match],
    )
    verification = tuple(_limited(params, g) for g in candidate.gates if g.name in _VERIFICATION)
    return replace(candidate, gates=retrieval + verification)


def _limited(params: Loop, gate: Gate) -> Gate:
    return replace(gate, limit=getattr(params, gate.knob.split(".")[1]))
