"""What other limits would have decided about a keyframe, from its report alone: no descriptor is touched (SPEC 9.3a).

Exact for limits; parameters that change values (descriptor, ratio, RANSAC ...) need the keyframes again (`detect`).
What is accepted early changes what is consistent later: over a run, the nodes of consistency go with the reports.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from ..params import DECLARATIONS, Loop
from ..report import Gate, LoopCandidate, LoopReport, all_pass
from . import gates
from .consistency import Arrived, judge
from .step import decide, retrieval_gates
from .vocabulary import ScoreLimits

LIMITS = frozenset(
    {"candidates", "order", "score", "min_score_ratio", "min_score", "min_neighbour_score", "min_matches"}
    | {"min_epipolar", "min_inliers", "max_rms_px", "max_sigma_m", "max_tilt_deg", "max_heading_deg", "max_distance_m"}
    | {"consistency", "drift_inflation", "max_drift", "sure_drift", "min_agreement", "agreement_span"}
)
"""Parameters of `loop` that only set limits."""

_NAMES = list(gates.MEANING)
_VERIFICATION = frozenset(_NAMES[_NAMES.index("matches") : _NAMES.index("drift")])
_CONSISTENCY = frozenset(_NAMES[_NAMES.index("drift") :])


def rejudge(params: Loop, limits: ScoreLimits, report: LoopReport, nodes: Arrived | None = None) -> LoopReport:
    """The report of `detect(..., evaluate_all=True)` as `params` would have had it.

    `nodes`: what consistency knew then; without them, all that was decided before counts as it was recorded.

    They may differ from those it was made with in LIMITS; `candidates` may only fall, for what was never looked at
    stays unknown.  Raises ValueError for a report without all gates.
    """
    if any(all(g.name != "distance" for g in c.gates) for c in report.candidates):
        raise ValueError("only a report of `detect(..., evaluate_all=True)` says what other limits decide")
    own = tuple(
        gates.distinctive(params, g.value, limits) if g.name == "distinctive" else _limited(params, g)
        for g in report.gates
    )
    ranked = sorted(report.candidates, key=lambda c: (-c.score, c.match))[: params.candidates]
    judged = [_rejudged(params, limits, report, c, ranked, nodes) for c in ranked]
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
    params: Loop,
    limits: ScoreLimits,
    report: LoopReport,
    candidate: LoopCandidate,
    ranked: list[LoopCandidate],
    nodes: Arrived | None,
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
    judged = retrieval + verification
    if nodes is not None and all_pass(judged):
        return judge(params, nodes, replace(candidate, gates=judged))
    return replace(candidate, gates=judged + _as_recorded(params, candidate))


def _as_recorded(params: Loop, candidate: LoopCandidate) -> tuple[Gate, ...]:
    """The gates of consistency with other limits."""
    recorded = [_limited(params, g) for g in candidate.gates if g.name in _CONSISTENCY]
    if not recorded or not params.consistency:
        return ()
    drift, agreement = recorded
    sure = drift.decides and drift.value is not None and drift.value <= params.sure_drift
    return drift, replace(agreement, decides=not sure)


def _limited(params: Loop, gate: Gate) -> Gate:
    limit = getattr(params, gate.knob.partition(".")[2])
    if limit == gate.limit:
        return gate
    return Gate(gate.name, gate.value, gate.op, limit, gate.knob, gate.unit, gate.decides)
