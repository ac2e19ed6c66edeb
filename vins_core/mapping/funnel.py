"""How far keyframes come on their way to a loop, counted over a run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from itertools import chain, takewhile

from ..loop import gates
from ..report import LOOP_OUTCOMES, LoopCandidate, LoopOutcome, LoopReport
from .truth import Place, Truth

_LAST_FAILURE = {
    "queried": LoopOutcome.LEFT_OUT,
    "retrievable": LoopOutcome.NOT_DISTINCTIVE,
    "scored": LoopOutcome.NOT_CHOSEN,
    "matched": LoopOutcome.FEW_MATCHES,
    "epipolar": LoopOutcome.EPIPOLAR,
    "PnP": LoopOutcome.TILT,
    "heading": LoopOutcome.HEADING,
    "distance": LoopOutcome.DISTANCE,
    "consistent": LoopOutcome.INCONSISTENT,
    "accepted": LoopOutcome.UNCONFIRMED,
}
"""Stages, and the last outcome that means not to have passed."""

STAGES = tuple(_LAST_FAILURE)
OF_KEYFRAMES = ("queried", "retrievable")
"""Stages before there are candidates."""


@dataclass(frozen=True)
class FunnelStage:
    """Keyframes that passed a stage and all before it.

    Later stages are passed by candidates: a keyframe counts once in `count`, in `same_place` when one of its
    candidates there truly shows that place, and in `elsewhere` when one truly does not.  In the first two stages
    `same_place` are the keyframes that truly revisit an earlier place.  None without truth.
    """

    name: str
    count: int
    same_place: int | None
    elsewhere: int | None


def funnel(
    reports: Iterable[LoopReport],
    truth: Callable[[int, int], Truth | None],
    revisits: Collection[int] | None,
) -> tuple[FunnelStage, ...]:
    """Of reports with every gate up to the decision; `revisits`: keyframes that truly revisit, None without truth."""
    counts = {name: [0, 0, 0] for name in STAGES}
    for report in reports:
        for name in STAGES:
            places = _passing(report, name, truth, revisits)
            for i, counts_here in enumerate((bool(places), Place.SAME in places, Place.ELSEWHERE in places)):
                counts[name][i] += counts_here
    known = revisits is not None
    return tuple(FunnelStage(n, c, s if known else None, e if known else None) for n, (c, s, e) in counts.items())


def _passing(
    report: LoopReport, stage: str, truth: Callable[[int, int], Truth | None], revisits: Collection[int] | None
) -> set[Place | None]:
    """The places that pass a stage: of the keyframe itself, or of its candidates."""
    own = gates.outcome(report.gates)
    if not _passes(own, stage if stage in OF_KEYFRAMES else OF_KEYFRAMES[-1]):
        return set()
    if stage in OF_KEYFRAMES:
        return {Place.SAME if revisits and report.keyframe in revisits else Place.ELSEWHERE}
    found = (truth(c.query, c.match) for c in _looked_at(report) if _passes(c.outcome, stage))
    return {t.place if t else None for t in found}


def _looked_at(report: LoopReport) -> Iterable[LoopCandidate]:
    """Candidates in the order of verification, up to the one that was accepted."""
    refused = takewhile(lambda c: not c.accepted, report.candidates)
    return chain(refused, [report.accepted] if report.accepted else [])


def _passes(outcome: LoopOutcome, stage: str) -> bool:
    return LOOP_OUTCOMES.index(outcome) > LOOP_OUTCOMES.index(_LAST_FAILURE[stage])
