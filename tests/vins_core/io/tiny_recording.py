"""Recordings of a second or two with 64x48 images, and configs to go with them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from vins_core.geometry.camera import camera_from_dict
from vins_core.io.messages import GpsMessage, ImageMessage, ImuMessage, Message, TruthMessage
from vins_core.io.recording import Recording, open_recording
from vins_core.io.write import write_recording
from vins_core.sensors import Calibration, CameraCalibration, ImuNoise

T0 = 1_403_636_580_000_000_000
FORMATS = {"asl": "folder", "ros1": "a.bag", "ros2": "ros2", "mcap": "mcap"}
"""Each format and the name its recording gets."""

WIDTH, HEIGHT = 64, 48
CAMERA = camera_from_dict(
    "pinhole-radtan", width=WIDTH, height=HEIGHT, fx=40.0, fy=41.0, cx=31.5, cy=23.5, k1=-0.2, k2=0.05, p1=1e-4, p2=2e-4
)
T_B_C = np.array([[0.0, 0.0, 1.0, 0.1], [-1.0, 0.0, 0.0, 0.2], [0.0, -1.0, 0.0, 0.3], [0.0, 0.0, 0.0, 1.0]])
CALIBRATION = Calibration(
    (CameraCalibration("cam0", CAMERA, T_B_C, "/cam0/image_raw"),),
    ImuNoise("discrete", 0.08, 0.004, 4e-5, 2e-6),
    gravity_m_s2=9.81,
    imu_topic="/imu0",
    sources=("config.yaml",),
)


def picture(seed: int, shape: tuple[int, ...] = (HEIGHT, WIDTH), dtype: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


def encoded(seed: int, suffix: str = ".jpg") -> bytes:
    return cv2.imencode(suffix, picture(seed))[1].tobytes()


def imu(t_ns: int, topic: str = "/imu0") -> ImuMessage:
    """Values that depend on the time alone, with all bits in use."""
    s = (t_ns - T0) * 1e-9
    return ImuMessage(
        t_ns, topic, np.sin([s + 0.1, 2 * s, 3 * s]) / 3, np.array([0.1, 0.2, 9.7]) + np.cos([s, 2 * s, 3 * s]) / 7
    )


def imus(first_s: float = 0.0, last_s: float = 2.0, rate_hz: float = 200.0) -> list[ImuMessage]:
    return [imu(T0 + round(k * 1e9 / rate_hz)) for k in range(round(first_s * rate_hz), round(last_s * rate_hz) + 1)]


def images(
    first_s: float = 0.0, last_s: float = 2.0, rate_hz: float = 20.0, topic: str = "/cam0/image_raw"
) -> list[ImageMessage]:
    steps = range(round(first_s * rate_hz), round(last_s * rate_hz) + 1)
    return [ImageMessage(T0 + round(k * 1e9 / rate_hz), topic, "jpeg", encoded(k)) for k in steps]


def truth(t_ns: int, topic: str = "/state_groundtruth_estimate0") -> TruthMessage:
    v = np.random.default_rng(t_ns % 10**12).normal(size=16)
    return TruthMessage(t_ns, topic, v[:3], v[3:7] / np.linalg.norm(v[3:7]), v[7:10], v[10:13], v[13:16])


def gps(t_ns: int, topic: str = "/gps0") -> GpsMessage:
    v = np.random.default_rng(t_ns % 10**12).normal(size=12)
    return GpsMessage(t_ns, topic, 22.0 + v[0], 114.0 + v[1], 50.0 + v[2], v[3:].reshape(3, 3), int(t_ns % 3))


def in_time_order(messages: Iterable[Message]) -> list[Message]:
    rank = {ImuMessage: 0, GpsMessage: 1, TruthMessage: 2, ImageMessage: 3}
    return sorted(messages, key=lambda m: (m.t_ns, rank[type(m)]))


def write(folder: Path, messages: Iterable[Message], format: str = "asl") -> Path:
    return write_recording(messages, folder / FORMATS[format], format)  # type: ignore[arg-type]


def recorded(folder: Path, messages: Iterable[Message], format: str = "asl") -> Recording:
    return open_recording(write(folder, messages, format))


VINS_MONO = """%YAML:1.0
imu_topic: "/imu0"
image_topic: "/cam0/image_raw"
output_path: "results/"
model_type: PINHOLE
camera_name: camera
image_width: 64
image_height: 48
distortion_parameters:
   k1: -0.2
   k2: 0.05
   p1: 1e-4
   p2: 2e-4
projection_parameters:
   fx: 40
   fy: 41.0
   cx: 31.5
   cy: 23.5
estimate_extrinsic: 0
extrinsicRotation: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [0, 0, 1, -1, 0, 0,
          0, -1, 0]
extrinsicTranslation: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [0.1, 0.2, 0.3]
max_cnt: 140
min_dist: 25
freq: 0
F_threshold: 1.5
equalize: 0
max_solver_time: 0.04
max_num_iterations: 6
keyframe_parallax: 12.0
acc_n: 0.08
gyr_n: 0.004
acc_w: 0.00004
gyr_w: 2e-6
g_norm: 9.81
loop_closure: 1
estimate_td: 0
td: 0.0
"""


def without(text: str, key: str) -> str:
    """The config without one top-level `key: value` line."""
    return "\n".join(line for line in text.splitlines() if not line.startswith(f"{key}:")) + "\n"
