"""Which sensors a run uses, which modes a recording and its calibration allow, and what is missing for the others."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ..errors import CalibrationError, RecordingError
from ..sensors import NO_IMU, Calibration
from .recording import Recording, Stream

Mode = Literal["mono_imu", "stereo_imu", "stereo", "rgbd_imu"]
MODES: tuple[Mode, ...] = get_args(Mode)
SUPPORTED: tuple[Mode, ...] = ("mono_imu", "stereo_imu", "stereo", "rgbd_imu")
"""Those that the estimator can run."""
PREFERRED: tuple[Mode, ...] = ("stereo_imu", "rgbd_imu", "mono_imu", "stereo")
"""What a run is in when nobody says: the first that is possible."""

MIN_IMU_HZ = 50.0
"""An IMU that comes more rarely says too little about the motion between its samples."""


@dataclass(frozen=True)
class ModeInfo:
    mode: Mode
    missing: tuple[str, ...]  # what stands in the way, a phrase each; empty: the mode is possible
    gps: bool  # whether fixes can be fused on top


def inspect_modes(recording: Recording, calibration: Calibration | None) -> tuple[ModeInfo, ...]:
    """Every mode; without a calibration by the topics alone."""
    gps = any(s.count for s in recording.of_role("gps"))
    return tuple(ModeInfo(mode, _missing(recording, calibration, mode), gps) for mode in MODES)


def restrict(calibration: Calibration, mode: Mode) -> Calibration:
    """What a mode uses of a calibration."""
    cameras = calibration.cameras[: 2 if mode.startswith("stereo") else 1]
    if mode != "rgbd_imu":
        cameras = tuple(dataclasses.replace(camera, depth=None) for camera in cameras)
    if mode == "stereo" and calibration.has_imu:
        calibration = dataclasses.replace(calibration, has_imu=False, noise=NO_IMU, imu_topic="", estimate_td=False)
    return dataclasses.replace(calibration, cameras=cameras)


def choose(recording: Recording, calibration: Calibration, wish: Mode | None = None) -> Mode:
    """The mode of a run: the one wished for, or else the one that uses most of what is there.

    Where nothing can run, the one that comes nearest: what it lacks is told when it starts.
    Raises CalibrationError when what was wished for cannot be had.
    """
    possible = {info.mode: info.missing for info in inspect_modes(recording, calibration)}
    if wish is None:
        nearest: Mode = "mono_imu" if calibration.has_imu else "stereo"
        return next((mode for mode in PREFERRED if not possible[mode]), nearest)
    if wish not in SUPPORTED:
        raise CalibrationError(f"mode {wish} is not supported yet; expected one of {', '.join(SUPPORTED)}")
    if possible[wish]:
        others = ", ".join(mode for mode in PREFERRED if not possible[mode])
        raise CalibrationError(
            f"{recording.path}: mode {wish} needs {' and '.join(possible[wish])}; "
            + (f"possible is {others}" if others else "no other mode is possible either")
        )
    return wish


def prepare(calibration: Calibration, mode: Mode = "mono_imu") -> tuple[Calibration, tuple[str, ...]]:
    """A calibration for a run in `mode`, and a note for each thing in it that the run does not use.

    Raises CalibrationError when the estimator cannot do without what is missing.
    """
    where = ", ".join(calibration.sources) or "the calibration"
    if mode not in SUPPORTED:
        raise CalibrationError(f"mode {mode} is not supported yet; expected one of {', '.join(SUPPORTED)}")
    if mode != "stereo" and not calibration.has_imu:
        raise CalibrationError(f"{where}: has no IMU, which mode {mode} needs; expected imu: 1 and its noise")
    if mode.startswith("stereo") and len(calibration.cameras) < 2:
        raise CalibrationError(
            f"{where}: has one camera, and mode {mode} needs two"
            + ("" if calibration.has_imu else "; one camera without an IMU cannot tell how large the world is")
        )
    if mode == "rgbd_imu" and calibration.cameras[0].depth is None:
        raise CalibrationError(
            f"{where}: has no depth camera, which mode {mode} needs; expected depth_topic in a VINS config, or "
            "depth of the camera in vinspect's own"
        )
    if calibration.extrinsics == "unknown" and mode != "mono_imu":
        _check_unknown(where, calibration, mode)
    notes = []
    used = restrict(calibration, mode)
    if len(calibration.cameras) > len(used.cameras):
        names = ", ".join(camera.name for camera in calibration.cameras[len(used.cameras) :])
        left = " and ".join(camera.name for camera in used.cameras)
        notes.append(f"{names}: not used, mode {mode} sees by {left} alone")
    if calibration.has_imu and not used.has_imu:
        notes.append(f"imu: not used, mode {mode} goes by the cameras alone")
    if mode == "stereo":
        notes.append("loops: not closed, since without an IMU nothing shows where down is")
    if calibration.cameras[0].depth and not used.cameras[0].depth:
        notes.append(f"depth of {calibration.cameras[0].name}: not used, mode {mode} goes without")
    if calibration.extrinsics == "refine" and not used.has_imu:
        notes.append(
            "estimate_extrinsic: without an IMU nothing tells where the cameras are; the given values are used"
        )
    if calibration.extrinsics == "unknown" and mode != "stereo":
        p = used.cameras[0].T_b_c[:3, 3]
        position = "zero" if not p.any() else f"{np.array2string(p, precision=3)} m, as given"
        notes.append(
            f"estimate_extrinsic: the rotation of {used.cameras[0].name} is found before initialising, by turning; "
            f"its position in the IMU starts at {position}"
        )
    return used, tuple(notes)


def _check_unknown(where: str, calibration: Calibration, mode: Mode) -> None:
    """What is found is how camera and IMU are turned to each other, not how two cameras are mounted."""
    if mode == "rgbd_imu":
        return
    first, second = (camera.T_b_c for camera in calibration.cameras[:2])
    if not np.allclose(first[:3, 3], second[:3, 3]):
        return
    raise CalibrationError(
        f"{where}: estimate_extrinsic is 2 and both cameras are at the same place; mode {mode} needs to know how they "
        "are mounted to each other: give body_T_cam0 and body_T_cam1, of which only that is used"
    )


def _missing(recording: Recording, calibration: Calibration | None, mode: Mode) -> tuple[str, ...]:
    missing = []
    if calibration is None:
        missing.append("a calibration (--calib)")
    if mode != "stereo":
        missing += _missing_imu(recording.of_role("imu"), calibration)
    needed = 2 if mode.startswith("stereo") else 1
    images = len(recording.of_role("image"))
    if images < needed:
        missing.append("images" if images == 0 else "images of a second camera")
    elif calibration and len(calibration.cameras) < needed:
        missing.append("a second camera in the calibration")
    if mode == "rgbd_imu":
        if not recording.of_role("depth"):
            missing.append("depth images")
        elif calibration and calibration.cameras[0].depth is None:
            missing.append("depth in the calibration")
    missing += _missing_topics(recording, calibration, mode) if calibration and not missing else []
    return tuple(missing)


def _missing_imu(streams: tuple[Stream, ...], calibration: Calibration | None) -> list[str]:
    if not streams:
        return ["an IMU"]
    rate_hz = max((s.rate_hz or 0.0 for s in streams), default=0.0)
    if rate_hz < MIN_IMU_HZ:
        return [f"an IMU of {MIN_IMU_HZ:g} Hz or more (it comes at {rate_hz:.3g} Hz)"]
    if calibration and not calibration.has_imu:
        return ["an IMU in the calibration"]
    return []


def _missing_topics(recording: Recording, calibration: Calibration, mode: Mode) -> list[str]:
    """The first topic that the calibration names and the recording has not."""
    before = recording.choice
    recording.use(restrict(calibration, mode))
    try:
        _ = recording.image_topics
        _ = recording.imu_topic if mode != "stereo" else None
        _ = recording.depth_topic if mode == "rgbd_imu" else None
    except RecordingError as error:
        return [str(error).removeprefix(f"{recording.path}: ")]
    finally:
        recording.use(before)
    return []
