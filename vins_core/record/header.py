"""What is known about a run before its first frame: `header.json`, readable by people."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
import uuid
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import msgspec
import numpy as np

from .. import params as parameters
from ..errors import ParameterError, RunError, VinspectError
from ..geometry.camera import camera_from_dict, camera_to_dict
from ..params import Params
from ..sensors import Calibration, CameraCalibration

FORMAT = "vinspect run"
SCHEMA = 3
"""Raised when an older reader would misread a record; fields that are only added do not raise it."""
MAX_HEADER_BYTES = 16 * 1024 * 1024
_PACKAGES = ("vinspect", "numpy", "scipy", "opencv-python-headless", "casadi", "rosbags", "msgspec")


@dataclass(frozen=True)
class Parent:
    """The run that a fork began as: frames before `frame` are its own, byte for byte."""

    id: str
    path: str  # where it was then; the fork does not need it
    frame: int  # the first one computed with the changed parameters
    changes: Mapping[str, Any]  # section.name -> value from this frame on
    before: Mapping[str, Any] = field(default_factory=dict)  # the same keys -> value before it
    parent: Parent | None = None  # of the parent, when it was a fork itself


@dataclass(frozen=True)
class RunHeader:
    """How a run came about: enough to repeat it, and to say why a repetition may differ (SPEC 9.2)."""

    params: Params
    calibration: Calibration
    mode: str = "mono_imu"  # which of its sensors are used: io/modes.py
    origins: Mapping[str, str] = field(default_factory=dict)  # key -> "default" | "config" | "params" | "set" | "fork"
    recording: str = ""  # path it was read from
    recording_kind: str = ""  # "asl", "ros1", "ros2", "mcap"
    topics: Mapping[str, str] = field(default_factory=dict)  # e.g. cam0 -> /cam0/image_raw, imu -> /imu0
    start_s: float = 0.0  # seconds from the recording's first image
    duration_s: float | None = None  # None: to the end
    expected_frames: int | None = None  # estimate made when the run started, for progress and time axes
    backend: str = ""  # what evaluates the factors
    embedded_images: bool = False
    notes: tuple[str, ...] = ()  # what the calibration files said that was ignored or assumed
    parent: Parent | None = None  # of a fork
    id: str = field(default_factory=lambda: uuid.uuid4().hex[:12])  # names the run wherever its folder is
    created_utc: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    versions: Mapping[str, str] = field(default_factory=lambda: package_versions())
    cpu: str = field(default_factory=lambda: cpu_model())

    def params_at(self, frame: int) -> Params:
        """The parameters that a frame was computed with: those of a parent, for what a fork copied of it."""
        params = self.params
        for parent in self.lineage():
            if frame < parent.frame:
                params = parameters.replace(params, parent.before)
        return params

    def lineage(self) -> Iterator[Parent]:
        """Its parent, that one's parent, and so on."""
        parent = self.parent
        while parent is not None:
            yield parent
            parent = parent.parent


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
    return seal({"format": FORMAT, "schema": SCHEMA, **plain})


def from_json(data: bytes, where: str) -> RunHeader:
    """Raises RunError, naming the file, when the header is damaged, not one of ours or from a later format."""
    document = _decode(data, where)
    if document.get("format") != FORMAT:
        raise RunError(f"{where} is not the header of a run: expected format {FORMAT!r}")
    if document.get("schema") != SCHEMA:
        raise RunError(
            f"{where} has record schema {document.get('schema')!r} but this version reads {SCHEMA}; "
            "open it with the version of vinspect that wrote it, or run the recording again"
        )
    document = {"id": hashlib.sha256(data).hexdigest()[:12]} | document  # the first records had none
    try:
        header = _build(RunHeader, document, params=_params_from_dict, calibration=_calibration_from_dict)
        header.params_at(-1)  # values of parents are checked, too
    except ParameterError as problem:
        raise RunError(f"{where} was written by another version: {problem}") from None
    except (msgspec.MsgspecError, VinspectError, KeyError, TypeError, ValueError) as problem:
        raise RunError(f"{where} is damaged: {problem}") from None
    unseal(data, where)
    return header


def seal(document: Mapping[str, Any]) -> bytes:
    """JSON for people, with a checksum of its content by which damage is told."""
    plain = msgspec.json.decode(msgspec.json.encode(document))
    return msgspec.json.format(msgspec.json.encode(plain | {"checksum": _checksum(plain)}, order="sorted"), indent=1)


def unseal(data: bytes, where: str) -> dict[str, Any]:
    """What was sealed; RunError when it is not what was written.  The first records had no checksum."""
    document = _decode(data, where)
    checksum = document.pop("checksum", None)
    if checksum not in (None, _checksum(document)):
        raise RunError(f"{where} was changed after it was written: its checksum does not match")
    return document


def _checksum(document: dict[str, Any]) -> int:
    return zlib.crc32(msgspec.json.encode(document, order="sorted"))


def _decode(data: bytes, where: str) -> dict[str, Any]:
    try:
        return msgspec.json.decode(data, type=dict[str, Any])
    except (msgspec.MsgspecError, RecursionError, ValueError) as problem:
        raise RunError(f"{where} is not the header of a run: {problem}") from None


T = TypeVar("T")


def _build(cls: type[T], plain: Any, **special: Callable[[Any], Any]) -> T:
    """The dataclass whose fields are in `plain`, each checked against its declared type or made by `special`."""
    kinds = get_type_hints(cls)
    given = {name: plain[name] for name in kinds if name in msgspec.convert(plain, dict[str, Any])}
    return cls(**{k: special[k](v) if k in special else msgspec.convert(v, kinds[k]) for k, v in given.items()})


def _params_from_dict(plain: Any) -> Params:
    return parameters.replace(Params(), msgspec.convert(plain, dict[str, Any]))


def _calibration_to_dict(calibration: Calibration) -> dict[str, Any]:
    plain = dict(vars(calibration))
    plain["noise"] = dict(vars(calibration.noise))
    plain["cameras"] = [
        {**vars(camera), "model": camera_to_dict(camera.model), "T_b_c": camera.T_b_c.tolist()}
        for camera in calibration.cameras
    ]
    return plain


def _calibration_from_dict(plain: Any) -> Calibration:
    def cameras(rows: Any) -> tuple[CameraCalibration, ...]:
        return tuple(
            _build(CameraCalibration, row, model=lambda m: camera_from_dict(**m), T_b_c=_transform)
            for row in msgspec.convert(rows, list[dict[str, Any]])
        )

    return _build(Calibration, plain, cameras=cameras)


def _transform(rows: Any) -> np.ndarray:
    T_a_b = np.array(msgspec.convert(rows, list[list[float]]), float)
    if T_a_b.shape != (4, 4):
        raise ValueError(f"a transform has shape {T_a_b.shape}, expected (4, 4)")
    return T_a_b
