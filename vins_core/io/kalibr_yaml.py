"""Kalibr's results: a camchain (camchain-imucam-*.yaml) and an imu file (imu.yaml or imu-*.yaml)."""

from __future__ import annotations

from typing import Any

from ..errors import CalibrationError
from ..geometry import se3
from ..geometry.camera import CameraModel, camera_from_dict
from ..sensors import Calibration, CameraCalibration, ImuNoise
from .euroc_yaml import ASSUMED_GRAVITY
from .yaml_file import Keys

MODELS = {
    ("pinhole", "radtan"): ("pinhole-radtan", ("k1", "k2", "p1", "p2")),
    ("pinhole", "equidistant"): ("kannala-brandt", ("k1", "k2", "k3", "k4")),
}
KNOWN = {"pinhole", "omni", "eucm", "ds"}


def recognizes(keys: Keys) -> bool:
    return _is_camchain(keys) or _is_imu(keys)


def _is_camchain(keys: Keys) -> bool:
    first = keys.content.get("cam0")
    return isinstance(first, dict) and "camera_model" in first


def _is_imu(keys: Keys) -> bool:
    nested = keys.content.get("imu0")
    inner = nested if isinstance(nested, dict) else keys.content
    return "accelerometer_noise_density" in inner and "sensor_type" not in inner


def read(files: list[Keys]) -> tuple[Calibration, dict[str, Any], tuple[str, ...]]:
    """cam0 of the camchain and the IMU.

    Kalibr's T_cam_imu maps IMU to camera coordinates, the inverse of T_b_c; its time shift has our sign:
    t_imu = t_cam + timeshift_cam_imu.
    """
    chains, imus = [f for f in files if _is_camchain(f)], [f for f in files if _is_imu(f)]
    if len(chains) != 1 or len(imus) != 1 or len(files) != 2:
        names = ", ".join(str(f.path) for f in files)
        missing = "its camchain file" if not chains else "its imu file" if not imus else "exactly two files"
        raise CalibrationError(f"{names}: a Kalibr calibration needs {missing} as well; give both with --calib")
    chain = chains[0]
    camera = chain.mapping("cam0", "a camera")
    imu = imus[0].mapping("imu0", "an IMU") if "imu0" in imus[0] else imus[0]
    notes = [f"{imu.path} gives no gravity: {ASSUMED_GRAVITY} m/s^2 is assumed"]
    others = sorted(key for key in chain.content if key.startswith("cam") and key != "cam0")
    if others:
        notes.append(f"{', '.join(others)} not used: one camera is supported so far")
    T_c_b = camera.transform("T_cam_imu", "the transform from IMU to camera (run kalibr_calibrate_imu_camera)")
    if "timeshift_cam_imu" in camera:
        td_s = camera.number("timeshift_cam_imu", "t_imu = t_cam + shift in s")
    else:
        td_s = 0.0
        notes.append(f"{chain.path} gives no timeshift_cam_imu: camera and IMU are taken as synchronised")
    calibration = Calibration(
        cameras=(CameraCalibration("cam0", _model(camera), se3.inverse(T_c_b), _topic(camera)),),
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


def _topic(keys: Keys) -> str:
    return keys.text("rostopic", "a topic") if keys.content.get("rostopic") else ""


def _model(keys: Keys) -> CameraModel:
    kind = keys.text("camera_model", "pinhole")
    distortion = keys.text("distortion_model", "radtan or equidistant")
    if (kind, distortion) not in MODELS:
        problem = "is not supported yet" if kind in KNOWN else "is unknown"
        raise CalibrationError(
            f"{keys.path}: key {keys.where}camera_model: {kind} with {distortion} {problem}; "
            f"supported are {', '.join(' with '.join(pair) for pair in MODELS)}"
        )
    name, coefficients = MODELS[kind, distortion]
    width, height = keys.numbers("resolution", 2, "width and height in px")
    values = dict(zip(("fx", "fy", "cx", "cy"), keys.numbers("intrinsics", 4, "fu, fv, pu, pv in px")))
    values |= dict(zip(coefficients, keys.numbers("distortion_coeffs", 4, ", ".join(coefficients))))
    return camera_from_dict(name, width=width, height=height, **values)
