"""Kalibr's results: a camchain (camchain-imucam-*.yaml) and an imu file (imu.yaml or imu-*.yaml).

OpenVINS' kalibr_imucam_chain.yaml and kalibr_imu_chain.yaml are the same but for the direction of one transform.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import CalibrationError
from ..geometry import se3
from ..sensors import Calibration, CameraCalibration, ImuNoise
from .euroc_yaml import ASSUMED_GRAVITY
from .intrinsics import read_camera
from .yaml_file import Keys

MAX_CAMERAS = 2
IMU_MATRICES = ("Tw", "Ta", "R_IMUtoGYRO", "R_IMUtoACC")
"""OpenVINS' intrinsics of the IMU; identities unless it was calibrated that far."""


def recognizes(keys: Keys) -> bool:
    return _is_camchain(keys) or _is_imu(keys)


def _is_camchain(keys: Keys) -> bool:
    first = keys.content.get("cam0")
    return isinstance(first, dict) and "camera_model" in first


def _is_imu(keys: Keys) -> bool:
    nested = keys.content.get("imu0")
    inner = nested if isinstance(nested, dict) else keys.content
    return "accelerometer_noise_density" in inner and "sensor_type" not in inner


def read(files: list[Keys], max_cameras: int = MAX_CAMERAS) -> tuple[Calibration, dict[str, Any], tuple[str, ...]]:
    """One or two cameras of the camchain and the IMU.

    Kalibr's time shift has our sign: t_imu = t_cam + timeshift_cam_imu.
    """
    chains, imus = [f for f in files if _is_camchain(f)], [f for f in files if _is_imu(f)]
    if len(chains) != 1 or len(imus) != 1 or len(files) != 2:
        names = ", ".join(str(f.path) for f in files)
        missing = "its camchain file" if not chains else "its imu file" if not imus else "exactly two files"
        raise CalibrationError(f"{names}: a Kalibr calibration needs {missing} as well; give both with --calib")
    chain = chains[0]
    imu = imus[0].mapping("imu0", "an IMU") if "imu0" in imus[0] else imus[0]
    notes = [f"{imu.path} gives no gravity: {ASSUMED_GRAVITY} m/s^2 is assumed"]
    all_cameras = sorted(key for key in chain.content if key.startswith("cam"))
    used, left_out = all_cameras[:max_cameras], all_cameras[max_cameras:]
    if left_out:
        notes.append(f"{', '.join(left_out)} not used: at most {max_cameras} are")
    cameras = _cameras(chain, used)
    if not any("timeshift_cam_imu" in chain.content[name] for name in used):
        notes.append(f"{chain.path} gives no timeshift_cam_imu: camera and IMU are taken as synchronised")
    skewed = [m for m in IMU_MATRICES if m in imu and not np.array_equal(imu.matrix(m, 3, 3, "a matrix"), np.eye(3))]
    if skewed:
        notes.append(f"{imu.path}: {', '.join(skewed)} not applied: the IMU is taken as free of skew and scale errors")
    td_s = cameras[0].td_s or 0.0
    calibration = Calibration(
        cameras=tuple(replace(c, td_s=None) if c.td_s == td_s else c for c in cameras),
        noise=ImuNoise(
            "continuous",
            acc_n=imu.number("accelerometer_noise_density", "m/s^2/sqrt(Hz)", positive=True),
            gyr_n=imu.number("gyroscope_noise_density", "rad/s/sqrt(Hz)", positive=True),
            acc_w=imu.number("accelerometer_random_walk", "m/s^3/sqrt(Hz)", positive=True),
            gyr_w=imu.number("gyroscope_random_walk", "rad/s^2/sqrt(Hz)", positive=True),
        ),
        gravity_m_s2=ASSUMED_GRAVITY,
        td_s=td_s,
        imu_topic=_topic(imu),
        sources=tuple(str(f.path) for f in files),
    )
    return calibration, {}, tuple(notes)


def _cameras(chain: Keys, names: list[str]) -> tuple[CameraCalibration, ...]:
    """Cameras with their own time shift each."""
    cameras: list[CameraCalibration] = []
    for name in names:
        keys = chain.mapping(name, "a camera")
        T_b_c = _extrinsics(keys, cameras[-1].T_b_c if cameras else None)
        shift = keys.number("timeshift_cam_imu", "t_imu = t_cam + shift in s") if "timeshift_cam_imu" in keys else 0.0
        cameras.append(CameraCalibration(name, read_camera(keys, "distortion_coeffs"), T_b_c, _topic(keys), td_s=shift))
    return tuple(cameras)


def _extrinsics(keys: Keys, T_b_previous: np.ndarray | None) -> np.ndarray:
    """T_b_c from Kalibr's T_cam_imu (IMU to camera coordinates), OpenVINS' T_imu_cam, or the camera before."""
    if "T_imu_cam" in keys:
        return keys.transform("T_imu_cam", "the transform from camera to IMU")
    if "T_cam_imu" not in keys and T_b_previous is not None and "T_cn_cnm1" in keys:
        return T_b_previous @ se3.inverse(keys.transform("T_cn_cnm1", "the transform from the camera before this one"))
    T_c_b = keys.transform("T_cam_imu", "the transform from IMU to camera (run kalibr_calibrate_imu_camera)")
    return se3.inverse(T_c_b)


def _topic(keys: Keys) -> str:
    return keys.text("rostopic", "a topic") if keys.content.get("rostopic") else ""
