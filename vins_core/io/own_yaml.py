"""Our own calibration format: everything in one file, nothing implied.

vinspect_calibration: 1
gravity_m_s2: 9.81
td_s: 0.0                      # t_imu = t_image + td
imu:                           # `imu: none` for cameras alone; then no gravity_m_s2 and td_s
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
  td_s: 0.001                  # optional, of this camera alone
  readout_s: 0.02              # optional, rolling shutter: from the first to the last row
  depth: {topic: /depth, scale_m: 0.001, min_m: 0.3, max_m: 8.0, tolerance_s: 0.02}   # optional, registered to it
extrinsics: fixed              # optional: fixed, refine or unknown
estimate_td: false             # optional
gps: {topic: /gps, p_b_gps: [0.1, 0.0, 0.2]}   # optional; the antenna in body coordinates, m
parameters:                    # optional, as with --set
  window.max_iterations: 8
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

from ruamel.yaml import YAML

from .. import params
from ..errors import CalibrationError, OutputError, ParameterError
from ..geometry.camera import camera_from_dict, camera_to_dict
from ..sensors import NO_IMU, Calibration, CameraCalibration, DepthCalibration, ExtrinsicKnowledge, ImuNoise
from .yaml_file import Keys

VERSION = 1
NOT_OF_THE_MODEL = ("name", "topic", "model", "T_b_c", "mask", "td_s", "readout_s", "depth")


def recognizes(keys: Keys) -> bool:
    return "vinspect_calibration" in keys


def read(keys: Keys) -> tuple[Calibration, dict[str, Any], tuple[str, ...]]:
    version = keys.integer("vinspect_calibration", f"{VERSION}")
    if version != VERSION:
        raise keys.wrong("vinspect_calibration", version, f"{VERSION}: this file is from another version of vinspect")
    has_imu = keys.content.get("imu") != "none"
    cameras = keys.raw("cameras", "a list of cameras")
    if not isinstance(cameras, list) or not cameras or not all(isinstance(c, dict) for c in cameras):
        raise keys.wrong("cameras", cameras, "a list of cameras")
    calibration = Calibration(
        cameras=tuple(_camera(Keys(keys.path, c, f"cameras[{i}].")) for i, c in enumerate(cameras)),
        noise=NO_IMU,
        gravity_m_s2=9.81,
        sources=(str(keys.path),),
        has_imu=has_imu,
        extrinsics=read_extrinsics(keys),
    )
    if has_imu:
        calibration = _with_imu(keys, calibration)
    else:
        keys.used |= {"imu", "gravity_m_s2", "td_s", "estimate_td"}
    if "gps" in keys:
        calibration = _with_gps(keys.mapping("gps", "topic and p_b_gps"), calibration)
    overrides = dict(keys.mapping("parameters", "section.name: value").content) if "parameters" in keys else {}
    try:
        params.replace(params.Params(), overrides)
    except ParameterError as error:
        raise CalibrationError(f"{keys.path}: {error}") from error
    return calibration, overrides, tuple(f"{key} is not known and was not used" for key in keys.unused())


def _with_imu(keys: Keys, calibration: Calibration) -> Calibration:
    imu = keys.mapping("imu", "topic, noise, acc_n, gyr_n, acc_w and gyr_w, or none")
    kind = imu.text("noise", "continuous or discrete")
    if kind not in ("continuous", "discrete"):
        raise imu.wrong("noise", kind, "continuous or discrete")
    return replace(
        calibration,
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
        estimate_td=read_flag(keys, "estimate_td"),
    )


def _with_gps(gps: Keys, calibration: Calibration) -> Calibration:
    calibration = replace(calibration, gps_topic=_topic(gps))
    if "p_b_gps" not in gps:
        return calibration
    x, y, z = gps.numbers("p_b_gps", 3, "the antenna in body coordinates in m")
    return replace(calibration, p_b_gps=(x, y, z))


def _camera(keys: Keys) -> CameraCalibration:
    T_b_c = keys.transform("T_b_c", "four rows, camera to IMU coordinates")
    name, model = keys.text("name", "a name"), keys.text("model", "a camera model")
    mask = str(keys.path.parent / keys.text("mask", "a file")) if keys.content.get("mask") else ""
    values = {k: v for k, v in keys.content.items() if k not in NOT_OF_THE_MODEL}
    try:
        camera = camera_from_dict(model, **values)
    except CalibrationError as error:
        raise CalibrationError(f"{keys.path}: {keys.where[:-1]}: {error}") from error
    return CameraCalibration(
        name,
        camera,
        T_b_c,
        _topic(keys),
        mask,
        td_s=keys.number("td_s", "the time offset of this camera in s") if "td_s" in keys else None,
        readout_s=keys.number("readout_s", "the readout time of an image in s") if "readout_s" in keys else 0.0,
        depth=read_depth(keys.mapping("depth", "topic and scale_m")) if "depth" in keys else None,
    )


def read_depth(keys: Keys) -> DepthCalibration:
    """The depth camera of a camera: `topic`, `scale_m`, `min_m`, `max_m`, `tolerance_s`."""
    numbers = {
        name: keys.number(name, "a number", positive=name != "min_m")
        for name in ("scale_m", "min_m", "max_m", "tolerance_s")
        if name in keys
    }
    unknown = [key for key in keys.content if key not in (*numbers, "topic")]
    if unknown:
        raise CalibrationError(f"{keys.path}: key {keys.where}{unknown[0]} is not known")
    return DepthCalibration(_topic(keys), **numbers)


def read_extrinsics(keys: Keys) -> ExtrinsicKnowledge:
    if "extrinsics" not in keys:
        return "fixed"
    said = keys.text("extrinsics", "fixed, refine or unknown")
    for choice in get_args(ExtrinsicKnowledge):
        if said == choice:
            return choice
    raise keys.wrong("extrinsics", said, "fixed, refine or unknown")


def read_flag(keys: Keys, key: str) -> bool:
    value = keys.raw(key, "true or false") if key in keys else False
    if not isinstance(value, bool):
        raise keys.wrong(key, value, "true or false")
    return value


def _topic(keys: Keys) -> str:
    keys.used.add("topic")
    return str(keys.content.get("topic") or "")


def write(
    path: Path | str, calibration: Calibration, overrides: Mapping[str, Any] | None = None, notes: Sequence[str] = ()
) -> None:
    """Write a file that `read` gives back equal, to the last bit; refuses an existing one.  Notes become comments."""
    path = Path(path)
    content: dict[str, Any] = {"vinspect_calibration": VERSION}
    if calibration.has_imu:
        content |= {"gravity_m_s2": calibration.gravity_m_s2, "td_s": calibration.td_s}
        content |= {"imu": {"topic": calibration.imu_topic, **_noise(calibration.noise)}}
    else:
        content |= {"imu": "none"}
    content |= {"cameras": [_camera_to_dict(camera) for camera in calibration.cameras]}
    content |= {"extrinsics": calibration.extrinsics} if calibration.extrinsics != "fixed" else {}
    content |= {"estimate_td": True} if calibration.estimate_td else {}
    if calibration.gps_topic or calibration.p_b_gps:
        antenna = {"p_b_gps": list(calibration.p_b_gps)} if calibration.p_b_gps else {}
        content |= {"gps": {"topic": calibration.gps_topic} | antenna}
    if overrides:
        content["parameters"] = dict(overrides)
    dump(path, content, notes)


def _camera_to_dict(camera: CameraCalibration) -> dict[str, Any]:
    content = {"name": camera.name, "topic": camera.topic, **camera_to_dict(camera.model)}
    content |= {"T_b_c": camera.T_b_c.tolist()}
    content |= {"mask": camera.mask} if camera.mask else {}
    content |= {"td_s": camera.td_s} if camera.td_s is not None else {}
    content |= {"readout_s": camera.readout_s} if camera.readout_s else {}
    content |= {"depth": dataclasses.asdict(camera.depth)} if camera.depth else {}
    return content


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
