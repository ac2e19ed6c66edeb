"""VINS-Mono and VINS-Fusion configs (OpenCV YAML; REFERENCE 22)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import CalibrationError
from ..geometry.camera import CameraModel, camera_from_dict
from ..sensors import Calibration, CameraCalibration, ImuNoise
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
}
EXPECTED_TUNING = ("max_cnt", "min_dist", "F_threshold", "keyframe_parallax", "max_num_iterations")

ALWAYS_IGNORED = {
    "max_solver_time": "a run never depends on the clock; max_num_iterations limits the solver",
    "output_path": "`--out` says where a run is written",
}
IGNORED_WHEN_ON = {
    "loop_closure": "loop closure is not supported yet",
    "fast_relocalization": "relocalisation is not supported yet",
    "load_previous_pose_graph": "pose graphs are not supported yet",
    "rolling_shutter": "rolling shutter is not supported yet, the image is taken as exposed at once",
    "estimate_td": "estimating td is not supported yet, the given value is used",
    "estimate_extrinsic": "estimating the extrinsics is not supported yet, the given values are used",
    "multiple_thread": "every image is used (VINS-Fusion would skip every second one)",
}
SILENT = {  # switches of the ROS nodes that say nothing about sensors or estimation
    "show_track",
    "save_image",
    "visualize_imu_forward",
    "visualize_camera_size",
    "pose_graph_save_path",
    "rolling_shutter_tr",
    "camera_name",
    "model_type",
}
UNSUPPORTED = {
    "MEI": "the unified (MEI) camera model is not supported yet",
    "SCARAMUZZA": "the Scaramuzza camera model is not supported yet",
    "PINHOLE_FULL": "the rational (PINHOLE_FULL) camera model is not supported yet",
}


def recognizes(keys: Keys) -> bool:
    """By any key that only such a config has, so that a config with a key missing is still told which."""
    return any(key in keys for key in ("cam0_calib", "imu_topic", "image_topic", "extrinsicRotation", "body_T_cam0"))


def read(keys: Keys) -> tuple[Calibration, dict[str, Any], tuple[str, ...]]:
    """Calibration, overrides and notes of a config; the camera named beside it for VINS-Fusion."""
    notes: list[str] = []
    camera = _fusion_camera(keys, notes) if "cam0_calib" in keys else _mono_camera(keys, notes)
    noise = ImuNoise(
        "discrete",
        acc_n=keys.number("acc_n", "accelerometer noise in m/s^2", positive=True),
        gyr_n=keys.number("gyr_n", "gyroscope noise in rad/s", positive=True),
        acc_w=keys.number("acc_w", "accelerometer bias random walk", positive=True),
        gyr_w=keys.number("gyr_w", "gyroscope bias random walk", positive=True),
    )
    calibration = Calibration(
        cameras=(camera,),
        noise=noise,
        gravity_m_s2=keys.number("g_norm", "the norm of gravity in m/s^2, e.g. 9.81", positive=True),
        td_s=keys.number("td", "the time offset in s with t_imu = t_image + td, 0.0 for synchronised sensors"),
        imu_topic=keys.text("imu_topic", "the IMU's topic"),
        sources=(str(keys.path),),
    )
    overrides = _tuning(keys, notes)
    _note_ignored(keys, notes)
    return calibration, overrides, tuple(notes)


def _mono_camera(keys: Keys, notes: list[str]) -> CameraCalibration:
    R = keys.matrix("extrinsicRotation", 3, 3, "the rotation from camera to IMU")
    t = keys.matrix("extrinsicTranslation", 3, 1, "the camera's position in the IMU frame in m")
    T_b_c = rigid(R, t[:, 0], keys, "extrinsicRotation")
    return CameraCalibration(
        "cam0", camera_model(keys), T_b_c, keys.text("image_topic", "the camera's topic"), _mask(keys, notes)
    )


def _fusion_camera(keys: Keys, notes: list[str]) -> CameraCalibration:
    if "imu" in keys and keys.integer("imu", "1, with an IMU") == 0:
        raise CalibrationError(f"{keys.path}: key imu is 0; cameras without an IMU are not supported yet, expected 1")
    beside = keys.path.parent / keys.text("cam0_calib", "the camera's file beside this one")
    camera = Keys(beside, read_yaml(beside))
    T_b_c = keys.transform("body_T_cam0", "the transform from camera to IMU")
    if "num_of_cam" in keys and keys.integer("num_of_cam", "1 or 2") > 1:
        notes.append("num_of_cam: stereo is not supported yet, cam0 alone is used")
    keys.used |= {"image1_topic", "cam1_calib", "body_T_cam1", "image_width", "image_height"}
    topic = keys.text("image0_topic", "the camera's topic")
    return CameraCalibration("cam0", camera_model(camera), T_b_c, topic, _mask(keys, notes))


def camera_model(keys: Keys) -> CameraModel:
    """A camodocal camera block (REFERENCE C1, C3)."""
    kind = keys.text("model_type", "PINHOLE or KANNALA_BRANDT")
    size = {
        "width": keys.integer("image_width", "the image width in px"),
        "height": keys.integer("image_height", "the image height in px"),
    }
    if kind == "PINHOLE":
        distortion = keys.mapping("distortion_parameters", "k1, k2, p1 and p2")
        projection = keys.mapping("projection_parameters", "fx, fy, cx and cy")
        return camera_from_dict(
            "pinhole-radtan",
            **size,
            **{k: projection.number(k, "a number in px") for k in ("fx", "fy", "cx", "cy")},
            **{k: distortion.number(k, "a distortion coefficient") for k in ("k1", "k2", "p1", "p2")},
        )
    if kind == "KANNALA_BRANDT":
        projection = keys.mapping("projection_parameters", "k2 to k5, mu, mv, u0 and v0")
        names = {"mu": "fx", "mv": "fy", "u0": "cx", "v0": "cy", "k2": "k1", "k3": "k2", "k4": "k3", "k5": "k4"}
        values = {ours: projection.number(theirs, "a number") for theirs, ours in names.items()}
        return camera_from_dict("kannala-brandt", **size, **values)
    if kind in UNSUPPORTED:
        raise CalibrationError(f"{keys.path}: key model_type: {UNSUPPORTED[kind]}; use PINHOLE or KANNALA_BRANDT")
    known = ", ".join(["PINHOLE", "KANNALA_BRANDT", *UNSUPPORTED])
    raise CalibrationError(f"{keys.path}: key model_type: unknown camera model {kind!r}; known are {known}")


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


def _tuning(keys: Keys, notes: list[str]) -> dict[str, Any]:
    overrides = {}
    for key, (parameter, convert) in TUNING.items():
        if key in keys:
            overrides[parameter] = convert(keys.number(key, f"a number for {parameter}"))
        elif key in EXPECTED_TUNING:
            notes.append(f"{key} is not in the file, {parameter} keeps its default")
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
