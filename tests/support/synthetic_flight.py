"""A flight with exact truth: analytic motion, points in a room, IMU samples and rays with optional noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vins_core.factors.preintegration import merge, preintegrate
from vins_core.geometry import so3
from vins_core.geometry.camera import CameraModel
from vins_core.sensors import Calibration, CameraCalibration, ImuNoise, ImuSamples
from vins_core.window.state import Landmarks, Observations, WindowFrame, WindowState

G = 9.81
R_B_C = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # camera looks along body x
T_B_C = np.block([[R_B_C, np.array([[0.05], [-0.03], [0.02]])], [np.zeros((1, 3)), np.ones((1, 1))]])
NOISE = ImuNoise("discrete", acc_n=0.08, gyr_n=0.004, acc_w=4e-5, gyr_w=2e-6)
B_G = np.array([-0.02, 0.03, 0.05])


@dataclass(frozen=True)
class Motion:
    position: Callable[[float], np.ndarray]
    rotation: Callable[[float], np.ndarray]  # rotation vector of the body in the world

    def q(self, t: float) -> np.ndarray:
        return so3.exp(self.rotation(t))

    def velocity(self, t: float, h: float = 1e-5) -> np.ndarray:
        return (self.position(t + h) - self.position(t - h)) / (2 * h)

    def acceleration(self, t: float, h: float = 1e-3) -> np.ndarray:
        p = self.position
        return (-p(t + 2 * h) + 16 * p(t + h) - 30 * p(t) + 16 * p(t - h) - p(t - 2 * h)) / (12 * h * h)

    def rate(self, t: float, h: float = 1e-5) -> np.ndarray:
        return so3.difference(self.q(t + h), self.q(t - h)) / (2 * h)


def lively(seed: int = 0) -> Motion:
    """Hand-held motion: swings of 5-12 cm at around 1 Hz while moving on, 20 degrees of turning."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.5, 1.1, 6), rng.uniform(0, 2 * np.pi, 6)
    amplitude, drift = rng.uniform(0.05, 0.12, 3), rng.uniform(-0.4, 0.4, 3)
    angles = rng.uniform(0.05, 0.2, 3)
    return Motion(
        lambda t: amplitude * np.sin(2 * np.pi * f[:3] * t + phase[:3]) + drift * t,
        lambda t: angles * np.sin(2 * np.pi * f[3:] * t + phase[3:]),
    )


def standstill() -> Motion:
    return Motion(lambda t: np.zeros(3), lambda t: np.zeros(3))


def pure_rotation() -> Motion:
    """The camera (not the IMU) stays where it is while the body swings about all axes."""

    def rotation(t: float) -> np.ndarray:
        return np.array([0.1, 0.3, 0.4]) * np.sin(np.array([2.0, 3.0, 2.5]) * t)

    return Motion(lambda t: -so3.rotate(so3.exp(rotation(t)), T_B_C[:3, 3]), rotation)


def constant_velocity(turning: bool = False) -> Motion:
    swing = np.array([0.1, 0.2, 0.15]) if turning else np.zeros(3)
    return Motion(lambda t: np.array([0.1, 0.8, 0.2]) * t, lambda t: swing * np.sin(np.array([2.0, 3.0, 2.5]) * t))


@dataclass(frozen=True)
class Flight:
    """What `initialize` is given, and the truth."""

    motion: Motion
    times: np.ndarray
    calibration: Calibration
    window: WindowState
    history: tuple[WindowFrame, ...]
    points: np.ndarray  # (n, 3) world points, by track id

    def window_times(self) -> np.ndarray:
        return np.array([f.t_ns * 1e-9 for f in self.window.frames])


class _AnyCamera(CameraModel):
    width, height = 752, 480


def fly(
    motion: Motion,
    seed: int = 0,
    *,
    pixel_sigma: float = 0.0,
    imu_noise: bool = False,
    b_g: np.ndarray = B_G,
    b_a: np.ndarray | None = None,
    n_window: int = 11,
    frame_s: float = 0.1,
    skip: tuple[int, ...] = (),
    n_points: int = 150,
    T_b_c: np.ndarray = T_B_C,
    believed_T_b_c: np.ndarray | None = None,
    world: Callable[[np.ndarray], np.ndarray] = lambda points: points,
    accel_unit: float = 1.0,
    td_s: float = 0.0,
) -> Flight:
    """`skip`: images (counted from 0) that the window did not keep; they are in the history all the same.
    `td_s`: how much later than the IMU's clock says the images were taken, unknown to the estimator.  `accel_unit`:
    what the accelerometer's numbers must be multiplied by."""
    rng = np.random.default_rng(seed + 1000)
    b_a = np.zeros(3) if b_a is None else b_a
    n_frames = n_window + len(skip)
    times = frame_s * np.arange(n_frames)
    points = world(rng.uniform([2.0, -3.0, -2.0], [6.0, 3.0, 2.0], (n_points, 3)))
    believed = T_b_c if believed_T_b_c is None else believed_T_b_c

    frames = []
    for k, t in enumerate(times):
        R, p = so3.to_matrix(motion.q(t)), motion.position(t)
        local = ((points - p) @ R - T_b_c[:3, 3]) @ T_b_c[:3, :3]
        uv = local[:, :2] / local[:, 2:] + rng.normal(0, 1, (n_points, 2)) * pixel_sigma / 460
        visible = (local[:, 2] > 0.2) & (np.abs(uv[:, 0]) < 0.8) & (np.abs(uv[:, 1]) < 0.55)
        rays = np.column_stack([uv, np.ones(n_points)])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        ids = np.flatnonzero(visible).astype(np.int64)
        observations = Observations(
            ids, rays[ids], (460 * uv[ids]).astype(np.float32), np.zeros((len(ids), 2), np.float32)
        )
        imu = None
        if k:
            samples = _imu(motion, times[k - 1] - td_s, t - td_s, b_g, b_a, rng if imu_noise else None)
            samples = replace(samples, accel_m_s2=samples.accel_m_s2 / accel_unit)
            imu = preintegrate(samples, np.zeros(3), np.zeros(3), NOISE)
        zero = np.zeros(3)
        frames.append(
            WindowFrame(k, round(t * 1e9), True, observations, imu, zero, np.array([1.0, 0, 0, 0]), zero, zero, zero)
        )

    kept: list[WindowFrame] = []
    pending = None
    for frame in frames:
        pending = frame.imu if pending is None else merge(pending, frame.imu, NOISE)
        if frame.frame not in skip:
            kept.append(replace(frame, imu=pending if kept else None))
            pending = None
    window = WindowState(tuple(kept), Landmarks.empty(), None, believed[None])
    calibration = Calibration((CameraCalibration("cam0", _AnyCamera(), believed),), NOISE, G)
    return Flight(motion, times, calibration, window, tuple(frames), points)


def _imu(
    motion: Motion, t_0: float, t_1: float, b_g: np.ndarray, b_a: np.ndarray, rng: np.random.Generator | None
) -> ImuSamples:
    t = np.linspace(t_0, t_1, round((t_1 - t_0) * 200) + 1)
    gyro = np.array([motion.rate(s) + b_g for s in t])
    up = np.array([0.0, 0.0, G])
    accel = np.array([so3.rotate(so3.inverse(motion.q(s)), motion.acceleration(s) + up) + b_a for s in t])
    if rng is not None:
        gyro = gyro + rng.normal(0, 0.0024, gyro.shape)  # EuRoC's densities at 200 Hz
        accel = accel + rng.normal(0, 0.028, accel.shape)
    return ImuSamples((t * 1e9).round().astype(np.int64), gyro, accel)
