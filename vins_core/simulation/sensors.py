"""What the sensors make of a motion: IMU samples with noise and walking biases, exposed and encoded images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..geometry import se3
from ..geometry.camera import CameraModel
from ..sensors import ImuNoise, ImuSamples
from .render import Renderer
from .trajectory import Motion


@dataclass(frozen=True)
class Rig:
    """How the sensors are mounted.  `f` is the vehicle's forward-left-up frame, `b` the IMU."""

    camera: CameraModel
    T_b_c: np.ndarray  # (4, 4)
    q_f_b: np.ndarray  # (4,)
    T_c0_c1: np.ndarray | None = None  # (4, 4) of a second camera of the same model

    @property
    def Ts_b_c(self) -> tuple[np.ndarray, ...]:
        """(4, 4) of every camera."""
        return (self.T_b_c,) if self.T_c0_c1 is None else (self.T_b_c, self.T_b_c @ self.T_c0_c1)


EUROC_NOISE = ImuNoise("continuous", acc_n=2.0e-3, gyr_n=1.6968e-4, acc_w=3.0e-3, gyr_w=1.9393e-5)  # ADIS16448


@dataclass(frozen=True)
class Imu:
    rate_hz: float = 200.0
    noise: ImuNoise = EUROC_NOISE
    b_g_rad_s: tuple[float, float, float] = (0.012, -0.018, 0.025)  # at the start
    b_a_m_s2: tuple[float, float, float] = (0.05, -0.08, 0.06)


@dataclass(frozen=True)
class Exposure:
    rate_hz: float = 10.0
    noise_grey: float = 1.2  # standard deviation
    flicker: float = 0.03  # amplitude of the brightness, as a share
    exposure_s: float = 0.0  # motion blur over this time, centred on the stamp
    readout_s: float = 0.0  # rolling shutter: first to last row
    stamped_row: float = 0.5  # the row that is exposed at the stamp, as a share: 0 first, 1 last
    jpeg_quality: int = 75


@dataclass(frozen=True)
class Biases:
    b_g_rad_s: np.ndarray  # (n, 3)
    b_a_m_s2: np.ndarray  # (n, 3)


def sample_imu(
    motion: Motion, t_ns: np.ndarray, imu: Imu, gravity_m_s2: float, rng: np.random.Generator
) -> tuple[ImuSamples, Biases]:
    """Instantaneous values at relative times `t_ns` (n,), one sample period apart:

        gyro = omega_b + b_g + n_g,  accel = R_b_w (a_w - g_w) + b_a + n_a,
        n ~ N(0, density^2 rate),  b_k+1 - b_k ~ N(0, walk^2 / rate)

    Source: Kalibr's IMU noise model.
    """
    exact = motion.at(t_ns * 1e-9)
    noise, count = imu.noise, len(t_ns)
    draw = rng.standard_normal((count, 12))  # one row a sample: a longer recording starts like a shorter one
    density = np.repeat([noise.gyr_n, noise.acc_n], 3) * np.sqrt(imu.rate_hz)
    walk = np.repeat([noise.gyr_w, noise.acc_w], 3) / np.sqrt(imu.rate_hz)
    start = np.concatenate([imu.b_g_rad_s, imu.b_a_m_s2])
    bias = start + np.cumsum(draw[:, 6:] * walk, 0) - draw[0, 6:] * walk
    measured = np.hstack([exact.omega_b_rad_s, exact.specific_force_m_s2(gravity_m_s2)]) + bias + draw[:, :6] * density
    return ImuSamples(t_ns, measured[:, :3], measured[:, 3:]), Biases(bias[:, :3], bias[:, 3:])


def expose(
    renderer: Renderer, motion: Motion, T_b_c: np.ndarray, t_s: float, exposure: Exposure, rng: np.random.Generator
) -> np.ndarray:
    """The image (rows, columns) uint8 that a camera at `T_b_c` takes at `t_s`."""
    moments = np.array([0.0])
    if exposure.exposure_s > 0:
        moments = exposure.exposure_s * (np.arange(5) - 2.0) / 5
    light = np.mean(
        [renderer.render(_camera_poses(motion, T_b_c, t_s + m, exposure, renderer.shape[0])) for m in moments], 0
    )
    gain = 1.0 + exposure.flicker * (0.6 * np.sin(2 * np.pi * 0.23 * t_s) + 0.4 * np.sin(2 * np.pi * 3.1 * t_s + 1.0))
    noise = rng.standard_normal(light.shape, np.float32) * np.float32(exposure.noise_grey)
    return np.clip(light * gain + noise + 0.5, 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class DepthSensor:
    """A depth camera registered to the camera: depth along the optical axis, as 16-bit integers."""

    noise: float = 0.02  # standard deviation, as a share of the depth
    min_m: float = 0.3  # nearer and
    max_m: float = 8.0  # farther it sees nothing
    missing: float = 0.02  # share of the pixels without depth
    scale_m: float = 1e-3  # metres a unit


def measure_depth(depth_m: np.ndarray, sensor: DepthSensor, rng: np.random.Generator) -> np.ndarray:
    """(rows, columns) uint16 of what a depth camera makes of exact depths; 0 where it sees nothing."""
    noisy = depth_m * (1.0 + sensor.noise * rng.standard_normal(depth_m.shape, np.float32))
    seen = (depth_m > sensor.min_m) & (depth_m < sensor.max_m) & (rng.random(depth_m.shape) >= sensor.missing)
    return np.where(seen, np.clip(np.nan_to_num(noisy) / sensor.scale_m + 0.5, 1, 65535), 0).astype(np.uint16)


def encode_jpeg(image: np.ndarray, quality: int) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def _camera_poses(motion: Motion, T_b_c: np.ndarray, t_s: float, exposure: Exposure, rows: int) -> np.ndarray:
    """T_w_c (4, 4), or one a row (rows, 4, 4) under a rolling shutter."""
    times = np.array([t_s])
    if exposure.readout_s > 0:
        times = t_s + exposure.readout_s * (np.arange(rows) / (rows - 1) - exposure.stamped_row)
    body = motion.at(times)
    T_w_c = se3.from_quaternion_translation(body.q_w_b, body.p_w_b) @ T_b_c
    return T_w_c if exposure.readout_s > 0 else T_w_c[0]
