"""Calibration and settings files of any known format, read into one `Settings`.

Nothing is guessed in silence: a missing number is an error that names file and key, a number that a format cannot
hold is assumed with a note, and a setting that was not used is noted with the reason.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import CalibrationError
from ..geometry.field_of_view import widest_angle_rad
from ..sensors import Calibration
from . import euroc_yaml, kalibr_yaml, openvins_yaml, own_yaml, vins_yaml
from .asl import AslRecording
from .kitti import KittiRecording
from .recording import Recording
from .yaml_file import Keys, read_yaml

FORMATS = (
    "a VINS-Mono or VINS-Fusion config, OpenVINS' estimator_config.yaml, Kalibr's camchain and imu files, "
    "EuRoC sensor.yaml files or vinspect's own"
)


RESIDUAL = "projection.residual"
WIDE_RAD = np.radians(65.0)
"""From here on pixels at the border weigh less than a fifth of those in the middle on the plane."""


@dataclass(frozen=True)
class Settings:
    """What a run needs to know before it starts."""

    calibration: Calibration
    overrides: Mapping[str, Any] = field(default_factory=dict)
    """`section.name -> value` from the file's tuning keys; `--set` wins over them."""
    notes: tuple[str, ...] = ()
    """One sentence for each key that was ignored and each number that was assumed."""


def read_calibration(paths: Sequence[Path | str], recording: Recording | None = None) -> Settings:
    """Settings from one file (two for Kalibr); none for EuRoC folders, which hold their own.

    With a recording, names the topics it uses where the files do not.  Raises CalibrationError.
    """
    files = [Keys(Path(p), read_yaml(Path(p))) for p in paths]
    if not files:
        settings = _from_recording(recording)
    elif len(files) == 1 and own_yaml.recognizes(files[0]):
        settings = Settings(*own_yaml.read(files[0]))
    elif len(files) == 1 and vins_yaml.recognizes(files[0]):
        settings = Settings(*vins_yaml.read(files[0]))
    elif len(files) == 1 and openvins_yaml.recognizes(files[0]):
        settings = Settings(*openvins_yaml.read(files[0]))
    elif any(kalibr_yaml.recognizes(f) for f in files):
        settings = Settings(*kalibr_yaml.read(files))
    elif all(euroc_yaml.recognizes(f) for f in files):
        settings = Settings(*euroc_yaml.read(files))
    elif len(files) == 1 and "model_type" in files[0]:
        raise CalibrationError(
            f"{files[0].path}: describes a camera only; give the VINS config that names it (with imu_topic, acc_n, ...)"
        )
    else:
        names = ", ".join(str(f.path) for f in files)
        raise CalibrationError(f"{names}: unknown calibration format; expected {FORMATS}")
    settings = _with_residual(settings)
    return settings if recording is None else _with_topics(settings, recording)


def _with_residual(settings: Settings) -> Settings:
    """On the normalised plane noise grows with 1 / cos^2 of the angle to the axis: a wide lens needs the sphere."""
    angle = max(widest_angle_rad(camera.model) for camera in settings.calibration.cameras)
    if angle < WIDE_RAD or RESIDUAL in settings.overrides:
        return settings
    note = f"the lens looks {np.degrees(angle):.0f} degrees off its axis: {RESIDUAL} is sphere unless you set it"
    return dataclasses.replace(
        settings, overrides={**settings.overrides, RESIDUAL: "sphere"}, notes=(*settings.notes, note)
    )


def _from_recording(recording: Recording | None) -> Settings:
    if isinstance(recording, KittiRecording):
        return Settings(recording.calibration())
    if not isinstance(recording, AslRecording):
        where = f"{recording.path}: " if recording else ""
        raise CalibrationError(f"{where}a calibration is needed for this recording; give {FORMATS} with --calib")
    cameras, imu = recording.of_role("image"), recording.imu_topic
    folders = [recording.folder(topic) for topic in (recording.image_topics[0], imu)]
    missing = [str(folder / "sensor.yaml") for folder in folders if not (folder / "sensor.yaml").exists()]
    if missing:
        raise CalibrationError(f"{' and '.join(missing)}: missing, so this folder has no calibration; give --calib")
    others = [recording.folder(s.topic) / "sensor.yaml" for s in cameras[1:]]
    second = [path for path in others[:1] if path.exists() and euroc_yaml.describes_camera(read_yaml(path))]
    receivers = [recording.folder(s.topic) / "sensor.yaml" for s in recording.of_role("gps")]
    placed = [path for path in receivers if path.exists() and euroc_yaml.describes_antenna(read_yaml(path))]
    paths = [folders[0] / "sensor.yaml", *second, folders[1] / "sensor.yaml", *(placed if len(placed) == 1 else [])]
    settings = Settings(*euroc_yaml.read([Keys(path, read_yaml(path)) for path in paths]))
    unused = [s.topic for s in cameras[1 + len(second) :]]
    notes = [f"{', '.join(unused)} not used: there is no calibration of it in its folder"] if unused else []
    return dataclasses.replace(settings, notes=(*settings.notes, *notes))


def _with_topics(settings: Settings, recording: Recording) -> Settings:
    """The topics in use, by the files' names or else the recording's only ones.

    What only some modes need is left out with a note when the recording does not have it.
    """
    calibration, absent = _present(settings.calibration, recording)
    recording.use(calibration)
    cameras = tuple(
        dataclasses.replace(camera, topic=topic) for camera, topic in zip(calibration.cameras, recording.image_topics)
    )
    imu_topic = recording.imu_topic if calibration.has_imu else ""
    calibration = dataclasses.replace(calibration, cameras=cameras, imu_topic=imu_topic)
    recording.use(calibration)
    notes = [*settings.notes, *absent]
    if recording.truth_topic is None and len(recording.candidates("truth")) > 1:
        topics = ", ".join(s.topic for s in recording.candidates("truth"))
        notes.append(
            f"several topics could be the ground truth ({topics}), so none is used; `eval --truth` takes a file"
        )
    return dataclasses.replace(settings, calibration=calibration, notes=tuple(notes))


def _present(calibration: Calibration, recording: Recording) -> tuple[Calibration, list[str]]:
    """The calibration without the second camera, depth and GPS that the recording does not have, and why."""
    notes = []
    first, *others = calibration.cameras
    kept = [first]
    images = recording.of_role("image")
    for camera in others:
        if camera.topic and not recording.has("image", camera.topic):
            notes.append(f"{camera.name} not used: the recording has no images of {camera.topic}")
        elif len(images) <= len(kept):
            notes.append(f"{camera.name} not used: the recording has images of {len(images)} camera(s)")
        else:
            kept.append(camera)
    if first.depth and not (
        recording.has("depth", first.depth.topic) if first.depth.topic else recording.of_role("depth")
    ):
        notes.append(f"depth of {first.name} not used: the recording has no depth images {first.depth.topic}".rstrip())
        kept[0] = dataclasses.replace(first, depth=None)
    if calibration.gps_topic and not recording.has("gps", calibration.gps_topic):
        notes.append(f"GPS not used: the recording has no fixes of {calibration.gps_topic}")
        calibration = dataclasses.replace(calibration, gps_topic="")
    return dataclasses.replace(calibration, cameras=tuple(kept)), notes
