"""Arrays over a run say what its summaries say, and measure the error after the best rigid alignment."""

from __future__ import annotations

import numpy as np
import pytest
from fake_run import FIRST_SOLVE, FRAMES, FakeRun, fake_run

from app.series import align_se3, run_series
from vins_core.geometry import so3


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
