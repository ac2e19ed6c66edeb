from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING, Any

from .arguments import Json, Run
from .console import print_json, progress_bar

if TYPE_CHECKING:
    from vins_core.mapping.study import LoopStudy
    from vins_core.report import Gate, LoopCandidate, LoopReport


def loops(run: Run, /, json: Json = False) -> None:
    """Show how far every keyframe came on its way to a loop, and which gates decided."""
    from vins_core.mapping.study import LoopStudy
    from vins_core.record.reader import RunReader

    with RunReader(run) as reader, progress_bar("looking into loops") as report:
        study = LoopStudy(reader)
        left = all_of_them = study.advance(0)
        while left:
            left = study.advance(1)
            report(1 - left / max(all_of_them, 1))
        judged = study.judged()
        if json:
            print_json(_document(study, judged))
        else:
            _print(study, judged)


def _document(study: LoopStudy, judged: tuple[LoopReport, ...]) -> dict[str, Any]:
    revisits = study.revisits()
    return {
        "candidates": [_row(study, report, c) for report in judged for c in report.candidates],
        "keyframes": [
            {
                "keyframe": row.number,
                "frame": row.frame,
                "t_ns": row.t_ns,
                "outcome": row.outcome,
                "match": row.match,
                "revisits": None if revisits is None else row.number in revisits,
            }
            for row in study.rows()
        ],
        "funnel": study.funnel(),
    }


def _row(study: LoopStudy, report: LoopReport, candidate: LoopCandidate) -> dict[str, Any]:
    truth = study.truth(candidate.query, candidate.match)
    earlier = study.keyframe(candidate.match)
    return {
        "query": candidate.query,
        "match": candidate.match,
        "accepted": candidate.accepted,
        "outcome": candidate.outcome,
        "score": candidate.score,
        "query_frame": report.frame,
        "query_t_ns": report.t_ns,
        "match_frame": earlier.frame,
        "match_t_ns": earlier.t_ns,
        "true_distance_m": truth and truth.distance_m,
        "true_angle_deg": truth and truth.angle_deg,
        "place": truth and truth.place,
        "gates": [_gate(g) for g in _gates(report, candidate)],
    }


def _gates(report: LoopReport, candidate: LoopCandidate) -> Iterator[Gate]:
    """Those of the keyframe alone, unless the candidate is asked the same, and those of the candidate."""
    asked = {g.name for g in candidate.gates}
    own = (g for g in report.gates if g.name not in asked)
    return (g for g in chain(own, candidate.gates) if g.decides)


def _gate(gate: Gate) -> dict[str, Any]:
    return {
        "name": gate.name,
        "value": gate.value,
        "op": gate.op,
        "limit": gate.limit,
        "unit": gate.unit,
        "knob": gate.knob,
        "passed": gate.passed,
    }


def _print(study: LoopStudy, judged: tuple[LoopReport, ...]) -> None:
    revisits = study.revisits()
    known = revisits is not None
    print(f"{'keyframes':>12} {'all':>6}" + (f" {'same place':>11} {'elsewhere':>10}" if known else ""))
    for stage in study.funnel():
        split = f" {stage.same_place:>11} {stage.elsewhere:>10}" if known else ""
        print(f"{stage.name:>12} {stage.count:>6}{split}")
    if revisits is not None:
        closed = {report.keyframe for report in judged if report.accepted}
        print(f"{len(revisits & closed)} of {len(revisits)} keyframes that truly revisit a place close a loop")
    print(f"\n{'keyframe':>8} {'match':>6} {'score':>6} {'inliers':>7}  {'truth':<17}  decided by")
    for report in judged:
        if all(g.passed for g in report.gates if g.decides) and report.candidates:
            print(_line(study, report.accepted or max(report.candidates, key=_progress)))


def _progress(candidate: LoopCandidate) -> int:
    return list(type(candidate.outcome)).index(candidate.outcome)


def _line(study: LoopStudy, c: LoopCandidate) -> str:
    """A loop, or the candidate that came furthest on the way to one."""
    truth = study.truth(c.query, c.match)
    said = f"{truth.distance_m:6.2f} m {truth.angle_deg:4.0f} deg" if truth else "-"
    inliers = next((g.value for g in c.gates if g.name == "pose inliers"), None)
    count = "-" if inliers is None else f"{inliers:.0f}"
    failed = [g for g in c.gates if g.decides and not g.passed]
    known = [g for g in failed if g.value is not None] or failed[:1]
    verdict = "accepted" if c.accepted else f"{c.outcome}: {', '.join(map(_words, known))}"
    return f"{c.query:>8} {c.match:>6} {c.score:6.3f} {count:>7}  {said:<17}  {verdict}"


def _words(gate: Gate) -> str:
    value = "unknown" if gate.value is None else f"{gate.value:.3g}"
    return f"{gate.name} {value} not {gate.op} {gate.limit:.3g}"
