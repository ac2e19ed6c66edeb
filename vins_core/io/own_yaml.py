"""Our own calibration format: everything in one file, nothing implied.

vinspect_calibration: 1
gravity_m_s2: 9.81
td_s: 0.0                      # t_imu = t_image + td
imu:
  topic: /imu0                 # may be empty when the recording has one IMU
  noise: continuous            # densities per sqrt(Hz), or discrete: VINS' per-sample sigmas
  acc_n: 0.002                 # m/s^2
  gyr_n: 0.00017               # rad/s
  acc_w: 0.003                 # bias random walk
  gyr_w: 1.9e-05
cameras:
- name: cam0
  topic: /cam0/image_raw
  model: pinhole-radtan        # width, height and the model's own numbers follow
  width: 752
  height: 480
  fx: 458.654
  ...
  T_b_c: [[...], [...], [...], [0.0, 0.0, 0.0, 1.0]]   # camera to IMU coordinates
  mask: mask.png               # optional, beside this file: white pixels are used
parameters:                    # optional, as with --set
  window.max_iterations: 8
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from .. import params
from ..errors import CalibrationError, OutputError, ParameterError
from ..geometry.camera import camera_from_dict, camera_to_dict
from ..sensors import Calibration, CameraCalibration, ImuNoise
from .yaml_file import Keys

VERSION = 1


def recognizes(keys: Keys) -> bool:
    return "vinspect_calibration" in keys


def read(keys: Keys) -> tuple[Calibration, dict[str, Any], tuple[str, ...]]:
    version = keys.integer("vinspect_calibration", f"{VERSION}")
    if version != VERSION:
        raise keys.wrong("vinspect_calibration", version, f"{VERSION}: this file is from another version of vinspect")
    imu = keys.mapping("imu", "topic, noise, acc_n, gyr_n, acc_w and gyr_w")
    kind = imu.text("noise", "continuous or discrete")
    if kind not in ("continuous", "discrete"):
        raise imu.wrong("noise", kind, "continuous or discrete")
    cameras = keys.raw("cameras", "a list of cameras")
    if not isinstance(cameras, list) or not cameras or not all(isinstance(c, dict) for c in cameras):
        raise keys.wrong("cameras", cameras, "a list of cameras")
    calibration = Calibration(
        cameras=tuple(_camera(Keys(keys.path, c, f"cameras[{i}].")) for i, c in enumerate(cameras)),
        noise=ImuNoise(
            kind,
            acc_n=imu.number("acc_n", "accelerometer noise", positive=True),
            gyr_n=imu.number("gyr_n", "gyroscope noise", positive=True),
            acc_w=imu.number("acc_w", "accelerometer bias random walk", positive=True),
            gyr_w=imu.number("gyr_w", "gyroscope bias random walk", positive=True),
        ),
        gravity_m_s2=keys.number("gravity_m_s2", "the norm of gravity in m/s^2", positive=True),
        td_s=keys.number("td_s", "the time offset in s with t_imu = t_image + td"),
        imu_topic=_topic(imu),
        sources=(str(keys.path),),
    )
    overrides = dict(keys.mapping("parameters", "section.name: value").content) if "parameters" in keys else {}
    try:
        params.replace(params.Params(), overrides)
    except ParameterError as error:
        raise CalibrationError(f"{keys.path}: {error}") from error
    return calibration, overrides, tuple(f"{key} is not known and was not used" for key in keys.unused())


def _camera(keys: Keys) -> CameraCalibration:
    T_b_c = keys.transform("T_b_c", "four rows, camera to IMU coordinates")
    name, model = keys.text("name", "a name"), keys.text("model", "a camera model")
    mask = str(keys.path.parent / keys.text("mask", "a file")) if keys.content.get("mask") else ""
    values = {k: v for k, v in keys.content.items() if k not in ("name", "topic", "model", "T_b_c", "mask")}
    try:
        return CameraCalibration(name, camera_from_dict(model, **values), T_b_c, _topic(keys), mask)
    except CalibrationError as error:
        raise CalibrationError(f"{keys.path}: {keys.where[:-1]}: {error}") from error


def _topic(keys: Keys) -> str:
    keys.used.add("topic")
    return str(keys.content.get("topic") or "")


def write(
    path: Path | str, calibration: Calibration, overrides: Mapping[str, Any] | None = None, notes: Sequence[str] = ()
) -> None:
    """Write a file that `read` gives back equal, to the last bit; refuses an existing one.  Notes become comments."""
    path = Path(path)
    content: dict[str, Any] = {
        "vinspect_calibration": VERSION,
        "gravity_m_s2": calibration.gravity_m_s2,
        "td_s": calibration.td_s,
        "imu": {"topic": calibration.imu_topic, **_noise(calibration.noise)},
        "cameras": [
            {"name": c.name, "topic": c.topic, **camera_to_dict(c.model), "T_b_c": c.T_b_c.tolist()}
            | ({"mask": c.mask} if c.mask else {})
            for c in calibration.cameras
        ],
    }
    if overrides:
        content["parameters"] = dict(overrides)
    dump(path, content, notes)


def dump(path: Path, content: Mapping[str, Any], notes: Sequence[str] = ()) -> None:
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    try:
        with path.open("x", encoding="utf-8") as file:
            file.writelines(f"# {' '.join(note.split())}\n" for note in notes)
            yaml.dump(dict(content), file)
    except FileExistsError as error:
        raise OutputError(f"{path}: exists already and is not overwritten; choose another name") from error
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error


def _noise(noise: ImuNoise) -> dict[str, Any]:
    return {"noise": noise.kind} | {
        f.name: getattr(noise, f.name) for f in dataclasses.fields(noise) if f.name != "kind"
    }
