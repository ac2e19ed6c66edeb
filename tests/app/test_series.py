"""Arrays over a run say what its summaries say, and measure the error after the best rigid alignment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fake_run import FIRST_SOLVE, FRAMES, FakeRun, fake_run

from app.series import align_se3, run_series
from vins_core.geometry import poses, so3
from vins_core.report import ClosureSummary, FrameSummary, KeyframeEntry, LoopOutcome


@pytest.fixture(scope="module")
def run() -> FakeRun:
    return fake_run()


def test_alignment_undoes_any_rigid_motion() -> None:
    rng = np.random.default_rng(1)
    points, q, t = rng.normal(size=(40, 3)), so3.exp(np.array([0.3, -1.2, 2.0])), np.array([1.0, -2.0, 0.5])
    R, shift = align_se3(points, so3.rotate(q, points) + t)
    np.testing.assert_allclose(R, so3.to_matrix(q), atol=1e-12)
    np.testing.assert_allclose(shift, t, atol=1e-12)


def test_alignment_never_mirrors() -> None:
    points = np.random.default_rng(2).normal(size=(40, 3))
    R, _ = align_se3(points, points * [1, 1, -1])
    assert np.linalg.det(R) == pytest.approx(1)


def test_a_frame_is_a_keyframe_when_the_next_one_decided_so(run: FakeRun) -> None:
    series = run_series(run.summaries, run.truth)
    for k in range(FRAMES - 1):
        assert series.keyframe[k] == run.summaries[k + 1].is_keyframe
    assert not series.keyframe[-1]


def test_what_does_not_exist_before_the_first_solve_is_nan(run: FakeRun) -> None:
    series = run_series(run.summaries, run.truth)
    for array in (series.cost, series.p_w_b, series.error_m[:, None], series.ate_m[:, None]):
        assert np.isnan(array[:FIRST_SOLVE]).all() and np.isfinite(array[FIRST_SOLVE:]).all()


def test_the_last_ate_is_the_rmse_over_the_run_and_does_not_depend_on_the_world_of_the_truth(run: FakeRun) -> None:
    series = run_series(run.summaries, run.truth)
    assert series.ate_m[-1] == pytest.approx(np.sqrt(np.nanmean(series.error_m**2)))
    assert 0.001 < series.ate_m[-1] < 0.1  # the fake drifts by centimetres while its truth lies metres away


def test_a_run_without_truth_or_frames_has_series_too(run: FakeRun) -> None:
    assert np.isnan(run_series(run.summaries, None).ate_m).all()
    assert len(run_series([], None)) == 0


def test_events_name_failed_attempts_the_success_and_anomalies(run: FakeRun) -> None:
    events = [(e.frame, e.kind) for e in run_series(run.summaries, None).events]
    assert events == [(10, "attempt"), (11, "attempt"), (FIRST_SOLVE, "initialized"), (25, "anomaly")]


def closing(run: FakeRun, said: dict[int, ClosureSummary]) -> list[FrameSummary]:
    return [replace(s, closure=said.get(s.frame)) for s in run.summaries]


def test_corrections_are_measured_where_the_newest_frame_is(run: FakeRun) -> None:
    quarter = np.concatenate([[0, 0, 0], so3.exp(np.array([0, 0, np.pi / 2]))])
    lifted = np.array([0, 0, 0.3, 1, 0, 0, 0])
    said = ClosureSummary(None, None, -1, (), False, quarter, lifted)
    series = run_series(closing(run, {30: said}), run.truth)
    x, y, _ = series.p_w_b[30]
    assert series.moved_m[30] == pytest.approx([np.sqrt(2) * np.hypot(x, y), 0.3])
    assert series.corrections_apart_m[30] == pytest.approx(np.sqrt(2 * (x * x + y * y) + 0.09))
    assert np.isnan(series.moved_m[29]).all()


def test_a_keyframe_that_retrieval_proposed_nothing_for_is_no_candidate(run: FakeRun) -> None:
    entry = KeyframeEntry(4, 0, 29, 0, poses.IDENTITY)

    def said(outcome: LoopOutcome, match: int = -1) -> ClosureSummary:
        return ClosureSummary(entry, outcome, match, (), False, poses.IDENTITY)

    outcomes = {30: said(LoopOutcome.NOT_SIMILAR), 31: said(LoopOutcome.PNP), 32: said(LoopOutcome.ACCEPTED, 1)}
    loops = run_series(closing(run, outcomes), run.truth).loops
    assert loops.frame.tolist() == [30, 31, 32] and loops.of.tolist() == [29] * 3
    assert loops.candidate.tolist() == [False, True, True]
    assert loops.accepted.tolist() == [False, False, True]
