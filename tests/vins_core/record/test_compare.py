from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import record_samples as samples
from sample import INITIALISED

from vins_core import params as parameters
from vins_core.evaluation.evaluate import evaluate, run_trajectory
from vins_core.params import DECLARATIONS, Params
from vins_core.record.compare import MAX_DT_S, Difference, compare, differing_decision, differing_number
from vins_core.record.decisions import STAGES, decisions
from vins_core.record.folder import HEADER
from vins_core.record.fork import fork
from vins_core.record.header import to_json
from vins_core.record.reader import RunReader
from vins_core.record.writer import RunWriter
from vins_core.report import LANDMARK_STATUSES, LOSS_REASONS, FrameReport, Gate, LandmarkStatus, LossReason, Status

AT = 16


@pytest.fixture(scope="module")
def run(sample_run: Path) -> RunReader:
    return RunReader(sample_run)


def forked(run: RunReader, out: Path, changes: dict, frames: int = 10, at: int = AT) -> RunReader:
    fork(run, at, out, changes, frames)
    return RunReader(out)


@pytest.mark.parametrize(
    ("changes", "stage", "gate", "cause"),
    [
        ({"window.keyframe_parallax": 4.0}, "keyframe", "parallax", "limit"),
        ({"window.keyframe_min_tracked": 150}, "keyframe", "tracked", "limit"),
        ({"window.max_error_px": 1.0}, "landmarks", "mean reprojection error", "limit"),
        ({"window.max_iterations": 2}, "solve", "iterations", "limit"),
        ({"solver.function_tolerance": 1e-3}, "solve", "fall of the cost", "limit"),
        ({"marginalization.eigen_threshold": 0.01}, "marginalization", "eigenvalue", "limit"),
        ({"frontend.max_gap_s": 0.1}, None, "", ""),
        ({"health.max_acc_bias": 0.1}, "health", "accelerometer bias", "limit"),
        ({"frontend.max_cnt": 100}, "front end", "new tracks", ""),
        ({"frontend.F_threshold": 0.2}, "front end", "tracks lost: F-RANSAC", ""),
        ({"frontend.flow_back_px": 0.1}, "front end", "tracks lost: flow-back", ""),
        ({"window.size": 8}, "solve", "frames in the window", ""),
        ({"window.min_observations": 5}, "solve", "landmarks solved", ""),
    ],
)
def test_the_first_difference_is_one_that_the_changed_parameter_can_cause(
    run: RunReader, tmp_path: Path, changes: dict, stage: str | None, gate: str, cause: str
) -> None:
    other = forked(run, tmp_path / "fork", changes)
    found = compare(run, other)
    assert [s.key for s in found.parameters] == list(changes)
    if stage is None:
        assert found.first_difference is None and found.first_number is None
        return
    first = found.first_difference
    assert first is not None and first.frame >= AT
    assert (first.stage, first.gate, first.cause) == (stage, gate, cause)
    assert first.knob in changes
    assert found.first_number is None  # nothing had changed before this decision
    if cause == "limit":
        assert first.first.value == first.second.value and first.first.limit != first.second.limit
        assert first.second.limit == changes[first.knob]
        assert first.first.passed is not first.second.passed


def test_numbers_may_differ_long_before_a_decision_does(run: RunReader, tmp_path: Path) -> None:
    found = compare(run, forked(run, tmp_path / "fork", {"imu.acc_w_scale": 1.01}))
    assert found.first_number is not None
    assert (found.first_number.frame, found.first_number.stage) == (AT, "solve")
    assert found.first_number.path.startswith("solve.") and 0 < found.first_number.largest < 1.0
    assert found.first_difference is None or found.first_difference.frame > AT


def test_an_advisory_gate_decides_nothing(run: RunReader, tmp_path: Path) -> None:
    found = compare(run, forked(run, tmp_path / "fork", {"frontend.min_tracks": 500}, frames=3))
    assert found.first_difference is None and found.first_number is None
    assert [s.key for s in found.parameters] == ["frontend.min_tracks"]


def test_a_shorter_run_differs_in_nothing_as_far_as_it_goes(run: RunReader, tmp_path: Path) -> None:
    found = compare(run, forked(run, tmp_path / "fork", {}, frames=3))
    assert found.frames_compared == AT + 3 and found.first_difference is None and found.first_number is None
    assert found.parameters == found.environment == found.input == found.calibration == ()


def test_comparing_the_other_way_round_swaps_the_sides(run: RunReader, tmp_path: Path) -> None:
    other = forked(run, tmp_path / "fork", {"window.keyframe_parallax": 4.0})
    a, b = compare(run, other).first_difference, compare(other, run).first_difference
    assert a is not None and b is not None
    assert (a.frame, a.gate, a.first, a.second) == (b.frame, b.gate, b.second, b.first)


def test_metrics_are_those_of_eval_over_the_run_and_over_what_both_have(run: RunReader, tmp_path: Path) -> None:
    other = forked(run, tmp_path / "fork", {"window.pixel_sigma": 3.0}, frames=14)
    a, b = compare(run, other).metrics
    first_image_ns = run.report(0).images[0].t_ns
    assert run.truth is not None
    assert a.accuracy == evaluate(run_trajectory(run.summaries), run.truth, MAX_DT_S, first_image_ns)
    assert (a.frames, b.frames) == (len(run), AT + 14) and (a.poses, b.poses) == (len(run) - INITIALISED, 14 + AT - 11)
    assert a.accuracy_common is not None and b.accuracy_common is not None
    assert a.accuracy_common.poses == b.accuracy_common.poses == b.poses
    assert b.accuracy is not None and b.accuracy_common.ate_rmse_m == b.accuracy.ate_rmse_m
    assert a.initialised_frame == b.initialised_frame == INITIALISED
    assert a.keyframes == sum(bool(s.is_keyframe) for s in run.summaries) and a.restarts == 0
    assert a.cost is not None and b.cost is not None and a.cost.visual > 2 * b.cost.visual  # the same errors, 2 sigma


def test_what_was_set_differently_is_told_apart(run: RunReader, tmp_path: Path) -> None:
    noise = replace(run.header.calibration.noise, acc_n=1.0)
    header = replace(
        run.header,
        calibration=replace(run.header.calibration, noise=noise),
        start_s=1.0,
        recording="other.bag",
        backend="abacus",
        versions={**run.header.versions, "numpy": "0"},
        params=parameters.replace(run.header.params, {"window.size": 9}),
    )
    with RunWriter(tmp_path / "run", header):
        pass
    found = compare(run, RunReader(tmp_path / "run"))
    assert [s.key for s in found.parameters] == ["window.size"]
    assert [(s.key, s.second) for s in found.calibration] == [("calibration.noise.acc_n", 1.0)]
    assert {s.key for s in found.input} == {"recording", "start_s"}
    assert {s.key for s in found.environment} == {"backend", "versions.numpy"}
    assert found.frames_compared == 0 and found.first_difference is None
    assert found.metrics[1].poses == 0 and found.metrics[1].accuracy_common is not None


def test_a_comparison_is_plain_data(run: RunReader, tmp_path: Path) -> None:
    other = forked(run, tmp_path / "fork", {"frontend.F_threshold": 0.2})
    document = msgspec.json.decode(msgspec.json.encode(compare(run, other)))
    first = document["first_difference"]
    assert {"frame", "stage", "gate", "first", "second", "knob", "cause", "sentence"} <= first.keys()
    assert first["first"]["ids"] or first["second"]["ids"]
    assert document["runs"][1]["parent"]["frame"] == AT


# -- decisions, one by one ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def report() -> FrameReport:
    return next(f[0] for f in samples.frames(12) if f[0].frame == 11)


def tipped(a: FrameReport, b: FrameReport, params: Params | None = None) -> Difference:
    found = differing_decision(a, b, Params(), params or Params())
    assert found is not None
    return found


def test_equal_reports_agree(report: FrameReport) -> None:
    assert differing_decision(report, report, Params(), Params()) is None
    assert differing_number(report, report) is None


def test_decisions_come_in_the_order_of_deciding(run: RunReader) -> None:
    for k in (0, INITIALISED, 20):
        order = [STAGES.index(d.stage) for d in decisions(run.report(k), run.header.params)]
        assert order == sorted(order)


def test_every_knob_of_a_decision_is_a_parameter(run: RunReader) -> None:
    for k in range(len(run)):
        for decision in decisions(run.report(k), run.header.params):
            assert {decision.knob, *(g.knob for g in decision.gates)} <= DECLARATIONS.keys() | {""}, decision


def test_a_track_lost_for_another_reason_is_a_difference(report: FrameReport) -> None:
    reason = report.tracks.lost_reason.copy()
    reason[2] = LOSS_REASONS.index(LossReason.RANSAC)
    found = tipped(report, replace(report, tracks=replace(report.tracks, lost_reason=reason)))
    assert (found.stage, found.decision) == ("front end", "tracks lost: flow failed")
    assert found.first.ids == (2,) and found.second.ids == ()


def test_a_landmark_rejected_by_one_alone_is_shown_with_its_error(report: FrameReport) -> None:
    assert report.landmarks is not None and report.solve is not None
    status = report.landmarks.status.copy()
    ids = report.solve.visual_ids.copy()
    ids[:3] = report.landmarks.ids[5]
    a = replace(report, solve=replace(report.solve, visual_ids=ids))
    status[5] = LANDMARK_STATUSES.index(LandmarkStatus.OUTLIER)
    found = tipped(a, replace(a, landmarks=replace(report.landmarks, status=status)))
    assert (found.stage, found.gate, found.knob) == ("landmarks", "mean reprojection error", "window.max_error_px")
    errors = a.solve.visual_error_px[ids == report.landmarks.ids[5]] if a.solve else np.zeros(0)
    assert found.first.value == pytest.approx(float(errors.mean())) and found.second.ids == (5,)


def test_a_step_accepted_by_one_alone_is_shown_with_its_gain_ratio(report: FrameReport) -> None:
    assert report.solve is not None
    steps = list(report.solve.iterations)
    steps[3] = replace(steps[3], accepted=False, gain_ratio=-0.5)
    found = tipped(report, replace(report, solve=replace(report.solve, iterations=tuple(steps))))
    assert (found.stage, found.decision, found.gate) == ("solve", "step 4", "gain ratio")
    assert (found.first.value, found.second.value) == (0.9, -0.5) and found.cause == "value"


def test_what_only_one_run_decided_is_a_difference(report: FrameReport) -> None:
    found = tipped(report, replace(report, solve=None, window=None, landmarks=None, health=None, marginalization=None))
    assert (found.stage, found.second.outcome) == ("solve", "not decided")
    found = tipped(report, replace(report, status=Status.FAILED))
    assert (found.stage, found.first.outcome, found.second.outcome) == ("status", "tracking", "failed, restarting")


def test_a_failing_gate_that_changes_no_outcome_is_no_difference(report: FrameReport) -> None:
    """Either gate alone makes a keyframe."""
    assert report.keyframe is not None

    def keyframe(parallax: float) -> FrameReport:
        gates = (Gate("tracked", 5, ">=", 20), Gate("parallax", parallax, "<", 10))
        assert report.keyframe is not None
        return replace(report, keyframe=replace(report.keyframe, gates=gates))

    assert differing_decision(keyframe(9.0), keyframe(11.0), Params(), Params()) is None
    number = differing_number(keyframe(9.0), keyframe(11.0))
    assert number is not None and (number.path, number.largest) == ("keyframe.gates[1].parallax", 2.0)


def test_numbers_that_do_not_exist_on_both_sides_agree(report: FrameReport) -> None:
    assert report.keyframe is not None

    def with_parallax(px: float) -> FrameReport:
        assert report.keyframe is not None
        return replace(report, keyframe=replace(report.keyframe, parallax_px=px))

    assert differing_number(with_parallax(np.nan), with_parallax(np.nan)) is None
    found = differing_number(with_parallax(np.nan), with_parallax(1.0))
    assert found is not None and found.path == "keyframe.parallax_px"


def test_a_number_that_only_one_side_has_is_infinitely_different(report: FrameReport) -> None:
    assert report.landmarks is not None
    error = report.landmarks.error_px.copy()
    error[3] = np.nan
    found = differing_number(report, replace(report, landmarks=replace(report.landmarks, error_px=error)))
    assert found is not None and found.largest == np.inf


def test_a_single_bit_of_an_array_is_found(report: FrameReport) -> None:
    assert report.solve is not None
    errors = report.solve.visual_error_px.copy()
    errors[100] = np.nextafter(errors[100], np.float32(9))
    found = differing_number(report, replace(report, solve=replace(report.solve, visual_error_px=errors)))
    assert found is not None and found.path == "solve.visual_error_px" and 0 < found.largest < 1e-6


def test_limits_are_no_numbers_of_the_run(report: FrameReport) -> None:
    assert report.health is not None
    gates = tuple(dataclasses.replace(g, limit=99.0) for g in report.health.gates)
    assert differing_number(report, replace(report, health=replace(report.health, gates=gates))) is None


def test_a_header_of_another_run_is_not_touched(run: RunReader) -> None:
    assert (run.path / HEADER).read_bytes() == to_json(run.header)
