"""What a camera sees at the time of its frame's pose, though it saw it a little earlier or later (REFERENCE O7, S6).

The pose of a frame belongs to the end of its IMU samples, which were cut at t_image + td + readout / 2 by the td known
then.  What row v of an image of h rows shows was seen on the IMU's clock at

    t_image + td + readout v / (h - 1),

so that with the td believed now it came late by (td - td_cut) + readout (v / (h - 1) - 1/2).  What is at x = ray.xy /
ray.z and moves with the velocity dx/dt that the tracker has measured was at x - late dx/dt at the time of the pose: of
first order in time, on the plane, for rays with z of either sign.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.inverse_depth import MIN_RAY_Z
from ..sensors import Calibration, ImuSamples
from .state import Observations, WindowFrame


def moved_back(
    observations: Observations, late_s: float | np.ndarray, velocity: np.ndarray | None = None
) -> Observations:
    """The rays as they were `late_s` earlier, one for all or (n,); those of the second camera stay.

    `velocity` (n, 2): by default that of the observations.
    """
    velocity = observations.velocity if velocity is None else velocity
    rays = observations.rays
    moved = rays.copy()
    moved[:, :2] -= (rays[:, 2] * late_s)[:, None] * velocity
    return replace(observations, rays=moved / np.linalg.norm(moved, axis=1, keepdims=True))


def seen_at(frame: WindowFrame, td_s: float) -> Observations:
    """What `frame` sees at the time of its pose if the time offset is `td_s`."""
    late_s, seen = td_s - frame.td_s, frame.observations
    if late_s == 0.0:
        return seen
    right = None if seen.right is None else moved_back(seen.right, late_s, right_velocity(seen, seen.right))
    return replace(moved_back(seen, late_s), right=right)


def referred_to(frame: WindowFrame, td_s: float) -> WindowFrame:
    """`frame` with the rays of `seen_at`, which are those at `td_s` from now on."""
    return frame if frame.td_s == td_s else replace(frame, observations=seen_at(frame, td_s), td_s=td_s)


def with_velocity_now(
    observations: Observations, imu: ImuSamples, last_image_ns: int, T_b_c: np.ndarray
) -> Observations:
    """Velocities at the end of `imu` instead of the mean since the image before, as far as rotation changes them.

    The tracker divides a step by its duration, which lags by half an interval: 50 ms at 10 Hz, in which a hand-held
    camera changes its turn by more than td can bear.  By how much faster it turns at the end than on average, the
    gyroscope knows, whatever its bias:  d(df/dt) = -(R_b_c' (w_end - w_mean)) x f.

    `last_image_ns`: when the image before was taken, on the IMU's clock; the second camera's steps are those since the
    frame before, with which `imu` begins.  T_b_c: (cameras, 4, 4).
    """
    if len(imu) < 2:
        return observations
    left = _hastened(observations, _turn_change(imu[imu.t_ns >= last_image_ns]) @ T_b_c[0, :3, :3])
    if observations.right is None:
        return left
    return replace(left, right=_hastened(observations.right, _turn_change(imu) @ T_b_c[1, :3, :3]))


def _turn_change(imu: ImuSamples) -> np.ndarray:
    """w_end - w_mean (3,) rad/s."""
    if len(imu) < 2:
        return np.zeros(3)
    dt = np.diff(imu.t_ns).astype(float)[:, None]
    mean = np.sum(0.5 * (imu.gyro_rad_s[:-1] + imu.gyro_rad_s[1:]) * dt, 0) / dt.sum()
    return imu.gyro_rad_s[-1] - mean


def _hastened(observations: Observations, change_rad_s: np.ndarray) -> Observations:
    """`observations` of a camera that turns by so much faster, in its own axes; what has not been measured stays 0."""
    rays, velocity = observations.rays, observations.velocity
    moves = -np.cross(change_rad_s, rays)
    known = velocity.any(1) & (np.abs(rays[:, 2]) > MIN_RAY_Z)
    z = np.where(known, rays[:, 2], 1.0)[:, None]
    on_plane = moves[:, :2] / z - rays[:, :2] * moves[:, 2:] / z**2
    return replace(observations, velocity=np.where(known[:, None], velocity + on_plane, velocity).astype(np.float32))


def at_middle_row(calibration: Calibration, observations: Observations) -> Observations:
    """Rays of a rolling shutter as at the time of the middle row (O8); as they are for a global one."""
    left, right = observations, observations.right
    readout_s = [camera.readout_s for camera in calibration.cameras]
    if right is not None and readout_s[1]:
        late_s = _after_middle_s(right, readout_s[1], calibration, 1)
        right = moved_back(right, late_s, right_velocity(left, right))
    if readout_s[0]:
        left = moved_back(left, _after_middle_s(left, readout_s[0], calibration, 0))
    return observations if left is observations and right is observations.right else replace(left, right=right)


def right_velocity(left: Observations, right: Observations) -> np.ndarray:
    """(n, 2) in the second camera; what has no velocity of its own there yet moves as in the first one."""
    unknown = ~right.velocity.any(1, keepdims=True)
    return np.where(unknown, left.velocity[np.searchsorted(left.ids, right.ids)], right.velocity)


def _after_middle_s(observations: Observations, readout_s: float, calibration: Calibration, camera: int) -> np.ndarray:
    """(n,) how much later than the middle row each point was read."""
    rows = calibration.cameras[camera].model.height
    return readout_s * (observations.uv_px[:, 1].astype(float) / (rows - 1) - 0.5)
