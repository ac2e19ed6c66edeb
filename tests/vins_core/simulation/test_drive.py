import numpy as np
import pytest

from vins_core.geometry import poses, so3
from vins_core.simulation.drive import Drive, OdometryError, Receiver, drive

PERFECT = OdometryError(scale_sigma=0.0, yaw_walk_deg=0.0, yaw_rate_deg=0.0, position_walk=0.0)


@pytest.fixture(scope="module")
def usual() -> Drive:
    return drive(0)


def antenna_errors(d: Drive) -> np.ndarray:
    """(m, 3) fixes minus where the antenna was, for fixes that fall on frames."""
    row = {t: k for k, t in enumerate(d.t_ns.tolist())}
    T = d.truth[[row[f.t_ns] for f in d.fixes]]
    z = np.array([d.start.position(f) for f in d.fixes])
    return z - T[:, :3] - so3.rotate(T[:, 3:], d.p_b_gps)


def test_the_same_seed_gives_the_same_drive_and_another_seed_another(usual):
    again, other = drive(0), drive(1)
    np.testing.assert_array_equal(usual.T_o_b, again.T_o_b)
    assert [f.latitude_deg for f in usual.fixes] == [f.latitude_deg for f in again.fixes]
    assert not np.allclose(usual.truth, other.truth)


def test_a_kilometre_at_ten_metres_a_second_with_turns(usual):
    path = np.linalg.norm(np.diff(usual.truth[:, :3], axis=0), axis=1).sum()
    assert path == pytest.approx(1000.0, rel=0.02)
    assert (usual.t_ns[-1] - usual.t_ns[0]) * 1e-9 == pytest.approx(100.0)
    velocity = np.gradient(usual.truth[:, :2], 0.1, axis=0)
    forward = so3.rotate(usual.truth[:, 3:], np.array([1.0, 0, 0]))[:, :2]
    aligned = np.sum(velocity * forward, 1) / np.linalg.norm(velocity, axis=1) / np.linalg.norm(forward, axis=1)
    assert aligned[1:-1].min() > 0.999
    assert np.ptp(np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))) > np.deg2rad(45)


def test_odometry_without_errors_is_the_truth_seen_from_its_start():
    d = drive(2, odometry=PERFECT)
    np.testing.assert_allclose(
        poses.between(d.T_o_b[:-1], d.T_o_b[1:]), poses.between(d.truth[:-1], d.truth[1:]), atol=1e-9
    )
    np.testing.assert_allclose(d.T_o_b[0, :3], 0)


def test_odometry_drifts_by_about_a_hundredth():
    assert np.mean([drive(seed).relative_drift for seed in range(10)]) == pytest.approx(0.01, abs=0.002)


def test_fixes_stop_for_the_outage_and_stray_as_told():
    d = drive(3, receiver=Receiver(first_s=0.1))
    stamps = np.array([f.t_ns for f in d.fixes])
    assert not ((stamps >= d.outage_ns[0]) & (stamps <= d.outage_ns[1])).any()
    assert len(stamps) == pytest.approx(5 * 70, abs=2)
    e = antenna_errors(d)
    np.testing.assert_allclose(e[~d.outlier].std(0), 1.0, atol=0.15)
    assert np.linalg.norm(e[d.outlier, :2], axis=1).min() > 10.0 - 4.0
    assert 0.02 < d.outlier.mean() < 0.09


def test_road_and_odometry_do_not_depend_on_the_receiver(usual):
    other = drive(0, receiver=Receiver(rate_hz=1.0, outlier_share=0.0))
    np.testing.assert_array_equal(usual.truth, other.truth)
    np.testing.assert_array_equal(usual.T_o_b, other.T_o_b)
