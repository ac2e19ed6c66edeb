from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import record_samples as samples

from vins_core import params as parameters
from vins_core.errors import ParameterError
from vins_core.params import DECLARATIONS, Params
from vins_core.record.fork import fork
from vins_core.record.reader import RunReader
from vins_core.record.reevaluate import GIVEN, Column, Derived, Flips, GateHistory
from vins_core.report import FrameReport, Gate, InitReport, InitStage
from vins_core.whatif import resolve


@pytest.fixture(scope="module")
def run(sample_run: Path) -> RunReader:
    return RunReader(sample_run)


@pytest.fixture(scope="module")
def history(run: RunReader) -> GateHistory:
    history = GateHistory()
    assert history.follow(run) == 0
    return history


def flips(history: GateHistory, name: str, changes: dict) -> Flips:
    return next(f for f in history.reevaluate(changes).gates if f.key.name == name)


def derived(history: GateHistory, name: str, changes: dict) -> Derived:
    return next(d for d in history.reevaluate(changes).derived if d.name == name)


def column(history: GateHistory, stage: str, name: str) -> Column:
    return next(c for k, c in history.columns().items() if (k.stage, k.name) == (stage, name))


def gates_of(report: FrameReport) -> list[Gate]:
    stages = report.initialization.stages if report.initialization else ()
    gates = [*report.tracks.gates, *(g for s in stages for g in s.gates)]
    return gates + [g for part in (report.keyframe, report.health) if part for g in part.gates]


def test_every_gate_of_every_report_is_in_a_column(run: RunReader, history: GateHistory) -> None:
    held = [
        (int(f), key.name, float(v), float(limit), bool(p), bool(d))
        for key, c in history.columns().items()
        if key.stage in ("front end", "keyframe", "initialization", "health")
        for f, v, limit, p, d in zip(c.frames, c.values, c.limits, c.passed(), c.decides)
    ]
    expected = [
        (k, g.name, np.nan if g.value is None else g.value, g.limit, g.passed, g.decides)
        for k in range(len(run))
        for g in gates_of(run.report(k))
    ]
    assert sorted(map(repr, held)) == sorted(map(repr, expected))


def test_recorded_limits_flip_nothing(run: RunReader, history: GateHistory) -> None:
    same = {key: parameters.get(run.header.params, key) for key in DECLARATIONS}
    found = history.reevaluate(same)
    assert found.label == GIVEN and found.gates
    for gate in found.gates:
        assert gate.passed_before == gate.passed_after and len(gate.now_pass) == len(gate.now_fail) == 0, gate.key
    for decision in found.derived:
        assert len(decision.gained) == len(decision.lost) == 0 and decision.before == decision.after, decision.name


def test_keyframes_are_counted_as_recorded_and_as_they_would_be(run: RunReader, history: GateHistory) -> None:
    reports = [run.report(k) for k in range(len(run))]
    judged = [r for r in reports if r.keyframe and r.keyframe.gates]
    found = derived(history, "keyframe", {"window.keyframe_parallax": 4.0})
    assert found.before == sum(r.keyframe.is_keyframe for r in judged if r.keyframe)
    would = [r.frame for r in judged if r.keyframe and (r.keyframe.parallax_px >= 4.0 or r.keyframe.tracked < 20)]
    was = [r.frame for r in judged if r.keyframe and r.keyframe.is_keyframe]
    assert found.gained.tolist() == sorted(set(would) - set(was)) and len(found.lost) == 0
    assert found.after == len(would) > found.before


def test_a_flip_is_what_the_what_if_of_that_frame_decides(run: RunReader, history: GateHistory) -> None:
    changes = {"window.keyframe_parallax": 4.0}
    found = derived(history, "keyframe", changes)
    for k in (int(found.gained[0]), int(found.gained[-1])):
        again = resolve(run, k, parameters.replace(run.header.params, changes))
        assert again.after.keyframe is not None and again.after.keyframe.is_keyframe
        assert again.before.keyframe is not None and not again.before.keyframe.is_keyframe


def test_the_other_parallax_is_judged_too(run: RunReader, history: GateHistory) -> None:
    found = derived(history, "keyframe", {"window.compensate_rotation": False})
    for k in range(len(run)):
        report = run.report(k).keyframe
        if report and report.gates:
            would = report.tracked < 20 or not report.parallax_raw_px < 10.0
            assert (k in found.gained) == (would and not report.is_keyframe)
            assert (k in found.lost) == (not would and report.is_keyframe)


def test_landmarks_are_judged_by_the_errors_that_judged_them(run: RunReader, history: GateHistory) -> None:
    limit = 1.0
    found = flips(history, "mean reprojection error", {"window.max_error_px": limit})
    errors = {}
    for k in range(len(run)):
        solve = run.report(k).solve
        for id in np.unique(solve.visual_ids) if solve else ():
            errors[k, id] = solve.visual_error_px[solve.visual_ids == id].astype(float).mean()
    assert found.evaluated == len(errors)
    assert found.passed_after == sum(e <= limit for e in errors.values())
    assert found.now_fail.tolist() == sorted({k for (k, _), e in errors.items() if limit < e <= 3.0})
    assert len(flips(history, "mean reprojection error", {"window.max_error_px": 30.0}).now_fail) == 0


def test_eigenvalues_and_solver_steps_are_judged(run: RunReader, history: GateHistory) -> None:
    threshold = 1.0
    found = flips(history, "eigenvalue", {"marginalization.eigen_threshold": threshold})
    reports = [run.report(k) for k in range(len(run))]
    kinds = [r.marginalization for r in reports if r.marginalization and r.marginalization.kind != "none"]
    assert found.passed_before == sum(m.rank for m in kinds)
    assert found.passed_after == sum(int((m.eigenvalues > threshold).sum()) for m in kinds) < found.passed_before
    found = flips(history, "iterations", {"window.max_iterations": 3})
    longer = [r.frame for r in reports if r.solve and len(r.solve.iterations) >= 3]
    assert found.now_fail.tolist() == longer


def frame(k: int, **changes: object) -> FrameReport:
    report = next(samples.frames(1))[0]
    bare = replace(report, frame=k, keyframe=None, solve=None, health=None, marginalization=None)
    return replace(bare, **changes)  # type: ignore[arg-type]


def attempt(k: int, excitation: float, matches: float) -> FrameReport:
    gates = (Gate("excitation", excitation, ">=", 0.25, "init.min_excitation"),)
    stages = [InitStage("excitation", gates, "" if gates[0].passed else "move")]
    gates = (Gate("matches", matches, ">", 20, "init.min_matches"),)
    stages.append(InitStage("relative pose", gates, "" if gates[0].passed else "few"))
    done = all(s.passed for s in stages)
    return frame(k, initialization=InitReport(tuple(stages), done, 0, None, None, None))


def test_stages_of_the_initialisation_are_derived_from_their_gates() -> None:
    history = GateHistory()
    for k, (excitation, matches) in enumerate([(0.1, 10), (0.3, 10), (0.3, 15), (0.4, 30), (0.2, 40)]):
        history.extend(attempt(k, excitation, matches), Params())
    found = derived(history, "relative pose passes", {"init.min_matches": 12})
    assert (found.before, found.after, found.gained.tolist(), found.lost.tolist()) == (2, 3, [2], [])
    assert derived(history, "initialised", {"init.min_matches": 35}).lost.tolist() == [3]
    found = derived(history, "excitation passes", {"init.require_excitation": False})
    assert (found.before, found.after, found.gained.tolist()) == (3, 5, [0, 4])
    assert derived(history, "initialised", {"init.min_excitation": 0.0}).after == 1  # what never ran stays unknown


def test_a_value_that_could_not_be_computed_never_passes() -> None:
    history = GateHistory()
    for k, value in enumerate([None, np.nan, np.inf, 1.0]):
        gate = Gate("F-RANSAC inliers", value, ">=", 0.7, "frontend.min_inlier_share", decides=False)
        history.extend(frame(k, tracks=replace(frame(0).tracks, gates=(gate,))), Params())
    assert column(history, "front end", "F-RANSAC inliers").passed().tolist() == [False, False, False, True]
    assert flips(history, "F-RANSAC inliers", {"frontend.min_inlier_share": 0.0}).passed_after == 1


def test_advice_stops_nothing(history: GateHistory) -> None:
    found = derived(history, "health passes", {"health.min_tracked": 50, "health.max_rotation_deg": 1.0})
    assert found.before == found.after
    assert len(derived(history, "health passes", {"health.max_acc_bias": 0.1}).lost) > 0


def test_what_no_recorded_gate_depends_on_is_said(history: GateHistory) -> None:
    changes = {"window.pixel_sigma": 2.0, "frontend.klt_window": 15, "window.keyframe_parallax": 12}
    assert history.reevaluate(changes).unanswered == ("window.pixel_sigma", "frontend.klt_window")


def test_a_history_grows_with_its_run(run: RunReader, history: GateHistory) -> None:
    growing = GateHistory()
    left = []
    while growing.follow(run, at_most=10):
        left.append(len(run) - growing.frames)
        growing.reevaluate({"window.keyframe_parallax": 4.0})
    assert left == [26, 16, 6] and growing.follow(run) == 0
    for key, whole in history.columns().items():
        mine = growing.columns()[key]
        for name in ("frames", "values", "limits", "decides"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(whole, name))


def test_frames_of_a_fork_are_held_against_the_limits_they_were_computed_with(run: RunReader, tmp_path: Path) -> None:
    fork(run, 20, tmp_path / "fork", {"window.max_error_px": 1.0}, frames=3)
    history = GateHistory()
    history.follow(RunReader(tmp_path / "fork"))
    errors = column(history, "landmarks", "mean reprojection error")
    assert {float(v) for v in errors.limits[errors.frames < 20]} == {3.0}
    assert {float(v) for v in errors.limits[errors.frames >= 20]} == {1.0}


def test_a_wrong_parameter_is_refused(history: GateHistory) -> None:
    with pytest.raises(ParameterError, match=r"health.max_jump_m=0.03: expected float from"):
        history.reevaluate({"health.max_jump_m": 0.03})


def test_nothing_is_known_of_an_empty_run() -> None:
    found = GateHistory().reevaluate({"window.keyframe_parallax": 4.0})
    assert found.gates == found.derived == ()
