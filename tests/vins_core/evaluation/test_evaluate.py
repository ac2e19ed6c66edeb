from __future__ import annotations

import numpy as np
import pytest

from vins_core.errors import RecordingError
from vins_core.evaluation.align import align
from vins_core.evaluation.evaluate import evaluate
from vins_core.geometry import so3
from vins_core.sensors import Trajectory


def trajectory(p: np.ndarray, q: np.ndarray | None = None, t0_ns: int = 10**18) -> Trajectory:
    rng = np.random.default_rng(1)
    q = so3.exp(rng.normal(size=(len(p), 3))) if q is None else q
    return Trajectory(t0_ns + np.arange(len(p)) * 100_000_000, p, q)


@pytest.fixture
def points() -> np.ndarray:
    return np.cumsum(np.random.default_rng(0).normal(scale=0.2, size=(60, 3)), 0)


def test_alignment_recovers_a_similarity_exactly(points: np.ndarray) -> None:
    R, t = so3.to_matrix(so3.exp(np.array([0.3, -1.2, 2.0]))), np.array([4.0, -5.0, 6.0])
    found = align(points, 1.7 * points @ R.T + t, with_scale=True)
    assert found.scale == pytest.approx(1.7, rel=1e-12)
    np.testing.assert_allclose(found.R, R, atol=1e-12)
    np.testing.assert_allclose(found.t, t, atol=1e-11)


def test_alignment_is_a_rotation_even_for_a_mirror_image(points: np.ndarray) -> None:
    assert np.linalg.det(align(points, points * [1, 1, -1]).R) == pytest.approx(1.0)


def test_no_alignment_beats_the_one_found(points: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    target = points + rng.normal(scale=0.05, size=points.shape)
    best = align(points, target)
    cost = np.sum((target - best.apply(points)) ** 2)
    for _ in range(50):
        R = so3.to_matrix(so3.exp(rng.normal(scale=0.01, size=3))) @ best.R
        t = best.t + rng.normal(scale=0.01, size=3)
        assert np.sum((target - points @ R.T - t) ** 2) > cost


def test_an_estimate_displaced_as_a_whole_has_no_error(points: np.ndarray) -> None:
    truth = trajectory(points)
    q = so3.exp(np.array([0.0, 0.5, -2.0]))
    moved = trajectory(so3.rotate(q, points) + np.array([1, 2, 3]), so3.multiply(q, truth.q_w_b))
    found = evaluate(moved, truth, 0.006, truth.t_ns[0] - 1_600_000_000)
    assert (found.poses, found.pairs, found.first_pose_s) == (60, 60, 1.6)
    assert found.scale == pytest.approx(1.0, abs=1e-12)
    for error in (found.ate_rmse_m, found.ate_max_m, found.rpe_rmse_m, found.rotation_rmse_deg):
        assert error == pytest.approx(0.0, abs=1e-6)


def test_scale_is_what_the_estimate_must_be_multiplied_by(points: np.ndarray) -> None:
    assert evaluate(trajectory(points * 0.5), trajectory(points), 0.006).scale == pytest.approx(2.0)


def test_a_run_that_never_initialised_has_no_errors_rather_than_zero(points: np.ndarray) -> None:
    nothing = trajectory(points[:0])
    found = evaluate(nothing, trajectory(points), 0.006, 10**18)
    assert (found.poses, found.pairs) == (0, 0)
    assert (found.ate_rmse_m, found.scale, found.rpe_rmse_m, found.first_pose_s) == (None, None, None, None)


def test_truth_without_orientation_gives_positions_only(points: np.ndarray) -> None:
    found = evaluate(trajectory(points), trajectory(points, np.full((60, 4), np.nan)), 0.006)
    assert found.ate_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert found.rotation_rmse_deg is None and found.rpe_rmse_m is None


def test_motion_along_a_line_leaves_the_rotation_error_open() -> None:
    line = np.outer(np.linspace(0, 5, 40), [1.0, 2.0, -1.0])
    found = evaluate(trajectory(line), trajectory(line), 0.006)
    assert found.ate_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert found.rotation_rmse_deg is None


def test_standing_still_has_no_scale_and_no_drift() -> None:
    still = np.zeros((30, 3))
    found = evaluate(trajectory(still), trajectory(still), 0.006)
    assert found.scale is None and found.rpe_rmse_m is None


def test_truth_of_another_time_is_an_error_that_names_both_spans(points: np.ndarray) -> None:
    with pytest.raises(RecordingError, match=r"only 0 of 60 poses have truth within 0.006 s.*--max-dt"):
        evaluate(trajectory(points), trajectory(points, t0_ns=2 * 10**18), 0.006)


def test_truth_rows_that_are_not_finite_are_left_out(points: np.ndarray) -> None:
    holes = points.copy()
    holes[10:20] = np.nan
    assert evaluate(trajectory(points), trajectory(holes), 0.006).pairs == 50
