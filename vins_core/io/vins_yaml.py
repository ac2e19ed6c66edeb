"""VINS-Mono and VINS-Fusion configs, and those of their depth-camera forks (OpenCV YAML; REFERENCE 22)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..sensors import NO_IMU, Calibration, CameraCalibration, DepthCalibration, ExtrinsicKnowledge, ImuNoise
from .camodocal_yaml import camera_model
from .yaml_file import Keys, read_yaml, rigid

FLAG: Callable[[float], Any] = bool
TUNING: dict[str, tuple[str, Callable[[float], Any]]] = {
    "max_cnt": ("frontend.max_cnt", int),
    "min_dist": ("frontend.min_dist", int),
    "freq": ("frontend.freq", lambda value: float(value) or 100.0),  # T2: 0 means 100
    "F_threshold": ("frontend.F_threshold", float),
    "equalize": ("frontend.equalize", FLAG),
    "flow_back": ("frontend.flow_back", FLAG),
    "keyframe_parallax": ("window.keyframe_parallax", float),
    "max_num_iterations": ("window.max_iterations", int),
    "loop_closure": ("loop.enabled", FLAG),
}
FUSION_FRONT_END: dict[str, tuple[str, Any, str]] = {
    "freq": (
        "frontend.freq",
        100.0,
        "VINS-Fusion uses every image, whatever freq says; --set frontend.freq=10 for less",
    ),
    "equalize": ("frontend.equalize", False, "VINS-Fusion never equalises; --set frontend.equalize=on does"),
}
"""What VINS-Fusion does whether the key is there or not (REFERENCE TF1, P5), and with stereo measured better."""
EXPECTED_TUNING = ("max_cnt", "min_dist", "F_threshold", "keyframe_parallax", "max_num_iterations")

ALWAYS_IGNORED = {
    "max_solver_time": "a run never depends on the clock; max_num_iterations limits the solver",
    "output_path": "`--out` says where a run is written",
    "fast_relocalization": "`loop.relocalize` says how many loops the window refines",
}
IGNORED_WHEN_ON = {
    "load_previous_pose_graph": "a map of vinspect is loaded with `--map`",
    "multiple_thread": "every image is used (VINS-Fusion would skip every second one)",
    "gnss_enable": "raw GNSS measurements are not read; fixes (sensor_msgs/NavSatFix) are",
}
SILENT = {  # switches of the ROS nodes that say nothing about sensors or estimation
    "show_track",
    "save_image",
    "visualize_imu_forward",
    "visualize_camera_size",
    "pose_graph_save_path",
    "camera_name",
    "model_type",
    # the point cloud that VINS-RGBD draws
    "pcl_dist",
    "pcl_min_dist",
    "pcl_max_dist",
    "u_boundary",
    "d_boundary",
    "l_boundary",
    "r_boundary",
    "resolution",
}
EXTRINSICS: dict[int, ExtrinsicKnowledge] = {0: "fixed", 1: "refine", 2: "unknown"}


def recognizes(keys: Keys) -> bool:
    """By any key that only such a config has, so that a config with a key missing is still told which."""
    return any(key in keys for key in ("cam0_calib", "imu_topic", "image_topic", "extrinsicRotation", "body_T_cam0"))


def read(keys: Keys) -> tuple[Calibration, dict[str, Any], tuple[str, ...]]:
    """Calibration, overrides and notes of a config; for VINS-Fusion with the camera files it names."""
    notes: list[str] = []
    extrinsics = _extrinsics(keys)
    has_imu = "imu" not in keys or keys.integer("imu", "1, or 0 for cameras without an IMU") != 0
    if "cam0_calib" in keys:
        cameras = _fusion_cameras(keys, has_imu, extrinsics, notes)
    else:
        cameras = (_mono_camera(keys, extrinsics, notes),)
    calibration = Calibration(
        cameras=cameras,
        noise=_noise(keys) if has_imu else _no_imu(keys),
        gravity_m_s2=_gravity(keys) if has_imu or "g_norm" in keys else 9.81,
        td_s=_td(keys) - 0.5 * cameras[0].readout_s if has_imu or "td" in keys else 0.0,  # theirs is the middle row's
        imu_topic=keys.text("imu_topic", "the IMU's topic") if has_imu else "",
        sources=(str(keys.path),),
        has_imu=has_imu,
        estimate_td=has_imu and _is_on(keys, "estimate_td"),
        extrinsics=extrinsics,
        gps_topic=keys.text("gps_topic", "the GPS receiver's topic") if keys.content.get("gps_topic") else "",
        p_b_gps=_antenna(keys),
    )
    overrides = _tuning(keys, notes)
    _note_ignored(keys, notes)
    return calibration, overrides, tuple(notes)


def _antenna(keys: Keys) -> tuple[float, float, float] | None:
    if "p_b_gps" not in keys:
        return None
    x, y, z = keys.matrix("p_b_gps", 3, 1, "the GPS antenna in body coordinates in m")[:, 0].tolist()
    return x, y, z


# -- cameras -----------------------------------------------------------------------------------------------------------


def _mono_camera(keys: Keys, extrinsics: ExtrinsicKnowledge, notes: list[str]) -> CameraCalibration:
    given = "extrinsicRotation" in keys or "extrinsicTranslation" in keys
    if extrinsics == "unknown" and not given:
        T_b_c = np.eye(4)
    else:
        R = keys.matrix("extrinsicRotation", 3, 3, "the rotation from camera to IMU")
        t = keys.matrix("extrinsicTranslation", 3, 1, "the camera's position in the IMU frame in m")
        T_b_c = rigid(R, t[:, 0], keys, "extrinsicRotation")
    topic = keys.text("image_topic", "the camera's topic")
    model = camera_model(keys)
    return CameraCalibration(
        "cam0", model, T_b_c, topic, _mask(keys, notes), readout_s=_readout(keys), depth=_depth(keys)
    )


def _fusion_cameras(
    keys: Keys, has_imu: bool, extrinsics: ExtrinsicKnowledge, notes: list[str]
) -> tuple[CameraCalibration, ...]:
    count = keys.integer("num_of_cam", "1 or 2") if "num_of_cam" in keys else 1
    if count not in (1, 2):
        raise keys.wrong("num_of_cam", count, "1 or 2")
    keys.used |= {"image1_topic", "cam1_calib", "body_T_cam1", "image_width", "image_height"}
    mask, readout_s, depth = _mask(keys, notes), _readout(keys), _depth(keys)
    given = all(f"body_T_cam{i}" in keys for i in range(count))  # one without the other says nothing
    cameras = []
    for i in range(count):
        beside = keys.path.parent / keys.text(f"cam{i}_calib", "the camera's file beside this one")
        where = f"body_T_cam{i}"
        if extrinsics == "unknown" and not given:
            T_b_c = np.eye(4)
        else:
            T_b_c = keys.transform(where, "the transform from camera to IMU")
        topic = f"image{i}_topic"
        if not has_imu and keys.content.get(topic) == "":  # configs for folders of images name no topics
            named = ""
        else:
            named = keys.text(topic, "the camera's topic")
        model = camera_model(Keys(beside, read_yaml(beside)))
        own_depth = depth if i == 0 else None
        cameras.append(CameraCalibration(f"cam{i}", model, T_b_c, named, mask, readout_s=readout_s, depth=own_depth))
    return tuple(cameras)


def _extrinsics(keys: Keys) -> ExtrinsicKnowledge:
    if "estimate_extrinsic" not in keys:
        return "fixed"
    said = keys.integer("estimate_extrinsic", "0, 1 or 2")
    if said not in EXTRINSICS:
        raise keys.wrong("estimate_extrinsic", said, "0 (as given), 1 (refine) or 2 (unknown)")
    return EXTRINSICS[said]


def _readout(keys: Keys) -> float:
    """VINS' rolling_shutter_tr: the readout time of a whole image."""
    if not _is_on(keys, "rolling_shutter"):
        keys.used.add("rolling_shutter_tr")
        return 0.0
    readout_s = keys.number("rolling_shutter_tr", "the readout time of an image in s")
    if not 0 <= readout_s < 1:
        raise keys.wrong("rolling_shutter_tr", readout_s, "the readout time of an image in s, 0 to 1")
    return readout_s


def _depth(keys: Keys) -> DepthCalibration | None:
    """Depth images of VINS-RGBD and its forks: registered to the camera, 16UC1 in mm or 32FC1 in m."""
    if not keys.content.get("depth_topic"):
        keys.used |= {"depth_topic", "depth_min_dist", "depth_max_dist"}
        return None
    limits = {
        ours: keys.number(theirs, "a distance in m")
        for ours, theirs in (("min_m", "depth_min_dist"), ("max_m", "depth_max_dist"))
        if theirs in keys
    }
    return DepthCalibration(keys.text("depth_topic", "the depth camera's topic"), **limits)


def _mask(keys: Keys, notes: list[str]) -> str:
    """The fisheye mask that the config names, or VINS' config/fisheye_mask.jpg; also looked for beside the config."""
    keys.used |= {"fisheye", "fisheye_mask", "fisheye_mask_path"}
    if not keys.content.get("fisheye"):
        return ""
    said = keys.content.get("fisheye_mask") or keys.content.get("fisheye_mask_path") or "fisheye_mask.jpg"
    folder, named = keys.path.parent, Path(str(said))
    for candidate in (folder / named, folder / named.name, folder.parent / named.name):
        if candidate.is_file():
            return str(candidate)
    notes.append(f"fisheye: no mask {folder / named.name} there, the whole image is used")
    return ""


# -- IMU ---------------------------------------------------------------------------------------------------------------


def _noise(keys: Keys) -> ImuNoise:
    return ImuNoise(
        "discrete",
        acc_n=keys.number("acc_n", "accelerometer noise in m/s^2", positive=True),
        gyr_n=keys.number("gyr_n", "gyroscope noise in rad/s", positive=True),
        acc_w=keys.number("acc_w", "accelerometer bias random walk", positive=True),
        gyr_w=keys.number("gyr_w", "gyroscope bias random walk", positive=True),
    )


def _no_imu(keys: Keys) -> ImuNoise:
    keys.used |= {"acc_n", "gyr_n", "acc_w", "gyr_w", "imu_topic", "estimate_td"}
    return NO_IMU


def _gravity(keys: Keys) -> float:
    return keys.number("g_norm", "the norm of gravity in m/s^2, e.g. 9.81", positive=True)


def _td(keys: Keys) -> float:
    return keys.number("td", "the time offset in s with t_imu = t_image + td, 0.0 for synchronised sensors")


# -- everything else ---------------------------------------------------------------------------------------------------


def _is_on(keys: Keys, key: str) -> bool:
    return key in keys and keys.integer(key, "0 or 1") != 0


def _tuning(keys: Keys, notes: list[str]) -> dict[str, Any]:
    overrides = {}
    for key, (parameter, convert) in TUNING.items():
        if key in keys:
            overrides[parameter] = convert(keys.number(key, f"a number for {parameter}"))
        elif key in EXPECTED_TUNING:
            notes.append(f"{key} is not in the file, {parameter} keeps its default")
    if "cam0_calib" in keys:
        for key, (parameter, value, why) in FUSION_FRONT_END.items():
            if overrides.get(parameter, value) != value:
                notes.append(f"{key} is not used: {why}")
            overrides[parameter] = value
    return overrides


def _note_ignored(keys: Keys, notes: list[str]) -> None:
    for key in keys.unused():
        value = keys.content[key]
        if key in ALWAYS_IGNORED:
            notes.append(f"{key} is not used: {ALWAYS_IGNORED[key]}")
        elif key in IGNORED_WHEN_ON:
            if value:
                notes.append(f"{key}: {IGNORED_WHEN_ON[key]}")
        elif key not in SILENT:
            notes.append(f"{key} is not known and was not used")
