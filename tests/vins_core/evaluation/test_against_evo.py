"""Our errors are evo's, to 1e-6 (evo is GPL: only tests import it)."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vins_core.evaluation.associate import associate
from vins_core.evaluation.evaluate import evaluate
from vins_core.evaluation.rpe import pairs_by_path
from vins_core.geometry import so3
from vins_core.io.trajectory import read_trajectory
from vins_core.sensors import Trajectory

evo_metrics = pytest.importorskip("evo.core.metrics")
from evo.core import filters, sync  # noqa: E402
from evo.core.trajectory import PoseTrajectory3D  # noqa: E402
from evo.tools import file_interface  # noqa: E402

DATA = os.environ.get("VINS_DATA")
BASELINE = {  # file -> recording, poses, ATE as measured with evo by those who made the baseline
    "euroc_mh01_16s_mono_imu": ("euroc_mh01_16s", 144, 0.0057, 0.0106, 1.61),
    "euroc_mh01_16s_fusion_mono_imu": ("euroc_mh01_16s", 302, 0.0055, None, None),
    "sim_room_60s_mono_imu": ("sim_room_60s", 584, 0.0151, 0.0397, 0.40),
}


def to_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(trajectory.p_w_b.copy(), trajectory.q_w_b.copy(), trajectory.t_ns / 1e9)


def evo_results(truth: PoseTrajectory3D, estimate: PoseTrajectory3D, max_dt_s: float) -> dict[str, float]:
    """evo_ape -a, evo_ape -as and evo_rpe -d 1 -u m --all_pairs."""
    truth, estimate = sync.associate_trajectories(truth, estimate, max_diff=max_dt_s)
    rpe = evo_metrics.RPE(
        evo_metrics.PoseRelation.translation_part, 1.0, evo_metrics.Unit.meters, rel_delta_tol=0.1, all_pairs=True
    )
    rpe.process_data((truth, estimate))
    _, _, scale = PoseTrajectory3D(
        estimate.positions_xyz.copy(), estimate.orientations_quat_wxyz.copy(), estimate.timestamps.copy()
    ).align(truth, correct_scale=True)
    estimate.align(truth)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((truth, estimate))
    rotation = evo_metrics.APE(evo_metrics.PoseRelation.rotation_angle_deg)
    rotation.process_data((truth, estimate))
    return {
        "pairs": truth.num_poses,
        "ate_rmse_m": ape.get_statistic(evo_metrics.StatisticsType.rmse),
        "ate_max_m": ape.get_statistic(evo_metrics.StatisticsType.max),
        "rotation_rmse_deg": rotation.get_statistic(evo_metrics.StatisticsType.rmse),
        "scale": scale,
        "rpe_rmse_m": rpe.get_statistic(evo_metrics.StatisticsType.rmse),
    }


def walk(seed: int, poses: int, step_m: float = 0.08) -> tuple[Trajectory, Trajectory]:
    """A random walk sampled at 200 Hz as truth, and a noisy, scaled, displaced part of it at 10 Hz as estimate."""
    rng = np.random.default_rng(seed)
    n = poses * 20 + 40
    t_ns = 1_403_636_580_838_555_648 + np.arange(n) * 5_000_000
    p = np.cumsum(np.cumsum(rng.normal(scale=step_m / 300, size=(n, 3)), 0) * 0.02 + step_m / 20, 0)
    q = np.empty((n, 4))
    q[0] = so3.exp(rng.normal(size=3))
    for k in range(1, n):
        q[k] = so3.retract(q[k - 1], rng.normal(scale=0.01, size=3))
    truth = Trajectory(t_ns, p, q)
    rows = 20 + 20 * np.arange(poses)
    q_m, t_m = so3.exp(rng.normal(size=3)), rng.normal(size=3)
    moved = so3.rotate(q_m, p[rows] * 1.02 + rng.normal(scale=0.01, size=(poses, 3))) + t_m
    turned = so3.retract(so3.multiply(q_m, q[rows]), rng.normal(scale=0.01, size=(poses, 3)))
    jitter = rng.integers(-2_000_000, 2_000_000, poses)
    return truth, Trajectory(t_ns[rows] + jitter, moved, turned)


@pytest.mark.parametrize("seed", range(4))
def test_errors_of_a_noisy_scaled_walk_equal_those_of_evo(seed: int) -> None:
    truth, estimate = walk(seed, 120)
    ours, theirs = evaluate(estimate, truth, 0.006), evo_results(to_evo(truth), to_evo(estimate), 0.006)
    assert {k: getattr(ours, k) for k in theirs} == pytest.approx(theirs, abs=1e-6, rel=0)


def test_a_truth_sparser_than_the_estimate_is_associated_as_evo_does() -> None:
    estimate, truth = walk(3, 60)  # the 200 Hz one is the estimate now
    ours, theirs = evaluate(estimate, truth, 0.006), evo_results(to_evo(truth), to_evo(estimate), 0.006)
    assert ours.poses > ours.pairs == 60
    assert {k: getattr(ours, k) for k in theirs} == pytest.approx(theirs, abs=1e-6, rel=0)


stamps = st.lists(st.integers(0, 4000), min_size=1, max_size=40, unique=True).map(sorted)


@settings(max_examples=200, deadline=None)
@given(stamps, stamps, st.integers(0, 200))
def test_stamps_are_paired_as_evo_pairs_them(a: list[int], b: list[int], max_ms: int) -> None:
    """Quarters of a second are exact in floating point, so that ties and limits mean the same to both."""
    a_s, b_s = np.array(a) * 0.25, np.array(b) * 0.25
    long_is_b = len(b) > len(a)
    short, long = (a_s, b_s) if long_is_b else (b_s, a_s)
    i, j = sync.matching_time_indices(short, long, max_ms * 0.25)
    ours = associate(np.array(a) * 250_000_000, np.array(b) * 250_000_000, max_ms * 0.25)
    assert [list(rows) for rows in (ours if long_is_b else ours[::-1])] == [i, j]


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 120), st.sampled_from([0.02, 0.1, 0.4, 0.95, 3.0]))
def test_pairs_by_path_are_those_of_evo(seed: int, poses: int, step_m: float) -> None:
    rng = np.random.default_rng(seed)
    steps = rng.normal(scale=step_m, size=(poses, 3)) * (rng.random((poses, 1)) > 0.3)  # with standstills: ties
    p = np.cumsum(steps, 0)
    Ts = np.tile(np.eye(4), (poses, 1, 1))
    Ts[:, :3, 3] = p
    i, j = pairs_by_path(p, 1.0)
    assert list(zip(i, j, strict=True)) == filters.filter_pairs_by_path(Ts, 1.0, 0.1, all_pairs=True)


@pytest.mark.skipif(not DATA, reason="needs the recordings named by VINS_DATA")
@pytest.mark.parametrize("name", BASELINE)
def test_errors_of_the_original_systems_equal_those_of_evo(name: str) -> None:
    recording, poses, ate_m, max_m, rotation_deg = BASELINE[name]
    estimate_file = Path(DATA or "") / "cpp_baseline" / f"{name}.tum"
    truth_file = Path(DATA or "") / recording / "mav0/state_groundtruth_estimate0/data.csv"
    ours = evaluate(read_trajectory(estimate_file), read_trajectory(truth_file), 0.006)
    theirs = evo_results(
        file_interface.read_euroc_csv_trajectory(str(truth_file)),
        file_interface.read_tum_trajectory_file(str(estimate_file)),
        0.006,
    )
    assert {k: getattr(ours, k) for k in theirs} == pytest.approx(theirs, abs=1e-6, rel=0)
    assert ours.poses == poses
    assert ours.ate_rmse_m == pytest.approx(ate_m, abs=6e-5)
    if max_m and rotation_deg:
        assert ours.ate_max_m == pytest.approx(max_m, abs=6e-5)
        assert ours.rotation_rmse_deg == pytest.approx(rotation_deg, abs=6e-3)
