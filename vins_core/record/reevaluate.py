"""Every gate of a run as columns, judged again with other limits at slider speed (SPEC 9.3a).

Values are those of the recorded trajectory: a verdict that flips would have changed everything after it, which only a
fork shows.  Counts say how often a limit would have bitten, not what would have become of the run.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from .. import params as parameters
from ..params import Params
from ..report import FrameReport, Gate, SolveReport
from .decisions import step_gates
from .reader import RunReader

GIVEN = "given the recorded trajectory"
"""What every result of `reevaluate` must be labelled with."""

_PER_MEMBER = ("landmark kept", "eigenvalue kept", "step")
_COMPARE = {">=": np.greater_equal, ">": np.greater, "<=": np.less_equal, "<": np.less}


class Key(NamedTuple):
    """Names a gate over a run."""

    stage: str
    decision: str  # what it takes part in: the keyframe, a stage of the initialisation, health ...
    name: str
    op: str
    knob: str  # parameter that sets the limit; "" when nothing does
    unit: str


REPROJECTION = Key("landmarks", "landmark kept", "mean reprojection error", "<=", "window.max_error_px", "px460")
EIGENVALUE = Key("marginalization", "eigenvalue kept", "eigenvalue", ">", "marginalization.eigen_threshold", "")

COMPENSATE = "window.compensate_rotation"
"""Chooses which of the two recorded parallaxes is judged."""

SWITCHES = {"excitation": "init.require_excitation", REPROJECTION.name: "window.reject_outliers"}
"""Gates that a parameter can turn into mere advice."""


@dataclass(frozen=True)
class Column:
    """One gate over a run: a row each time it was evaluated."""

    key: Key
    frames: np.ndarray  # (n,) int64
    values: np.ndarray  # (n,) NaN where it could not be computed
    limits: np.ndarray  # (n,) as recorded
    decides: np.ndarray  # (n,) bool

    def __len__(self) -> int:
        return len(self.frames)

    def passed(self) -> np.ndarray:
        """(n,) bool, as `Gate.passed`."""
        with np.errstate(invalid="ignore"):
            return np.isfinite(self.values) & _COMPARE[self.key.op](self.values, self.limits)

    def stops(self) -> np.ndarray:
        """(n,) bool: did not pass, and decides."""
        return self.decides & ~self.passed()


@dataclass(frozen=True)
class Flips:
    """What other parameters make of one gate."""

    key: Key
    evaluated: int
    passed_before: int
    passed_after: int
    now_pass: np.ndarray  # frames, each once, in which it failed and would pass
    now_fail: np.ndarray  # frames, each once, in which it passed and would fail


@dataclass(frozen=True)
class Derived:
    """A decision that follows from gates: in which frames it was made, and would be."""

    name: str  # "keyframe", "healthy", "initialised", "initialization: structure passes"
    before: int
    after: int
    gained: np.ndarray  # frames in which it would be made now
    lost: np.ndarray


@dataclass(frozen=True)
class Reevaluation:
    gates: tuple[Flips, ...]  # those that a changed parameter belongs to
    derived: tuple[Derived, ...]  # those that rest on such a gate
    unanswered: tuple[str, ...]  # changed parameters that no recorded gate depends on: re-solve or fork
    label: str = GIVEN


class GateHistory:
    """All gates of a run.  Grows with it: `follow` reads the frames that are new."""

    def __init__(self) -> None:
        self.frames = 0
        self._rows: dict[Key, _Rows] = {}
        self._parallax: dict[bool, array[float]] = {True: array("d"), False: array("d")}  # compensated, raw
        self._initialised: list[int] = []

    def follow(self, run: RunReader, at_most: int | None = None) -> int:
        """Read the next frames, no more than `at_most`; returns how many are still missing."""
        end = len(run) if at_most is None else min(self.frames + at_most, len(run))
        while self.frames < end:
            self.extend(run.report(self.frames), run.header.params_at(self.frames))
        return len(run) - self.frames

    def extend(self, report: FrameReport, params: Params) -> None:
        """Take the next frame, computed with `params`."""
        for stage, decision, gate in _gates(report, params):
            value = np.nan if gate.value is None else gate.value
            key = Key(stage, decision, gate.name, gate.op, gate.knob, gate.unit)
            self._add(key, report.frame, [value], gate.limit, gate.decides)
        if report.keyframe and report.keyframe.gates:
            self._parallax[True].append(report.keyframe.parallax_px)
            self._parallax[False].append(report.keyframe.parallax_raw_px)
        if report.initialization and report.initialization.succeeded:
            self._initialised.append(report.frame)
        if report.solve and len(report.solve.visual_ids):
            errors = mean_errors(report.solve)
            self._add(REPROJECTION, report.frame, errors, params.window.max_error_px, params.window.reject_outliers)
        if report.marginalization and len(report.marginalization.eigenvalues):
            eigenvalues = report.marginalization.eigenvalues
            self._add(EIGENVALUE, report.frame, eigenvalues, params.marginalization.eigen_threshold, True)
        self.frames += 1

    def columns(self) -> dict[Key, Column]:
        """Every gate met so far, in the order of meeting."""
        return {key: rows.column(key) for key, rows in self._rows.items()}

    def reevaluate(self, changes: Mapping[str, Any]) -> Reevaluation:
        """What `changes` (`section.name -> value`) make of the gates; raises ParameterError."""
        params = parameters.replace(Params(), changes)
        new = {key: parameters.get(params, key) for key in changes}
        before = self.columns()
        after = {key: self._changed(column, new) for key, column in before.items()}
        touched = [key for key in before if after[key] is not before[key]]
        known = {k.knob for k in before} | {SWITCHES[k.name] for k in before if k.name in SWITCHES} | {COMPENSATE}
        return Reevaluation(
            tuple(_flips(before[key], after[key]) for key in touched),
            tuple(self._derive({key.decision for key in touched}, before, after)),
            tuple(key for key in new if key not in known),
        )

    def _add(self, key: Key, frame: int, values: Any, limit: float, decides: bool) -> None:
        if key not in self._rows:
            self._rows[key] = _Rows()
        self._rows[key].add(frame, values, limit, decides)

    def _changed(self, column: Column, new: Mapping[str, Any]) -> Column:
        """The column under new parameters; the same object when none of them belongs to it."""
        key, switch = column.key, SWITCHES.get(column.key.name, "")
        if key.knob in new:
            column = replace(column, limits=np.full(len(column), float(new[key.knob])))
        if switch in new:
            column = replace(column, decides=np.full(len(column), bool(new[switch])))
        if COMPENSATE in new and (key.decision, key.name) == ("keyframe", "parallax"):
            column = replace(column, values=np.array(self._parallax[new[COMPENSATE]]))
        return column

    def _derive(
        self, decisions: set[str], before: Mapping[Key, Column], after: Mapping[Key, Column]
    ) -> Iterator[Derived]:
        for decision in sorted(decisions - set(_PER_MEMBER)):
            columns = [key for key in before if key.decision == decision]
            made = np.unique(np.concatenate([before[key].frames for key in columns]))
            stopped = [
                np.unique(np.concatenate([side[key].frames[side[key].stops()] for key in columns]))
                for side in (before, after)
            ]
            if decision == "keyframe":  # made when any of its gates fails
                yield _derived("keyframe", *stopped)
            else:
                yield _derived(f"{decision} passes", *(np.setdiff1d(made, s, assume_unique=True) for s in stopped))
        stages = [key for key in before if key.stage == "initialization"]
        if {key.decision for key in stages} & decisions:
            stopped_now = [after[key].frames[after[key].stops()] for key in stages]
            done = np.array(self._initialised, np.int64)
            yield _derived("initialised", done, np.setdiff1d(done, np.concatenate(stopped_now)))


class _Rows:
    """A column while it grows."""

    def __init__(self) -> None:
        self._frames, self._values, self._limits, self._decides = array("q"), array("d"), array("d"), array("b")
        self._column: Column | None = None

    def add(self, frame: int, values: Any, limit: float, decides: bool) -> None:
        n = len(values)
        self._frames.extend([frame] * n)
        self._values.extend(values)
        self._limits.extend([limit] * n)
        self._decides.extend([decides] * n)
        self._column = None

    def column(self, key: Key) -> Column:
        if self._column is None:
            frames, values, limits = np.array(self._frames), np.array(self._values), np.array(self._limits)
            self._column = Column(key, frames, values, limits, np.array(self._decides, bool))
        return self._column


def _gates(report: FrameReport, params: Params) -> Iterator[tuple[str, str, Gate]]:
    """(stage, decision, gate) of every gate that judges the whole frame or a step of the solver."""
    yield from (("front end", "front end", g) for g in report.tracks.gates)
    if report.keyframe:
        yield from (("keyframe", "keyframe", g) for g in report.keyframe.gates)
    for stage in report.initialization.stages if report.initialization else ():
        yield from (("initialization", stage.name, g) for g in stage.gates)
    for gates in step_gates(report.solve, params) if report.solve else ():
        yield from (("solve", "step", g) for g in gates)
    if report.calibration:
        yield from (("solve", "td", g) for g in report.calibration.td_gates)
        yield from (("solve", "extrinsics", g) for g in report.calibration.extrinsic_gates)
    if report.health:
        yield from (("health", "health", g) for g in report.health.gates)
    if report.gps:
        yield from (("gps", "GPS fix", g) for fix in report.gps.fixes for g in fix.gates)
        yield from (("gps", "GPS alignment", g) for g in report.gps.gates)


def _flips(before: Column, after: Column) -> Flips:
    was, would = before.passed(), after.passed()
    return Flips(
        before.key,
        len(before),
        int(was.sum()),
        int(would.sum()),
        np.unique(before.frames[would & ~was]),
        np.unique(before.frames[was & ~would]),
    )


def _derived(name: str, before: np.ndarray, after: np.ndarray) -> Derived:
    gained, lost = (np.setdiff1d(a, b, assume_unique=True) for a, b in ((after, before), (before, after)))
    return Derived(name, len(before), len(after), gained, lost)


def mean_errors(solve: SolveReport) -> np.ndarray:
    """Mean reprojection error of each landmark solved, px460, in the order of ids: what rejection judges."""
    _, row = np.unique(solve.visual_ids, return_inverse=True)
    return np.bincount(row, solve.visual_error_px) / np.bincount(row)
