"""EuRoC `sensor.yaml` files: one per sensor, in its folder."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import CalibrationError
from ..geometry import camera as geometry_camera
from ..geometry import se3
from ..geometry.camera import CameraModel, camera_from_dict
from ..sensors import Calibration, CameraCalibration, ImuNoise
from .yaml_file import Keys

ASSUMED_GRAVITY = 9.81

MODELS = {
    ("pinhole", "radial-tangential"): ("pinhole-radtan", ("k1", "k2", "p1", "p2")),
    ("pinhole", "radtan"): ("pinhole-radtan", ("k1", "k2", "p1", "p2")),
    ("pinhole", "equidistant"): ("kannala-brandt", ("k1", "k2", "k3", "k4")),
}


def recognizes(keys: Keys) -> bool:
    return "sensor_type" in keys


def read(files: list[Keys]) -> tuple[Calibration, dict[str, Any], tuple[str, ...]]:
    """Calibration from one camera's and the IMU's file: T_b_c = inverse(T_BS of the IMU) @ T_BS of the camera."""
    camera, imu = _one(files, "camera"), _one(files, "imu")
    T_body_imu = imu.transform("T_BS", "the transform from the IMU to the body")
    T_body_camera = camera.transform("T_BS", "the transform from the camera to the body")
    same = np.array_equal(T_body_imu, np.eye(4))
    T_b_c = T_body_camera if same else se3.inverse(T_body_imu) @ T_body_camera
    notes = []
    if "gravity_m_s2" in imu:  # written by vinspect
        gravity = imu.number("gravity_m_s2", "the norm of gravity", positive=True)
    else:
        gravity = ASSUMED_GRAVITY
        notes.append(f"{imu.path} gives no gravity: {ASSUMED_GRAVITY} m/s^2 is assumed")
    td_s = camera.number("td_s", "t_imu = t_image + td in s") if "td_s" in camera else 0.0
    topic = camera.text("topic", "the camera's topic") if "topic" in camera else ""
    calibration = Calibration(
        cameras=(CameraCalibration("cam0", _model(camera), T_b_c, topic),),
        noise=_noise(imu),
        gravity_m_s2=gravity,
        td_s=td_s,
        imu_topic=imu.text("topic", "the IMU's topic") if "topic" in imu else "",
        sources=(str(camera.path), str(imu.path)),
    )
    return calibration, {}, tuple(notes)


def imu_to_dict(calibration: Calibration) -> dict[str, Any]:
    """What `read` expects of an IMU's file, and what EuRoC's format has no key for: gravity and the kind of noise."""
    noise = calibration.noise
    return {
        "T_BS": _matrix(np.eye(4)),
        "gyroscope_noise_density": noise.gyr_n,
        "gyroscope_random_walk": noise.gyr_w,
        "accelerometer_noise_density": noise.acc_n,
        "accelerometer_random_walk": noise.acc_w,
        "noise_kind": noise.kind,
        "gravity_m_s2": calibration.gravity_m_s2,
    }


def camera_to_dict(camera: CameraCalibration, td_s: float) -> dict[str, Any]:
    """What `read` expects of a camera's file."""
    values = geometry_camera.camera_to_dict(camera.model)
    words, coefficients = next((words, names) for words, (model, names) in MODELS.items() if model == values["model"])
    return {
        "T_BS": _matrix(camera.T_b_c),
        "resolution": [values["width"], values["height"]],
        "camera_model": words[0],
        "intrinsics": [values[k] for k in ("fx", "fy", "cx", "cy")],
        "distortion_model": words[1],
        "distortion_coefficients": [values[k] for k in coefficients],
        "td_s": td_s,
    }


def _matrix(T: np.ndarray) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": T.ravel().tolist()}


def _one(files: list[Keys], kind: str) -> Keys:
    found = [f for f in files if f.content.get("sensor_type") == kind]
    if len(found) != 1:
        names = ", ".join(str(f.path) for f in files)
        raise CalibrationError(f"{names}: expected one sensor.yaml with sensor_type {kind}, found {len(found)}")
    return found[0]


def _model(keys: Keys) -> CameraModel:
    camera = keys.text("camera_model", "pinhole")
    distortion = keys.text("distortion_model", "radial-tangential or equidistant")
    if (camera, distortion) not in MODELS:
        known = ", ".join(" ".join(pair) for pair in MODELS)
        raise CalibrationError(f"{keys.path}: unknown camera model {camera} {distortion}; known are {known}")
    name, coefficients = MODELS[camera, distortion]
    width, height = keys.numbers("resolution", 2, "width and height in px")
    intrinsics = keys.numbers("intrinsics", 4, "fu, fv, cu, cv in px")
    values = dict(zip(("fx", "fy", "cx", "cy"), intrinsics))
    values |= dict(zip(coefficients, keys.numbers("distortion_coefficients", 4, ", ".join(coefficients))))
    return camera_from_dict(name, width=width, height=height, **values)


def _noise(keys: Keys) -> ImuNoise:
    if "noise_kind" in keys:  # written by vinspect for sigmas that came from a VINS config
        kind = keys.text("noise_kind", "continuous or discrete")
        if kind not in ("continuous", "discrete"):
            raise keys.wrong("noise_kind", kind, "continuous or discrete")
    else:
        kind = "continuous"
    return ImuNoise(
        kind,
        acc_n=keys.number("accelerometer_noise_density", "m/s^2/sqrt(Hz)", positive=True),
        gyr_n=keys.number("gyroscope_noise_density", "rad/s/sqrt(Hz)", positive=True),
        acc_w=keys.number("accelerometer_random_walk", "m/s^3/sqrt(Hz)", positive=True),
        gyr_w=keys.number("gyroscope_random_walk", "rad/s^2/sqrt(Hz)", positive=True),
    )
