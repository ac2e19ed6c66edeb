"""EuRoC `sensor.yaml` files: one per sensor, in its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ..errors import CalibrationError
from ..geometry import se3
from ..sensors import Calibration, CameraCalibration, ImuNoise
from .intrinsics import read_camera, write_camera
from .own_yaml import read_depth, read_extrinsics, read_flag
from .yaml_file import Keys

ASSUMED_GRAVITY = 9.81
COEFFICIENTS = "distortion_coefficients"


def recognizes(keys: Keys) -> bool:
    return "sensor_type" in keys


def describes_camera(content: Mapping[str, Any]) -> bool:
    """Whether a folder's sensor.yaml holds a calibrated camera: converted recordings may have the topic alone."""
    return all(key in content for key in ("T_BS", "camera_model", "intrinsics", "resolution"))


def describes_antenna(content: Mapping[str, Any]) -> bool:
    """Whether a GPS receiver's sensor.yaml says where its antenna is."""
    return content.get("sensor_type") == "gps" and "T_BS" in content


def read(files: list[Keys]) -> tuple[Calibration, dict[str, Any], tuple[str, ...]]:
    """Calibration from the files of the IMU and of one or two cameras, in their order, and perhaps of a GPS receiver.

    T_b_c = inverse(T_BS of the IMU) @ T_BS of the camera, and alike for the antenna.
    """
    imu = _only(files, "imu")
    cameras, receivers = ([f for f in files if f.content.get("sensor_type") == kind] for kind in ("camera", "gps"))
    if not 1 <= len(cameras) <= 2 or len(receivers) > 1 or len(cameras) + len(receivers) + 1 != len(files):
        names = ", ".join(str(f.path) for f in files)
        raise CalibrationError(
            f"{names}: expected one or two sensor.yaml with sensor_type camera, found {len(cameras)}"
        )
    T_body_imu = imu.transform("T_BS", "the transform from the IMU to the body")
    notes = []
    if "gravity_m_s2" in imu:  # written by vinspect
        gravity = imu.number("gravity_m_s2", "the norm of gravity", positive=True)
    else:
        gravity = ASSUMED_GRAVITY
        notes.append(f"{imu.path} gives no gravity: {ASSUMED_GRAVITY} m/s^2 is assumed")
    td_s = [c.number("td_s", "t_imu = t_image + td in s") if "td_s" in c else 0.0 for c in cameras]
    calibration = Calibration(
        cameras=tuple(
            replace(_camera(keys, f"cam{i}", T_body_imu), td_s=None if td_s[i] == td_s[0] else td_s[i])
            for i, keys in enumerate(cameras)
        ),
        noise=_noise(imu),
        gravity_m_s2=gravity,
        td_s=td_s[0],
        imu_topic=imu.text("topic", "the IMU's topic") if "topic" in imu else "",
        sources=tuple(str(f.path) for f in (*cameras, imu)),
        estimate_td=read_flag(imu, "estimate_td"),
        extrinsics=read_extrinsics(imu),
    )
    for receiver in receivers:
        calibration = _with_antenna(receiver, T_body_imu, calibration)
    return calibration, {}, tuple(notes)


def _with_antenna(keys: Keys, T_body_imu: np.ndarray, calibration: Calibration) -> Calibration:
    T_b_g = _in_imu(keys.transform("T_BS", "the transform from the antenna to the body"), T_body_imu)
    topic = keys.text("topic", "the receiver's topic") if "topic" in keys else ""
    x, y, z = T_b_g[:3, 3].tolist()
    return replace(calibration, gps_topic=topic, p_b_gps=(x, y, z))


def _in_imu(T_body_sensor: np.ndarray, T_body_imu: np.ndarray) -> np.ndarray:
    same = np.array_equal(T_body_imu, np.eye(4))
    return T_body_sensor if same else se3.inverse(T_body_imu) @ T_body_sensor


def _camera(keys: Keys, name: str, T_body_imu: np.ndarray) -> CameraCalibration:
    T_b_c = _in_imu(keys.transform("T_BS", "the transform from the camera to the body"), T_body_imu)
    topic = keys.text("topic", "the camera's topic") if "topic" in keys else ""
    readout_s = keys.number("readout_s", "the readout time of an image in s") if "readout_s" in keys else 0.0
    depth = read_depth(keys.mapping("depth", "a depth camera")) if "depth" in keys else None
    return CameraCalibration(name, read_camera(keys, COEFFICIENTS), T_b_c, topic, readout_s=readout_s, depth=depth)


def imu_to_dict(calibration: Calibration) -> dict[str, Any]:
    """What `read` expects of an IMU's file, and what EuRoC's format has no key for.

    That is gravity, the kind of noise, and what of the calibration a run shall estimate.
    """
    noise = calibration.noise
    estimated: dict[str, Any] = {"estimate_td": True} if calibration.estimate_td else {}
    estimated |= {"extrinsics": calibration.extrinsics} if calibration.extrinsics != "fixed" else {}
    return {
        "T_BS": _matrix(np.eye(4)),
        "gyroscope_noise_density": noise.gyr_n,
        "gyroscope_random_walk": noise.gyr_w,
        "accelerometer_noise_density": noise.acc_n,
        "accelerometer_random_walk": noise.acc_w,
        "noise_kind": noise.kind,
        "gravity_m_s2": calibration.gravity_m_s2,
        **estimated,
    }


def camera_to_dict(camera: CameraCalibration, td_s: float) -> dict[str, Any]:
    """What `read` expects of a camera's file."""
    content = {
        "T_BS": _matrix(camera.T_b_c),
        **write_camera(camera.model, COEFFICIENTS, radtan="radial-tangential"),
        "td_s": td_s if camera.td_s is None else camera.td_s,
    }
    content |= {"readout_s": camera.readout_s} if camera.readout_s else {}
    return content | ({"depth": asdict(camera.depth)} if camera.depth else {})


def antenna_to_dict(p_b_gps: tuple[float, float, float]) -> dict[str, Any]:
    """What `read` expects of a GPS receiver's file."""
    return {"T_BS": _matrix(se3.from_rotation_translation(np.eye(3), np.array(p_b_gps)))}


def _matrix(T: np.ndarray) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": T.ravel().tolist()}


def _only(files: list[Keys], kind: str) -> Keys:
    found = [f for f in files if f.content.get("sensor_type") == kind]
    if len(found) != 1:
        names = ", ".join(str(f.path) for f in files)
        raise CalibrationError(f"{names}: expected one sensor.yaml with sensor_type {kind}, found {len(found)}")
    return found[0]


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
