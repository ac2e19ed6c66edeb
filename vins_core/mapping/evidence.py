"""What gates of loops compare, computed once from stored descriptors and kept: limits are another matter.

A report made here has all gates of all candidates but those of consistency, which depend on what was decided before
(counterfactual.py).  What it holds depends on the parameters in VALUES, on `loop.min_gap` and `loop.candidates`, and
on which keyframes there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from threading import Lock
from typing import Any

import numpy as np

from ..loop.keyframe import Keyframes
from ..loop.step import LoopState, Retrieved, neighbour_score, retrieve
from ..loop.verify import Pair, verify
from ..params import Loop
from ..record.reader import RunReader
from ..report import Gate, LoopCandidate, LoopOutcome, LoopReport
from .counterfactual import VALUES

KEEP_VARIANTS = 4


@dataclass(frozen=True)
class Facts:
    """What judging a keyframe again needs to know of it."""

    frame: int
    t_ns: int
    n_landmarks: int
    n_points: int
    T_w_b: np.ndarray
    odometry: np.ndarray | None


@dataclass(frozen=True)
class Shortlist:
    """The best candidates of a keyframe."""

    wanted: int  # how many were asked for
    own: tuple[Gate, ...]
    neighbour_score: float | None
    found: tuple[Retrieved, ...]


class Evidence:
    """Of one run.  Safe to use from several threads."""

    def __init__(self, run: RunReader) -> None:
        assert run.places is not None
        self._run = run
        self._limits = run.places.vocabulary.limits
        self._lock = Lock()
        self._facts: dict[int, Facts] = {}
        self._shortlists: dict[tuple[int, int], Shortlist] = {}
        self._pairs: dict[tuple[Any, ...], dict[tuple[int, int], LoopCandidate]] = {}
        self._variants: dict[Any, dict[int, LoopReport]] = {}

    def state(self) -> LoopState:
        """Of the loop stage after all keyframes there are."""
        keyframes = self._run.keyframes
        return LoopState(keyframes, self._limits, len(keyframes))

    def has(self, loop: Loop, k: int) -> bool:
        """Whether `report` costs nothing."""
        return k in self._variant(loop)

    def facts(self, k: int) -> Facts:
        if k not in self._facts:
            keyframe = self._run.keyframes[k]
            self._facts[k] = Facts(
                keyframe.frame,
                keyframe.t_ns,
                keyframe.n_landmarks,
                len(keyframe.uv_px),
                keyframe.T_w_b,
                keyframe.odometry,
            )
        return self._facts[k]

    def report(self, loop: Loop, k: int) -> LoopReport:
        """Of keyframe k among all that come before it; without matches."""
        variant = self._variant(loop)
        if k not in variant:
            variant[k] = self._report(loop, k, k, self._shortlist(loop, k), self.facts(k).odometry)
        return variant[k]

    def report_among(
        self, loop: Loop, chosen: Sequence[int], i: int, n_earlier: int, odometry: np.ndarray | None
    ) -> LoopReport:
        """Of keyframe chosen[i], had there been only the first `n_earlier` and those chosen.

        Keyframes are counted among these; `odometry` is the covariance of the motion since the one before.
        """
        before = np.concatenate([np.arange(n_earlier), np.array(chosen[:i], int)])
        k = chosen[i]
        found = self._retrieve(loop, k, self._scores(k)[before])
        named = tuple(replace(r, match=int(before[r.match])) for r in found.found)
        report = self._report(loop, k, n_earlier + i, replace(found, found=named), odometry)
        back = {int(number): row for row, number in enumerate(before)}
        candidates = tuple(replace(c, match=back[c.match]) for c in report.candidates)
        return replace(report, candidates=candidates)

    def _variant(self, loop: Loop) -> dict[int, LoopReport]:
        key = (_values(loop), loop.min_gap, loop.candidates)
        with self._lock:
            self._variants[key] = self._variants.pop(key, {})  # the newest comes last
            while len(self._variants) > KEEP_VARIANTS:
                del self._variants[next(iter(self._variants))]
            return self._variants[key]

    def _report(self, loop: Loop, k: int, number: int, short: Shortlist, odometry: np.ndarray | None) -> LoopReport:
        facts, found = self.facts(k), short.found[: loop.candidates]
        pairs = self._verified(loop, k, [r.match for r in found])
        return LoopReport(
            number,
            facts.frame,
            facts.t_ns,
            facts.n_landmarks,
            facts.n_points,
            short.neighbour_score,
            short.own,
            tuple(replace(p, query=number, score=r.score, gates=r.gates + p.gates) for r, p in zip(found, pairs)),
            LoopOutcome.TOO_RECENT,
            facts.T_w_b,
            odometry,
        )

    def _scores(self, k: int) -> np.ndarray:
        state = self.state()
        return state.index.scores(state.keyframes[k].bag)[:k]

    def _retrieve(self, loop: Loop, k: int, scores: np.ndarray) -> Shortlist:
        own, found = retrieve(replace(loop, order="best"), self._limits, self.facts(k).n_landmarks, scores)
        return Shortlist(loop.candidates, own, neighbour_score(scores), found)

    def _shortlist(self, loop: Loop, k: int) -> Shortlist:
        key = (k, loop.min_gap)
        known = self._shortlists.get(key)
        if known is None or known.wanted < loop.candidates:
            self._shortlists[key] = known = self._retrieve(loop, k, self._scores(k))
        return known

    def _verified(self, loop: Loop, query: int, matches: list[int]) -> list[LoopCandidate]:
        known = self._pairs.setdefault(_values(loop), {})
        missing = [m for m in matches if (query, m) not in known]
        if missing:
            keyframes: Keyframes = self._run.keyframes
            later = keyframes[query]
            for m in missing:
                found = verify(loop, Pair(query, m, later, keyframes[m], 0.0, ()), evaluate_all=True)
                known[query, m] = replace(found, matches=None)
        return [known[query, m] for m in matches]


def _values(loop: Loop) -> tuple[Any, ...]:
    return tuple(getattr(loop, f.name) for f in fields(loop) if f.name in VALUES)
