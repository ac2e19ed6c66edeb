"""The loops of a run, looked into on demand: every gate of every keyframe, any pair, other settings (SPEC 7.2, 9.3).

On-line a keyframe costs the gates up to its decision; here the others follow from stored descriptors, purely, and
are kept.  `advance` does so bit by bit, a few milliseconds to 30 a keyframe, for a thread in the background.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import numpy as np

from .. import params as parameters
from ..errors import RunError
from ..loop import rejudge
from ..loop.keyframe import LoopKeyframe
from ..loop.step import detect_again, examine
from ..params import DECLARATIONS, Loop, Params
from ..record.reader import RunReader
from ..record.recent import Recent
from ..report import Gate, LoopOutcome, LoopReport
from . import counterfactual, thinning
from .counterfactual import UNANSWERED, Judgement, Prediction, Remedy, judge_run
from .evidence import Evidence
from .funnel import FunnelStage, funnel
from .thinning import Admission, Offered, admissions
from .truth import Truth, revisited, true_poses, truth_of

KEEP_REPORTS = 64
REPORT_BYTES = 200_000
_THINNING = {f"loop.{name}" for name in thinning.SETTINGS}


@dataclass(frozen=True)
class LoopRow:
    """A keyframe that was offered to the loop stage, in short."""

    number: int  # counted over all sessions of the map; -1 for one that was left out
    frame: int
    made_in: int  # the frame whose step made the keyframe, and looked for its loops
    t_ns: int
    outcome: LoopOutcome
    match: int  # the keyframe that it closes a loop with, -1 for none
    n_candidates: int


class LoopStudy:
    """Of one run; follows it while it grows.  Safe to use from several threads.

    Keyframes are numbered over all sessions of the map, as in every report.
    """

    def __init__(self, run: RunReader) -> None:
        """Raises RunError when the run has no loops, MapError when the map that it began with is damaged."""
        if run.places is None:
            raise RunError(f"{run.path} has no loops: it was made with --loops off")
        self.run = run
        self.first = len(run.places.keyframes)
        """The first keyframe of the run itself; those before are of the map that it began with."""
        self._places = run.places
        self._lock = Lock()
        self._rows: list[LoopRow] = []
        self._own: list[LoopRow] = []  # those that were not left out
        self._frames_read = 0
        self._truth = np.zeros((0, 7))
        self._truths: dict[tuple[int, int], Truth | None] = {}
        self._revisits: list[bool] = []
        self._evidence = Evidence(run)
        self._motions: dict[int, np.ndarray | None] = {}
        self._advanced = 0  # keyframes of its own that have been looked into, from the first on
        self._judged: tuple[Judgement, ...] = ()
        self._reports = Recent(self._examine_all, KEEP_REPORTS)

    def rows(self) -> tuple[LoopRow, ...]:
        """One per keyframe offered, from summaries alone."""
        with self._lock:
            self._follow()
            return tuple(self._rows)

    def keyframe(self, number: int) -> LoopKeyframe:
        """Points and pose of a keyframe, also of the map that the run began with."""
        return self.run.keyframes[number]

    def report(self, keyframe: int, params: Params | None = None) -> LoopReport:
        """`detect(..., evaluate_all=True)` as of keyframe `keyframe`, by default with its own parameters.

        What was accepted before it counts as it was.  Raises IndexError for a keyframe that is not of this run.
        """
        row = self._row(keyframe)
        return self._reports((keyframe, (params or self._params(row)).loop))

    def pair(self, query: int, match: int, params: Params | None = None) -> LoopReport:
        """Every gate of any two keyframes, whether retrieval proposed them or not.

        Raises IndexError unless match < query, and query is of this run.
        """
        return examine((params or self._params(self._row(query))).loop, self._evidence.state(), query, match)

    def truth(self, query: int, match: int) -> Truth | None:
        """How two keyframes truly lie to each other; None without ground truth, and for those of an earlier map."""
        if (query, match) not in self._truths:
            known = self._true_poses()
            if max(query, match) >= len(known):
                return None
            self._truths[query, match] = truth_of(known, query, match)
        return self._truths[query, match]

    def revisits(self) -> frozenset[int] | None:
        """Keyframes that truly revisit a place: within 1 m and 30 degrees of one more than `loop.min_gap` before."""
        if self.run.truth is None:
            return None
        known = self._true_poses()
        with self._lock:
            while len(self._revisits) < len(known):
                k = len(self._revisits)
                gap = self._params(self._own[k - self.first]).loop.min_gap if k >= self.first else 0
                self._revisits.append(k >= self.first and revisited(known, k, gap))
            return frozenset(np.flatnonzero(self._revisits).tolist())

    def advance(self, n: int = 1) -> int:
        """Look into the next `n` keyframes that nobody has looked into; returns how many are left."""
        rows, first = self._own_rows(), self._advanced
        for row in rows[first : first + n]:
            self._evidence.report(self._params(row).loop, row.number)
        self._advanced = max(self._advanced, min(first + n, len(rows)))
        return len(rows) - self._advanced

    def judged(self) -> tuple[LoopReport, ...]:
        """The keyframes that `advance` has come to, as they were judged, with every gate and without matches."""
        return tuple(j.report for j in self._as_recorded(self._own_rows()[: self._advanced]))

    def funnel(self) -> tuple[FunnelStage, ...]:
        """Of what the run accepted, over the keyframes that `advance` has come to."""
        return funnel(self.judged(), self.truth, self.revisits())

    def predict(
        self,
        changes: Mapping[str, Any],
        at: int = 0,
        progress: Callable[[float], None] = lambda _: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Prediction | None:
        """What `changes` (`section.name -> value`) from frame `at` on would have accepted; None when cancelled.

        At slider speed for limits once `advance` is done; else what is missing is computed.  Raises ParameterError.
        """
        rows = self._own_rows()
        if not self._prepare(rows, {}, at, progress, cancelled):
            return None
        self._advanced = max(self._advanced, len(rows))
        answered, unanswered = _answerable(changes, can_thin=len(rows) == len(self.rows()))
        recorded = self._as_recorded(rows)
        before = tuple(j.report for j in recorded)
        after: tuple[LoopReport, ...] | None = None
        if answered.keys() & _THINNING:
            after = self._thin(rows, answered, at, progress, cancelled)
        elif self._prepare(rows, answered, at, progress, cancelled):
            after = tuple(j.report for j in self._judge(rows, answered, at, recorded))
        if after is None:
            return None
        first = next((row for row, a, b in zip(rows, before, after) if counterfactual.differs(a, b)), None)
        was, would = (counterfactual.pairs(reports, self.truth) for reports in (before, after))
        feedback = any(self._params(row).loop.relocalize for row in rows)
        exact_until = rows[-1].number if rows else -1
        if unanswered:
            exact_until = next((row.number - 1 for row in rows if row.made_in >= at), exact_until)
        elif feedback and first:
            exact_until = first.number
        return Prediction(
            dict(changes),
            would,
            tuple(p for p in would if p not in was),
            tuple(p for p in was if p not in would),
            first.number if first else None,
            first.made_in if first else None,
            exact_until,
            unanswered,
            funnel(after, self.truth, self.revisits()),
            after,
        )

    def smallest_change(
        self,
        query: int,
        match: int,
        progress: Callable[[float], None] = lambda _: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Remedy | None:
        """The smallest joint change of limits that accepts a loop; None when no limits do, or when cancelled.

        Raises IndexError as `pair`.
        """
        found = self.pair(query, match)
        judged = (*found.gates, *found.candidates[0].gates)
        changes = rejudge.smallest_change(judged)
        if changes is None:
            return None
        changes = {key: _outward(key, value, judged) for key, value in changes.items()}
        predicted = self.predict(changes, progress=progress, cancelled=cancelled)
        if predicted is None:
            return None
        accepts = any((p.query, p.match) == (query, match) for p in predicted.accepted)
        return Remedy(query, match, changes, accepts, predicted)

    def _follow(self) -> None:
        """Rows of the frames that are new."""
        summaries = self.run.summaries
        for s in summaries[self._frames_read : (end := len(summaries))]:
            said = s.closure
            if said is None or said.outcome is None:
                continue
            entry = said.keyframe
            of = summaries[s.frame - 1] if entry is None else entry  # it is the frame before that was left out
            number = -1 if entry is None else self.first + len(self._own)
            row = LoopRow(number, of.frame, s.frame, of.t_ns, said.outcome, said.match, said.n_candidates)
            self._rows.append(row)
            if entry is not None:
                self._own.append(row)
        self._frames_read = end

    def _own_rows(self) -> list[LoopRow]:
        with self._lock:
            self._follow()
            return list(self._own)

    def _row(self, keyframe: int) -> LoopRow:
        rows = self._own_rows()
        if not self.first <= keyframe < self.first + len(rows):
            raise IndexError(f"{self.run.path} has no keyframe {keyframe}: its own are {self.first} and following")
        return rows[keyframe - self.first]

    def _params(self, row: LoopRow) -> Params:
        return self.run.header.params_at(row.made_in)

    def _examine_all(self, key: tuple[int, Loop]) -> tuple[LoopReport, int]:
        keyframe, loop = key
        return detect_again(loop, self._evidence.state(), keyframe), REPORT_BYTES

    def _true_poses(self) -> np.ndarray:
        """(n, 7); NaN for the keyframes of an earlier map, whose clock may be another one."""
        with self._lock:
            self._follow()
            n = self.first + len(self._own)
            if len(self._truth) < n:
                t_ns = np.array([row.t_ns for row in self._own], np.int64)
                self._truth = np.concatenate([np.full((self.first, 7), np.nan), true_poses(self.run.truth, t_ns)])
            return self._truth

    def _changed(self, row: LoopRow, changes: Mapping[str, Any], at: int) -> Loop:
        params = self._params(row)
        return parameters.replace(params, changes).loop if row.made_in >= at else params.loop

    def _prepare(
        self,
        rows: list[LoopRow],
        changes: Mapping[str, Any],
        at: int,
        progress: Callable[[float], None],
        cancelled: Callable[[], bool],
    ) -> bool:
        """See to it that every keyframe can be judged with `changes`; False when cancelled."""
        for i, row in enumerate(rows):
            loop = self._changed(row, changes, at)
            if not self._evidence.has(loop, row.number):
                progress(i / len(rows))
                if cancelled():
                    return False
                self._evidence.report(loop, row.number)
        return True

    def _judge(
        self, rows: list[LoopRow], changes: Mapping[str, Any], at: int, like: tuple[Judgement, ...] = ()
    ) -> tuple[Judgement, ...]:
        settings = (self._changed(row, changes, at) for row in rows)
        given = ((loop, self._evidence.report(loop, row.number)) for loop, row in zip(settings, rows))
        return tuple(judge_run(given, self._places.vocabulary.limits, self._places.keyframes, like))

    def _thin(
        self,
        rows: list[LoopRow],
        changes: Mapping[str, Any],
        at: int,
        progress: Callable[[float], None],
        cancelled: Callable[[], bool],
    ) -> tuple[LoopReport, ...] | None:
        """Reports of all rows where some keyframes would not have been used; None when cancelled."""
        settings = [self._changed(row, changes, at) for row in rows]
        offered = (Offered(self._evidence.facts(row.number).T_w_b, self._motion(row)) for row in rows)
        decided = list(admissions(settings, offered, self._places.keyframes))
        used = [i for i, admission in enumerate(decided) if admission.used]
        chosen, given = [rows[i].number for i in used], []
        for n, i in enumerate(used):
            progress(n / len(used))
            if cancelled():
                return None
            report = self._evidence.report_among(settings[i], chosen, n, self.first, decided[i].odometry)
            given.append((settings[i], report))
        judged = judge_run(given, self._places.vocabulary.limits, self._places.keyframes)
        numbers = [*range(self.first), *chosen]
        found = {numbers[j.report.keyframe]: _renumbered(j.report, numbers) for j in judged}
        left_out = (_left_out(row, admission) for row, admission in zip(rows, decided))
        return tuple(found.get(row.number, out) for row, out in zip(rows, left_out))

    def _motion(self, row: LoopRow) -> np.ndarray | None:
        """Covariance of the motion since the keyframe offered before; None where that is not known."""
        if row.number not in self._motions:
            window = self.run.report(row.made_in).window
            joined = self._evidence.facts(row.number).odometry is not None
            self._motions[row.number] = window.motion if window and joined else None
        return self._motions[row.number]

    def _as_recorded(self, rows: list[LoopRow]) -> tuple[Judgement, ...]:
        """The first rows, judged as they were."""
        judged = self._judged
        if len(judged) != len(rows):
            self._judged = judged = self._judge(rows, {}, 0)
        return judged


def _answerable(changes: Mapping[str, Any], can_thin: bool) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Changes that the study answers, and parameters that it cannot.  The pose graph decides nothing about loops.

    `can_thin`: the run used every keyframe, so it is known what it would be like with fewer.
    """
    parameters.replace(Params(), changes)
    beyond = {f"loop.{name}" for name in UNANSWERED} | (set() if can_thin else _THINNING)
    unanswered = tuple(k for k in changes if k in beyond or not k.startswith(("loop.", "pose_graph.")))
    return {key: value for key, value in changes.items() if key not in unanswered}, unanswered


def _renumbered(report: LoopReport, numbers: list[int]) -> LoopReport:
    """A report whose keyframes are rows of `numbers`."""
    query = numbers[report.keyframe]
    candidates = tuple(replace(c, query=query, match=numbers[c.match]) for c in report.candidates)
    return replace(report, keyframe=query, candidates=candidates)


def _left_out(row: LoopRow, admission: Admission) -> LoopReport:
    return LoopReport(row.number, row.frame, row.t_ns, 0, 0, None, admission.gates, (), LoopOutcome.LEFT_OUT)


def _outward(key: str, value: Any, judged: tuple[Gate, ...]) -> Any:
    """A limit with three digits that lets the same values pass."""
    declared = DECLARATIONS[key]
    if declared.type is not float or not value:
        return value
    digits = 2 - int(np.floor(np.log10(abs(value))))
    step = 10.0**-digits
    lower = next(g.op for g in judged if g.knob == key).startswith(">")
    rounded = round(float((np.floor if lower else np.ceil)(value / step)) * step, max(digits, 0))
    passes = rounded <= value if lower else rounded >= value
    assert declared.low is not None and declared.high is not None
    return rounded if passes and declared.low <= rounded <= declared.high else value
