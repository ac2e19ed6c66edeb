"""Why loops close and do not, as the page shows it: worked out in a thread, the latest wish wins (SPEC 7.2, 9.3 a).

A wish names a keyframe, perhaps the earlier one it is held against, and the knobs.  Its answer comes in steps: what
the record says at once, then every gate of every keyframe, a few at a time, and last what would have been needed.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from vins_core.errors import VinspectError
from vins_core.mapping.counterfactual import Prediction, Remedy
from vins_core.mapping.funnel import FunnelStage
from vins_core.mapping.study import LoopRow, LoopStudy
from vins_core.mapping.truth import Place, Truth
from vins_core.record.folder import MAP
from vins_core.report import LOOP_OUTCOMES, LoopCandidate, LoopOutcome, LoopReport

from .context import RunView, Selection
from .pairs import Pairs, PairView, Wish, best

log = logging.getLogger("vinspect")

WINDOW = 15
"""Rows of the table on either side of the keyframe looked at."""
SLICE_S = 1.0
"""How long keyframes are judged before the page shows how far that is."""

FILTERS = ("all", "accepted", "refused", "missed", "wrong", "gained", "lost")
"""What the table may be narrowed to: missed are refused though the place is the same, wrong accepted elsewhere."""


@dataclass(frozen=True)
class TableRow:
    """A keyframe of the table with its best candidate."""

    row: LoopRow
    report: LoopReport
    candidate: LoopCandidate | None
    truth: Truth | None
    gained: bool = False
    lost: bool = False

    @property
    def accepted(self) -> bool:
        return self.candidate is not None and self.candidate.accepted

    def among(self, show: str) -> bool:
        match show:
            case "accepted":
                return self.accepted
            case "refused":
                return not self.accepted
            case "missed":
                return not self.accepted and self.truth is not None and self.truth.place is Place.SAME
            case "wrong":
                return self.accepted and self.truth is not None and self.truth.place is Place.ELSEWHERE
            case "gained":
                return self.gained
            case "lost":
                return self.lost
        return True


@dataclass(frozen=True)
class LoopsView:
    """What the panels show."""

    wish: Wish
    judged: int = 0  # keyframes of which every gate is known
    total: int = 0
    funnel: tuple[FunnelStage, ...] = ()
    prediction: Prediction | None = None  # of the knobs, when they differ and every gate is known
    table: tuple[TableRow, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)  # rows by filter
    pair: PairView | None = None
    remedy: Remedy | None = None
    remedy_known: bool = False
    refused: tuple[tuple[int, int], ...] = ()  # pairs that were looked at in earnest, with a pose
    problem: str = ""
    busy: bool = False

    @property
    def complete(self) -> bool:
        return self.judged == self.total


class Loops:
    """What one tab asks.  `on_answer` is called in the event loop whenever there is something new to show."""

    def __init__(self, on_answer: Callable[[], None]) -> None:
        self._on_answer = on_answer
        self._asked: Wish | None = None
        self._view: LoopsView | None = None
        self._task: asyncio.Task[None] | None = None
        self._remedies: dict[tuple[RunView, int, int, int], Remedy | None] = {}
        self._unchanged: tuple[tuple[RunView, int], Prediction] | None = None
        self._pairs = Pairs()
        self.show = "all"

    def look(
        self, run: RunView, frame: int, selection: Selection, changes: dict[str, Any], *, asking: bool
    ) -> LoopsView | None:
        """What is known about the run's loops; with `asking`, the rest is worked out.  None without loops."""
        if not has_loops(run):
            return None
        query, match = selected(run, frame, selection)
        wish = Wish(run, len(run.series.loops), query, match, tuple(sorted(changes.items())), self.show)
        view = self._view
        if asking:
            self._asked = wish
            if self._task is None and not _answered(view, wish):
                self._task = asyncio.get_running_loop().create_task(self._work())
        elif self._task is None:
            self._asked = None
        if view is None or view.wish.run is not run:
            return LoopsView(wish, busy=True)
        if view.wish != wish:
            same = (view.wish.query, view.wish.match) == (query, match)
            return replace(view, busy=True, pair=view.pair if same else None, remedy=None, remedy_known=False)
        return view

    @property
    def idle(self) -> bool:
        return self._task is None

    def close(self) -> None:
        self._asked = None
        if self._task is not None:
            self._task.cancel()

    async def _work(self) -> None:
        try:
            while (wish := self._asked) is not None and not _answered(self._view, wish):
                view = await asyncio.to_thread(self._next, wish)
                if view is not None:
                    self._view = view
                    self._on_answer()
        finally:
            self._task = None

    def _next(self, wish: Wish) -> LoopsView | None:
        """The next step of the answer; None when it was overtaken."""
        known = self._view if self._view is not None and self._view.wish == wish else None
        try:
            study = wish.run.loops
            if known is None:
                return self._answer(study, wish)
            if not known.complete:
                if left := _advance(study):
                    return replace(known, judged=known.total - left, funnel=study.funnel())
                return self._answer(study, wish)
            return self._with_remedy(study, known)
        except VinspectError as problem:
            return LoopsView(wish, problem=str(problem))
        except Exception as problem:
            log.exception("loops, keyframe %d", wish.query)
            return LoopsView(wish, problem=f"The loops could not be worked out ({type(problem).__name__}).")

    def _answer(self, study: LoopStudy, wish: Wish) -> LoopsView | None:
        rows = {row.number: row for row in study.rows() if row.number >= 0}
        left = study.advance(0)
        view = LoopsView(wish, len(rows) - left, len(rows))
        if left:
            view = replace(view, funnel=study.funnel(), **_recorded_table(study, wish, rows))
            return replace(view, pair=self._pairs.look(study, wish, rows, None))
        recorded = self._judged(study, wish)
        prediction = None
        if wish.changes:
            prediction = study.predict(dict(wish.changes), cancelled=lambda: self._asked != wish)
            if prediction is None:
                return None
        shown = prediction or recorded
        return replace(
            view,
            funnel=recorded.funnel,
            prediction=prediction,
            **_table(study, wish, rows, shown),
            refused=_refused(shown.reports),
            pair=self._pairs.look(study, wish, rows, shown),
        )

    def _judged(self, study: LoopStudy, wish: Wish) -> Prediction:
        """Every gate of the run as it was."""
        key = wish.run, wish.keyframes
        if self._unchanged is None or self._unchanged[0] != key:
            judged = study.predict({})
            assert judged is not None  # nobody cancels it
            self._unchanged = key, judged
        return self._unchanged[1]

    def _with_remedy(self, study: LoopStudy, view: LoopsView) -> LoopsView:
        wish, pair = view.wish, view.pair
        if pair is None or pair.key is None or pair.row.match == pair.key[1]:
            return replace(view, remedy_known=True)
        key = (wish.run, wish.keyframes, *pair.key)
        if key not in self._remedies:
            found = study.smallest_change(*pair.key, cancelled=lambda: self._asked != wish)
            if self._asked != wish:
                return view
            self._remedies[key] = found
        return replace(view, remedy=self._remedies[key], remedy_known=True)


def has_loops(run: RunView) -> bool:
    """Whether the run closes loops at all."""
    path = getattr(run.reader, "path", None)
    return path is not None and (path / MAP).is_dir()


def selected(run: RunView, frame: int, selection: Selection) -> tuple[int, int]:
    """(query, match) that the user picked, else the newest keyframe at the frame shown; -1: none."""
    if selection.kind == "loop":
        return selection.id, selection.other
    loops = run.series.loops
    seen = loops.keyframe[(loops.frame <= frame) & (loops.keyframe >= 0)]
    return (int(seen[-1]) if len(seen) else -1), -1


def next_candidate(run: RunView, frame: int, by: int) -> tuple[int, int] | None:
    """(frame, keyframe) of the next keyframe, or the previous one, for which an earlier one was looked at."""
    loops = run.series.loops
    rows = loops.candidate & (loops.keyframe >= 0) & ((loops.frame > frame) if by > 0 else (loops.frame < frame))
    there = rows.nonzero()[0]
    if not len(there):
        return None
    k = there[0] if by > 0 else there[-1]
    return int(loops.frame[k]), int(loops.keyframe[k])


def _answered(view: LoopsView | None, wish: Wish) -> bool:
    if view is None or view.wish != wish:
        return False
    return bool(view.problem) or (view.complete and view.remedy_known)


def _advance(study: LoopStudy) -> int:
    """Judge some more keyframes; returns how many are left."""
    end = time.monotonic() + SLICE_S
    while (left := study.advance()) and time.monotonic() < end:
        pass
    return left


def _table(study: LoopStudy, wish: Wish, rows: dict[int, LoopRow], judged: Prediction) -> dict[str, Any]:
    """Of what the knobs would have accepted: the rows near to the keyframe looked at, and how many each filter has."""
    gained, lost = ({p.query for p in pairs} for pairs in (judged.gained, judged.lost))
    every = [
        _row(study, rows[report.keyframe], report, report.keyframe in gained, report.keyframe in lost)
        for report in judged.reports
        if report.candidates
    ]
    counts = {show: sum(r.among(show) for r in every) for show in FILTERS}
    return {"table": _near([r for r in every if r.among(wish.show)], wish.query), "counts": counts}


def _recorded_table(study: LoopStudy, wish: Wish, rows: dict[int, LoopRow]) -> dict[str, Any]:
    """The same from the record, while not every gate is known: without filters."""
    listed = _near([row for row in rows.values() if row.n_candidates], wish.query, lambda row: row.number)
    reports = ((row, study.run.report(row.made_in).closure) for row in listed)
    known = [_row(study, row, said.loop) for row, said in reports if said is not None and said.loop is not None]
    return {"table": tuple(known)}


def _row(study: LoopStudy, row: LoopRow, report: LoopReport, gained: bool = False, lost: bool = False) -> TableRow:
    candidate = best(report)
    truth = study.truth(candidate.query, candidate.match) if candidate else None
    return TableRow(row, report, candidate, truth, gained, lost)


def _near(rows: Sequence[Any], query: int, number: Callable[[Any], int] = lambda r: r.row.number) -> tuple[Any, ...]:
    """The rows around a keyframe, in their order."""
    at = next((i for i, row in enumerate(rows) if number(row) >= query), len(rows) - 1)
    first = max(min(at - WINDOW, len(rows) - 2 * WINDOW - 1), 0)
    return tuple(rows[first : first + 2 * WINDOW + 1])


def _refused(reports: Iterable[LoopReport]) -> tuple[tuple[int, int], ...]:
    """Best candidates, earlier keyframe first, that got as far as a pose and were refused."""
    found = (best(r) for r in reports)
    return tuple((c.match, c.query) for c in found if c and not c.accepted and _progress(c) >= _PNP)


def _progress(candidate: LoopCandidate) -> int:
    return LOOP_OUTCOMES.index(candidate.outcome)


_PNP = LOOP_OUTCOMES.index(LoopOutcome.PNP)
