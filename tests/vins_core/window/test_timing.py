"""Rays at the time of the pose: rolling shutters, and points that a second camera has only just found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vins_core.geometry import se3, so3
from vins_core.geometry.camera import camera_from_dict
from vins_core.sensors import Calibration, CameraCalibration, ImuNoise, ImuSamples
from vins_core.window.state import Observations
from vins_core.window.timing import at_middle_row, moved_back, right_velocity, with_velocity_now

ROWS, READOUT_S = 481, 0.02
CAMERA = camera_from_dict(
    "pinhole-radtan", width=641, height=ROWS, fx=400.0, fy=400.0, cx=320.0, cy=240.0, k1=0.0, k2=0.0, p1=0.0, p2=0.0
)


def calibration(*readout_s: float) -> Calibration:
    cameras = tuple(CameraCalibration(f"cam{i}", CAMERA, np.eye(4), readout_s=r) for i, r in enumerate(readout_s))
    return Calibration(cameras, ImuNoise("discrete", 0.1, 0.01, 1e-4, 1e-5), 9.81)


def observations(uv_px: list[list[float]], velocity: list[list[float]], first: int = 0) -> Observations:
    pixels = np.array(uv_px, np.float32)
    ids = np.arange(first, first + len(pixels))
    return Observations(ids, CAMERA.lift(pixels), pixels, np.array(velocity, np.float32))


def xy(o: Observations) -> np.ndarray:
    return o.rays[:, :2] / o.rays[:, 2:]


def test_the_first_row_is_seen_half_a_readout_before_the_middle_one_and_the_last_as_much_after() -> None:
    seen = observations([[100.0, 0.0], [300.0, 240.0], [500.0, 480.0]], [[1.0, -2.0]] * 3)
    moved = at_middle_row(calibration(READOUT_S), seen)
    expected = np.array([[0.01, -0.02], [0.0, 0.0], [-0.01, 0.02]])
    np.testing.assert_allclose(xy(moved) - xy(seen), expected, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(moved.rays, axis=1), 1.0)
    assert at_middle_row(calibration(0.0), seen) is seen


def test_each_camera_has_its_own_readout() -> None:
    right = observations([[100.0, 0.0]], [[1.0, 0.0]])
    seen = replace(observations([[100.0, 0.0]], [[1.0, 0.0]]), right=right)
    moved = at_middle_row(calibration(0.0, READOUT_S), seen)
    assert moved.rays is seen.rays and moved.right is not None
    np.testing.assert_allclose(xy(moved.right) - xy(right), [[0.01, 0.0]], atol=1e-6)


@pytest.mark.parametrize("z", [0.5, -0.5])
def test_a_ray_goes_back_the_way_it_came_on_either_side(z: float) -> None:
    ray, velocity, dt_s = np.array([[0.6, 0.2, z]]), np.array([[0.3, -0.4]], np.float32), 0.01
    ray /= np.linalg.norm(ray)
    now = Observations(np.zeros(1, np.int64), ray, np.zeros((1, 2), np.float32), velocity)
    then = moved_back(now, dt_s)
    np.testing.assert_allclose((xy(now) - xy(then)) / dt_s, velocity, rtol=1e-5)
    assert np.sign(then.rays[0, 2]) == np.sign(z)


def test_velocity_is_that_at_the_frame_though_the_tracker_measured_the_mean_before_it() -> None:
    """A camera that turns faster and faster, by a gyroscope with a bias."""
    T_b_c = se3.from_quaternion_translation(so3.exp(np.array([0.4, -0.7, 0.2])), np.array([0.1, 0.0, 0.2]))
    axis, t_s = np.array([0.5, -0.6, 0.4]), np.linspace(0.0, 0.1, 21)

    def rays_at(t: float) -> np.ndarray:
        """Turned by t^2 about the axis: 2 t times as fast."""
        R_w_c = so3.to_matrix(so3.exp(axis * t**2)) @ T_b_c[:3, :3]
        return far @ R_w_c

    far = np.random.default_rng(0).normal(size=(20, 3)) * 0.3 + T_b_c[:3, 2]
    far /= np.linalg.norm(far, axis=1, keepdims=True)
    plane = [rays_at(t)[:, :2] / rays_at(t)[:, 2:] for t in (0.05, 0.1, 0.1 - 1e-5, 0.1 + 1e-5)]
    mean, true = (plane[1] - plane[0]) / 0.05, (plane[3] - plane[2]) / 2e-5
    gyro = 2 * t_s[:, None] * axis + [0.02, 0.05, -0.03]
    imu = ImuSamples(np.round(t_s * 1e9).astype(np.int64), gyro, np.zeros((21, 3)))
    tracked = Observations(np.arange(20), rays_at(0.1), np.zeros((20, 2), np.float32), mean.astype(np.float32))
    now = with_velocity_now(tracked, imu, round(0.05e9), T_b_c[None])
    assert np.abs(now.velocity - true).max() < 0.05 * np.abs(mean - true).max()
    still = replace(tracked, velocity=np.zeros((20, 2), np.float32))  # not measured: it stays unknown
    np.testing.assert_array_equal(with_velocity_now(still, imu, round(0.05e9), T_b_c[None]).velocity, 0)


def test_what_the_second_camera_has_just_found_moves_as_in_the_first() -> None:
    left = observations([[100.0, 0.0], [200.0, 0.0]], [[1.0, 0.0], [2.0, 0.0]], first=7)
    right = observations([[90.0, 0.0], [190.0, 0.0]], [[0.0, 0.0], [3.0, 0.0]], first=7)
    np.testing.assert_array_equal(right_velocity(left, right), [[1.0, 0.0], [3.0, 0.0]])
