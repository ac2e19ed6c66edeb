"""Two keyframes held against each other, as often as the knobs move: what is asked, and every gate of the answer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from vins_core import params as parameters
from vins_core.loop.rejudge import rejudge
from vins_core.mapping.counterfactual import VALUES, Prediction
from vins_core.mapping.study import LoopRow, LoopStudy
from vins_core.mapping.truth import Truth
from vins_core.report import LOOP_OUTCOMES, Gate, LoopCandidate, LoopReport

from .context import RunView
from .pair import PairPicture, pair_picture

KEEP_PAIRS = 16


@dataclass(frozen=True)
class Wish:
    """What is asked about the loops of a run."""

    run: RunView
    keyframes: int  # that the run has so far
    query: int  # a keyframe; -1: none yet
    match: int = -1  # an earlier one; -1: the candidate that came furthest
    changes: tuple[tuple[str, Any], ...] = ()  # knobs that differ from the run's
    show: str = "all"  # one of FILTERS


@dataclass(frozen=True)
class PairView:
    """Two keyframes and everything that was, or could be, compared of them."""

    row: LoopRow  # of the later keyframe
    report: LoopReport  # about the later keyframe, as the knobs stand
    candidate: LoopCandidate | None  # None: retrieval had nothing to propose
    earlier: LoopRow | None  # None: of the map that the run began with
    truth: Truth | None = None
    picture: PairPicture | None = None
    predicted: bool = False  # not what the run decided, and not certain either

    @property
    def key(self) -> tuple[int, int] | None:
        return (self.candidate.query, self.candidate.match) if self.candidate else None


def best(report: LoopReport) -> LoopCandidate | None:
    """The candidate that came furthest, of equals the one looked at first."""
    return max(report.candidates, key=lambda c: LOOP_OUTCOMES.index(c.outcome), default=None)


class Pairs:
    """Two keyframes with their matches, as often as the knobs move: only parameters that change values cost time."""

    def __init__(self) -> None:
        self._known: dict[tuple[Any, ...], tuple[LoopCandidate, PairPicture | None]] = {}

    def look(
        self, study: LoopStudy, wish: Wish, rows: dict[int, LoopRow], judged: Prediction | None
    ) -> PairView | None:
        """The keyframe asked about, held against the earlier one asked for or its best candidate."""
        query, match = wish.query, wish.match
        if query not in rows or not -1 <= match < query:
            return None
        row = rows[query]
        params = _params(study, row, wish)
        report = judged.reports[query - study.first] if judged is not None else study.report(query, params)
        if match < 0:
            found = best(report)
            if found is None:
                return PairView(row, report, None, None)
            match = found.match
        seen, picture = self._seen(study, row, match, wish)
        candidate = next((c for c in report.candidates if c.match == match), None)
        if candidate is None:  # retrieval did not propose it
            limits = study.run.places.vocabulary.limits  # type: ignore[union-attr]
            alone = replace(report, candidates=(seen,))
            candidate = rejudge(params.loop, limits, alone).candidates[0] if wish.changes else seen
        predicted = bool(wish.changes) and (judged is None or query > judged.exact_until)
        candidate = replace(candidate, gates=_all_gates(params.loop, candidate, seen), matches=seen.matches)
        return PairView(row, report, candidate, rows.get(match), study.truth(query, match), picture, predicted)

    def _seen(self, study: LoopStudy, row: LoopRow, match: int, wish: Wish) -> tuple[LoopCandidate, PairPicture | None]:
        values = tuple((k, v) for k, v in wish.changes if k.removeprefix("loop.") in VALUES)
        key = (wish.run, row.number, match, values)
        if key not in self._known:
            own = parameters.replace(study.run.header.params_at(row.made_in), dict(values))
            candidate = study.pair(row.number, match, own).candidates[0]
            keyframes, camera = study.run.keyframes, study.run.header.calibration.cameras[0].model
            picture = pair_picture(candidate, keyframes[row.number], keyframes[match], camera)
            self._known[key] = candidate, picture
            while len(self._known) > KEEP_PAIRS:
                del self._known[next(iter(self._known))]
        return self._known[key]


def _all_gates(params: parameters.Loop, judged: LoopCandidate, seen: LoopCandidate) -> tuple[Gate, ...]:
    """Those that decided, and after them the others that could be computed."""
    names = {g.name for g in judged.gates}
    others = (g for g in seen.gates if g.name not in names)
    return (*judged.gates, *(replace(g, limit=getattr(params, g.knob.split(".")[1])) for g in others))


def _params(study: LoopStudy, row: LoopRow, wish: Wish) -> parameters.Params:
    own = study.run.header.params_at(row.made_in)
    return parameters.replace(own, {k: v for k, v in wish.changes if k.startswith("loop.")})
