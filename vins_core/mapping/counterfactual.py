"""What other settings would have accepted over a whole run, judged again one keyframe after the other (SPEC 9.3a).

Everything that gates compare is known (rejudge.py); what is accepted early changes what is consistent later, so the
keyframes are taken in order.  As long as accepted loops do not act on the odometry (`loop.relocalize` = 0), the result
is what a fork does, over the whole run.  Where the window relocalises, it is exact up to and including the first loop
that differs: from there on the window knows something else, and only a fork shows what becomes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..loop.consistency import Node, arrive, settle
from ..loop.keyframe import LoopKeyframe
from ..loop.rejudge import rejudge
from ..loop.vocabulary import ScoreLimits
from ..params import Loop
from ..report import LoopCandidate, LoopReport
from .funnel import FunnelStage
from .truth import Place, Truth

Judged = tuple[LoopReport, ...]

VALUES = frozenset(
    {"max_hamming", "max_ratio", "cross_check", "epipolar", "epipolar_px", "epipolar_confidence", "pnp_px"}
    | {"guided_px", "heading"}
)
"""Parameters of `loop` that change what gates compare: known again from stored descriptors."""
UNANSWERED = frozenset({"enabled", "relocalize", "max_corners", "skip_first", "every", "min_spacing_m"})
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
    reports: Judged  # one a keyframe, without matches

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


def judge_run(
    reports: Iterable[tuple[Loop, LoopReport]], limits: ScoreLimits, earlier: Sequence[LoopKeyframe] = ()
) -> Iterator[LoopReport]:
    """Reports of consecutive keyframes, with all gates, as the parameters beside each would have had them.

    `earlier`: the keyframes of the map that the run began with.
    """
    nodes: list[Node] = [k.node for k in earlier if k.node]
    before = earlier[-1].T_w_b if earlier else None
    for params, report in reports:
        assert report.keyframe == len(nodes) and report.T_w_b is not None
        arrived = arrive(nodes.__getitem__, len(nodes), report.T_w_b, before, report.odometry)
        judged = rejudge(params, limits, report, arrived)
        nodes.append(settle(arrived, judged))
        before = report.T_w_b
        yield judged


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
