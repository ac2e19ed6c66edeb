"""What other settings would have accepted over a whole run, judged again one keyframe after the other (SPEC 9.3a).

Everything that gates compare is known (rejudge.py); what is accepted early changes what is consistent later, so the
keyframes are taken in order.  As long as accepted loops do not act on the odometry (`loop.relocalize` = 0), the result
is what a fork does, over the whole run.  Where the window relocalises, it is exact up to and including the first loop
that differs: from there on the window knows something else, and only a fork shows what becomes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np

from ..loop.consistency import Arrived, Node, arrive, judge, settle
from ..loop.keyframe import LoopKeyframe
from ..loop.rejudge import rejudge
from ..loop.step import decide
from ..loop.vocabulary import ScoreLimits
from ..params import Loop
from ..report import LoopCandidate, LoopOutcome, LoopReport, all_pass
from .funnel import FunnelStage
from .truth import Place, Truth

VALUES = frozenset(
    {"max_hamming", "max_ratio", "cross_check", "epipolar", "epipolar_px", "epipolar_confidence", "pnp_px"}
    | {"guided_px", "heading"}
)
"""Parameters of `loop` that change what gates compare of a pair of keyframes."""
UNANSWERED = frozenset({"enabled", "relocalize", "max_corners"})
"""Parameters of `loop` that only a fork answers: they change what is described, or what becomes of a loop."""


@dataclass(frozen=True)
class ClosedPair:
    """A loop that is, or would be, accepted."""

    query: int
    match: int
    truth: Truth | None


@dataclass(frozen=True)
class Prediction:
    """What changed settings would have accepted."""

    changes: Mapping[str, Any]
    accepted: tuple[ClosedPair, ...]
    gained: tuple[ClosedPair, ...]  # newly accepted
    lost: tuple[ClosedPair, ...]  # no longer accepted
    first_difference: int | None  # the first keyframe that closes another loop, or a loop with another pose
    fork_at: int | None  # the frame that made that keyframe: a fork from there on shows all that differs
    exact_until: int  # keyframes up to this one are as in a fork, later ones are predicted; -1: none
    unanswered: tuple[str, ...]  # changed parameters that were left as they are, because only a fork answers them
    funnel: tuple[FunnelStage, ...]
    reports: tuple[LoopReport, ...]  # one a keyframe, without matches

    def is_exact(self, query: int) -> bool:
        return query <= self.exact_until

    def count(self, pairs: Sequence[ClosedPair], place: Place) -> int:
        return sum(p.truth is not None and p.truth.place is place for p in pairs)


@dataclass(frozen=True)
class Remedy:
    """The smallest joint change of limits that accepts a loop, and what else it would let in."""

    query: int
    match: int
    changes: Mapping[str, Any]
    accepts: bool  # False: another candidate of the keyframe comes first, or what is accepted before forbids it
    prediction: Prediction

    @property
    def others(self) -> tuple[ClosedPair, ...]:
        """Further loops that would be accepted."""
        return tuple(p for p in self.prediction.gained if (p.query, p.match) != (self.query, self.match))


@dataclass(frozen=True)
class Judgement:
    """A report as certain parameters would have had it, and what consistency then knows of its keyframe."""

    params: Loop
    report: LoopReport
    node: Node


def judge_run(
    reports: Iterable[tuple[Loop, LoopReport]],
    limits: ScoreLimits,
    earlier: Sequence[LoopKeyframe] = (),
    like: Sequence[Judgement] = (),
) -> Iterator[Judgement]:
    """Reports of consecutive keyframes, with all gates, as the parameters beside each would have had them.

    `earlier`: the keyframes of the map that the run began with.  `like`: the same with other parameters, whose results
    hold as long as nothing differs.
    """
    nodes: list[Node] = [k.node for k in earlier if k.node]
    before = earlier[-1].T_w_b if earlier else None
    as_known = True
    for (params, report), known in zip_longest(reports, like):
        assert report.keyframe == len(nodes) and report.T_w_b is not None
        arrived = arrive(nodes.__getitem__, len(nodes), report.T_w_b, before, report.odometry)
        as_known = as_known and known is not None and _consistency(params) == _consistency(known.params)
        judged = _judge(params, limits, report, arrived, known.report if as_known else None)
        as_known = as_known and _asks(judged) == _asks(known.report)
        nodes.append(known.node if as_known else settle(arrived, judged))
        before = report.T_w_b
        yield Judgement(params, judged, nodes[-1])


def _judge(
    params: Loop, limits: ScoreLimits, report: LoopReport, arrived: Arrived, known: LoopReport | None
) -> LoopReport:
    """As on-line: candidates are held against the odometry in turn, up to the one that is accepted."""
    judged = rejudge(params, limits, report)
    if not all_pass(judged.gates):
        return judged
    consistent = {c.match: c for c in known.candidates if _is_judged(c)} if known else {}
    candidates = list(judged.candidates)
    for i, candidate in enumerate(candidates):
        if all_pass(candidate.gates):
            same = consistent.get(candidate.match)
            if same and _same(same, candidate):
                candidates[i] = replace(same, gates=candidate.gates + same.gates[-2:])
            else:
                candidates[i] = judge(params, arrived, candidate)
            if all_pass(candidates[i].gates):
                break
    return decide(judged, candidates)


def _is_judged(candidate: LoopCandidate) -> bool:
    return candidate.gates[-1].name == "agreement"


def _asks(report: LoopReport) -> list[tuple[int, LoopOutcome, bytes]]:
    """What consistency learns from a report."""
    asking = (c for c in report.candidates if c.outcome in (LoopOutcome.UNCONFIRMED, LoopOutcome.ACCEPTED))
    return [(c.match, c.outcome, c.T_match_query.tobytes()) for c in asking if c.T_match_query is not None]


def _consistency(params: Loop) -> tuple[Any, ...]:
    """The parameters that what is consistent depends on."""
    names = ("consistency", "drift_inflation", "max_drift", "sure_drift", "min_agreement", "agreement_span")
    return tuple(getattr(params, name) for name in names)


def differs(a: LoopReport, b: LoopReport) -> bool:
    """Does a keyframe close another loop, or one with another pose?"""
    return not _same(a.accepted, b.accepted)


def pairs(reports: Iterable[LoopReport], truth: Callable[[int, int], Truth | None]) -> tuple[ClosedPair, ...]:
    """The loops that are accepted."""
    found = (r.accepted for r in reports)
    return tuple(ClosedPair(c.query, c.match, truth(c.query, c.match)) for c in found if c)


def _same(a: LoopCandidate | None, b: LoopCandidate | None) -> bool:
    if a is None or b is None:
        return a is b
    assert a.T_match_query is not None and b.T_match_query is not None
    return a.match == b.match and np.array_equal(a.T_match_query, b.T_match_query)
