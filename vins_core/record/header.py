"""What is known about a run before its first frame: `header.json`, readable by people."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from .. import params as parameters
from ..errors import ParameterError, RunError, VinspectError
from ..geometry.camera import camera_from_dict, camera_to_dict
from ..params import Params
from ..sensors import Calibration, CameraCalibration, ImuNoise

FORMAT = "vinspect run"
SCHEMA = 1
"""Raised when an older reader would misread a record; fields that are only added do not raise it."""
MAX_HEADER_BYTES = 16 * 1024 * 1024
_PACKAGES = ("vinspect", "numpy", "scipy", "opencv-python-headless", "casadi", "rosbags", "msgspec")


@dataclass(frozen=True)
class RunHeader:
    """How a run came about: enough to repeat it, and to say why a repetition may differ (SPEC 9.2)."""

    params: Params
    calibration: Calibration
    origins: Mapping[str, str] = field(default_factory=dict)  # section.name -> "default" | "config" | "set"
    recording: str = ""  # path it was read from
    recording_kind: str = ""  # "asl", "ros1", "ros2", "mcap"
    topics: Mapping[str, str] = field(default_factory=dict)  # e.g. cam0 -> /cam0/image_raw, imu -> /imu0
    start_s: float = 0.0  # seconds from the recording's first image
    duration_s: float | None = None  # None: to the end
    expected_frames: int | None = None  # estimate made when the run started, for progress and time axes
    backend: str = ""  # what evaluates the factors
    embedded_images: bool = False
    created_utc: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    versions: Mapping[str, str] = field(default_factory=lambda: package_versions())
    cpu: str = field(default_factory=lambda: cpu_model())


def package_versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def cpu_model() -> str:
    """Name of the processor as the system gives it."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def to_json(header: RunHeader) -> bytes:
    plain = {k: v for k, v in vars(header).items() if k not in ("params", "calibration")}
    plain["params"] = {key: parameters.get(header.params, key) for key in parameters.DECLARATIONS}
    plain["calibration"] = _calibration_to_dict(header.calibration)
    document = {"format": FORMAT, "schema": SCHEMA, **plain}
    return msgspec.json.format(msgspec.json.encode(document, order="deterministic"), indent=1)


def from_json(data: bytes, where: str) -> RunHeader:
    """Raises RunError, naming the file, when the header is not one of ours or from a later format."""
    try:
        document = msgspec.json.decode(data, type=dict[str, Any])
    except (msgspec.MsgspecError, RecursionError, ValueError) as problem:
        raise RunError(f"{where} is not the header of a run: {problem}") from None
    if document.get("format") != FORMAT:
        raise RunError(f"{where} is not the header of a run: expected format {FORMAT!r}")
    if document.get("schema") != SCHEMA:
        raise RunError(
            f"{where} has record schema {document.get('schema')!r} but this version reads {SCHEMA}; "
            "open it with the version of vinspect that wrote it, or run the recording again"
        )
    try:
        document["params"] = parameters.replace(Params(), document["params"])
        document["calibration"] = _calibration_from_dict(document["calibration"])
        known = {name: document[name] for name in RunHeader.__dataclass_fields__ if name in document}
        checked = {k: v for k, v in known.items() if k not in ("params", "calibration")}
        msgspec.convert(checked, _Plain)
        return RunHeader(**known)
    except ParameterError as problem:
        raise RunError(f"{where} was written by another version: {problem}") from None
    except (msgspec.MsgspecError, VinspectError, KeyError, TypeError, ValueError, AttributeError) as problem:
        raise RunError(f"{where} is damaged: {problem or type(problem).__name__}") from None


class _Plain(msgspec.Struct):
    """The fields of RunHeader that JSON can say by itself, checked on reading."""

    origins: dict[str, str]
    recording: str
    recording_kind: str
    topics: dict[str, str]
    start_s: float
    duration_s: float | None
    expected_frames: int | None
    backend: str
    embedded_images: bool
    created_utc: str
    versions: dict[str, str]
    cpu: str


def _calibration_to_dict(calibration: Calibration) -> dict[str, Any]:
    plain = dict(vars(calibration))
    plain["noise"] = dict(vars(calibration.noise))
    plain["cameras"] = [
        {**vars(camera), "model": camera_to_dict(camera.model), "T_b_c": camera.T_b_c.tolist()}
        for camera in calibration.cameras
    ]
    return plain


def _calibration_from_dict(plain: dict[str, Any]) -> Calibration:
    cameras = tuple(
        CameraCalibration(**{**c, "model": camera_from_dict(**c["model"]), "T_b_c": _transform(c["T_b_c"])})
        for c in plain["cameras"]
    )
    noise = msgspec.convert(plain["noise"], ImuNoise)
    return Calibration(**{**plain, "cameras": cameras, "noise": noise, "sources": tuple(plain["sources"])})


def _transform(rows: Any) -> np.ndarray:
    T = np.array(rows, float)
    if T.shape != (4, 4):
        raise ValueError(f"a transform has shape {T.shape}, expected (4, 4)")
    return T
