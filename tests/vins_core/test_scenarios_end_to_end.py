"""Whole runs over simulated scenarios with known truth: what must come out, and what must be refused."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from vins_core import params as parameters
from vins_core import pipeline
from vins_core.evaluation.evaluate import evaluate, run_trajectory
from vins_core.io.recording import open_recording
from vins_core.io.sync import packets
from vins_core.io.write import write_recording
from vins_core.report import FrameReport, FrameSummary, summarize
from vins_core.simulation.simulate import simulate
from vins_core.state import start


@dataclass(frozen=True)
class Run:
    reports: list[FrameReport]
    summaries: list[FrameSummary]
    truth: object

    @property
    def poses(self) -> int:
        return sum(r.pose is not None for r in self.reports)

    def outcomes(self) -> set[str]:
        return {s.name for r in self.reports if r.initialization for s in r.initialization.stages if not s.passed}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    @cache
    def estimate(scenario: str, duration_s: float, **changes) -> Run:
        simulation = simulate(scenario, seed=3, duration_s=duration_s)
        folder = tmp_path_factory.mktemp("scenario") / scenario
        write_recording(simulation.messages(), folder, "asl", settings=simulation.settings)
        params = parameters.replace(parameters.Params(), {**simulation.settings.overrides, **changes})
        state, reports, summaries = start(simulation.calibration), [], []
        with open_recording(folder) as source:
            source.use(simulation.calibration)
            for packet in packets(source, simulation.calibration, params):
                state, report, ms = pipeline.step(params, simulation.calibration, source, state, packet)
                reports.append(report)
                summaries.append(summarize(report, ms))
        return Run(reports, summaries, simulation.truth)

    return estimate


def ate_m(run: Run) -> float:
    first = run.reports[0].images[0].t_ns
    return evaluate(run_trajectory(run.summaries), run.truth, 0.006, first).ate_rmse_m


def keyframes_by_parallax(run: Run) -> list[int]:
    return [
        r.frame
        for r in run.reports
        if r.keyframe and r.keyframe.reason.startswith("mean parallax") and r.keyframe.is_keyframe
    ]


def test_standstill_never_initialises_and_the_gates_say_why(run):
    still = run("standstill", 4.0)
    assert still.poses == 0
    failed = {
        g.name
        for r in still.reports
        if r.initialization
        for s in r.initialization.stages
        for g in s.gates
        if not g.passed
    }
    assert "excitation" in failed and "parallax" in failed


def test_pure_rotation_makes_no_keyframe_by_parallax_and_no_pose(run):
    turning = run("pure_rotation", 6.0)
    assert keyframes_by_parallax(turning) == []
    assert (
        max(
            r.keyframe.parallax_raw_px
            for r in turning.reports
            if r.keyframe and r.keyframe.parallax_raw_px == r.keyframe.parallax_raw_px
        )
        > 10
    )
    assert turning.poses == 0


def test_constant_velocity_does_not_initialise_with_a_wrong_scale(run):
    gliding = run("constant_velocity", 5.0)
    assert gliding.poses == 0


def test_room_loop_starts_within_three_seconds_and_stays_within_centimetres(run):
    loop = run("room_loop", 8.0)
    first = next(r for r in loop.reports if r.pose)
    assert (first.t_ns - loop.reports[0].images[0].t_ns) * 1e-9 < 3.0
    assert ate_m(loop) < 0.03
    assert not any(r.health.outcome for r in loop.reports if r.health)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "limit_m"),
    [("room_loop", 0.04), ("image_dropout", 0.04), ("imu_gap", 0.1), ("fisheye", 0.05), ("motion_blur", 0.08)],
)
def test_a_whole_scenario_stays_near_the_truth(run, scenario, limit_m):
    whole = run(scenario, {"room_loop": 28.0, "image_dropout": 18.0}.get(scenario, 15.0))
    assert ate_m(whole) < limit_m


@pytest.mark.slow
def test_constant_velocity_initialises_after_the_glide(run):
    whole = run("constant_velocity", 14.0)
    first = next(r for r in whole.reports if r.pose)
    assert (first.t_ns - whole.reports[0].images[0].t_ns) * 1e-9 > 5.0
    assert ate_m(whole) < 0.05


@pytest.mark.slow
def test_low_texture_gives_no_wrong_trajectory(run):
    assert run("low_texture", 15.0).poses == 0 or ate_m(run("low_texture", 15.0)) < 0.2


def test_the_same_packets_give_the_same_reports(run):
    a, b = run("room_loop", 3.0), run.__wrapped__("room_loop", 3.0)
    for x, y in zip(a.reports, b.reports, strict=True):
        assert (x.pose is None) == (y.pose is None)
        if x.pose is not None:
            np.testing.assert_array_equal(x.pose.p_w_b, y.pose.p_w_b)
            np.testing.assert_array_equal(x.pose.q_w_b, y.pose.q_w_b)
            np.testing.assert_array_equal(x.landmarks.inv_depth, y.landmarks.inv_depth)
