"""Maps on disk: a folder with a header readable by people and one checked file per part.

    map.json              format, camera, counts, and name, size and SHA-256 of every part
    graph-1f0c9a2b.bin    the pose graph (record/codec.py); other stages add parts of their own

Parts are written first, under names made from their content, the header last; so a map that is saved again is either
the old one or the new one, whatever happens.  Reading executes nothing and believes no size.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ..errors import CalibrationError, MapError, OutputError, RunError
from ..geometry.camera import CameraModel, camera_from_dict, camera_to_dict
from ..record.codec import Blob, pack
from .graph import PoseGraph, Session, extend, frozen

FORMAT = "vinspect map"
SCHEMA = 3
HEADER = "map.json"
_MAX_HEADER = 1 << 20
_MAX_PART = 1 << 31


class _Part(msgspec.Struct, frozen=True):
    file: str
    bytes: int
    sha256: str


class _Header(msgspec.Struct, frozen=True):
    format: str
    schema: int
    camera: dict[str, Any]
    keyframes: int
    loops: int
    sessions: int
    parts: dict[str, _Part]


@dataclass(frozen=True)
class _Contents:
    """A pose graph as plain arrays."""

    frame: np.ndarray
    t_ns: np.ndarray
    session: np.ndarray
    T_vio: np.ndarray
    T_corrected: np.ndarray
    loops: np.ndarray
    T_loops: np.ndarray
    disabled: np.ndarray  # (k, 2) int64
    forced: np.ndarray
    sessions: tuple[Session, ...]


def save_map(folder: Path, camera: CameraModel, graph: PoseGraph, parts: Mapping[str, bytes] | None = None) -> None:
    """Write `graph` and further parts (name -> bytes) into `folder`, replacing a map that is there."""
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not (folder / HEADER).is_file())):
        raise OutputError(f"{folder} exists and is not a map; choose another folder")
    blobs = {"graph": pack({"graph": _contents(graph)}), **(parts or {})}
    described = {name: _describe(name, blob) for name, blob in blobs.items()}
    header = _Header(FORMAT, SCHEMA, camera_to_dict(camera), len(graph), graph.n_loops, len(graph.sessions), described)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, blob in blobs.items():
            _write(folder / described[name].file, blob)
        _write(folder / HEADER, msgspec.json.format(msgspec.json.encode(header, order="deterministic"), indent=1))
        kept = {HEADER, *(part.file for part in described.values())}
        for old in folder.glob("*-*.bin"):
            if old.name not in kept:
                old.unlink()
    except OSError as problem:
        raise OutputError(f"cannot write the map {folder}: {problem.strerror}") from None


def load_map(folder: Path, camera: CameraModel) -> tuple[PoseGraph, dict[str, bytes]]:
    """The graph, its sessions being base sessions, and the other parts.  Raises MapError with one sentence."""
    header = _read_header(folder)
    known = camera_to_dict(camera)
    if header.camera != known:
        differs = [k for k in {**header.camera, **known} if header.camera.get(k) != known.get(k)]
        there, here = (", ".join(f"{k} {c.get(k)}" for k in differs) for c in (header.camera, known))
        raise MapError(
            f"the map {folder} was made with another camera: {there} in the map, {here} in this calibration; "
            "use the calibration that the map was made with, or record a new map"
        )
    parts = {name: _read_part(folder, part) for name, part in header.parts.items()}
    if "graph" not in parts:
        raise MapError(f"{folder / HEADER} names no pose graph; the map is damaged, save it again")
    where = f"{folder / header.parts['graph'].file}"
    try:
        contents = Blob(parts.pop("graph"), where).get("graph", _Contents)
        graph = _restore(contents)
    except RunError as problem:
        raise MapError(f"{problem}") from None
    except (ValueError, TypeError, IndexError) as problem:
        raise MapError(f"{where} is damaged: {problem}; save the map again") from None
    if (len(graph), graph.n_loops, len(graph.sessions)) != (header.keyframes, header.loops, header.sessions):
        raise MapError(f"{where} holds other keyframes than {folder / HEADER} announces; save the map again")
    return graph, parts


def camera_of(folder: Path) -> CameraModel:
    """The camera that a map was made with.  Raises MapError."""
    try:
        return camera_from_dict(**_read_header(folder).camera)
    except (CalibrationError, TypeError) as problem:
        raise MapError(f"{folder / HEADER} describes no camera: {problem}; save the map again") from None


def _contents(graph: PoseGraph) -> _Contents:
    def pairs(chosen: frozenset) -> np.ndarray:
        return np.array(sorted(chosen), np.int64).reshape(-1, 2)

    return _Contents(
        graph.frame,
        graph.t_ns,
        graph.session,
        graph.T_vio,
        graph.T_corrected,
        graph.loops,
        graph.T_loops,
        pairs(graph.disabled),
        pairs(graph.forced),
        graph.sessions,
    )


def _restore(c: _Contents) -> PoseGraph:
    """The graph of checked arrays; ValueError says what is wrong with them."""
    n, l, k = len(c.frame), len(c.loops), len(c.sessions)
    for name, shape, kind in (
        ("frame", (n,), "i"),
        ("t_ns", (n,), "i"),
        ("session", (n,), "i"),
        ("T_vio", (n, 7), "f"),
        ("T_corrected", (n, 7), "f"),
        ("loops", (l, 2), "i"),
        ("T_loops", (l, 7), "f"),
        ("disabled", (len(c.disabled), 2), "i"),
        ("forced", (len(c.forced), 2), "i"),
    ):
        array = getattr(c, name)
        if array.shape != shape or array.dtype.kind != kind:
            raise ValueError(f"{name} is {array.dtype} {array.shape}, expected {shape}")
    drifts = np.array([s.drift for s in c.sessions], float).reshape(k, 7)
    for name, T in (("T_vio", c.T_vio), ("T_corrected", c.T_corrected), ("T_loops", c.T_loops), ("drift", drifts)):
        if not np.all(np.isfinite(T)) or np.any(np.abs(np.linalg.norm(T[:, 3:], axis=1) - 1) > 1e-6):
            raise ValueError(f"{name} holds what is no pose")
    starts = np.array([s.first for s in c.sessions] + [n])
    if (k == 0) != (n == 0) or np.any(np.diff(starts) < 0) or (k and starts[0] != 0):
        raise ValueError("its sessions do not follow each other")
    if not np.array_equal(c.session, np.repeat(np.arange(k), np.diff(starts))):
        raise ValueError("its keyframes are not those of its sessions")
    if any(not 0 <= s.group <= number for number, s in enumerate(c.sessions)):
        raise ValueError("its sessions are grouped wrongly")
    if l and not (c.loops.min() >= 0 and c.loops.max() < n and np.all(c.loops[:, 0] < c.loops[:, 1])):
        raise ValueError("a loop names keyframes that do not exist")
    graph = PoseGraph(
        sessions=tuple(replace(s, base=True) for s in c.sessions),
        disabled=frozenset(map(tuple, c.disabled.tolist())),
        forced=frozenset(map(tuple, c.forced.tolist())),
    )
    graph = extend(graph, c.frame, c.t_ns, c.session, c.T_vio, c.loops, c.T_loops)
    return replace(graph, optimized=frozen(np.array(c.T_corrected)))


def _describe(name: str, blob: bytes) -> _Part:
    digest = hashlib.sha256(blob).hexdigest()
    return _Part(f"{name}-{digest[:8]}.bin", len(blob), digest)


def _write(path: Path, data: bytes) -> None:
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(data)
    os.replace(partial, path)


def _read_header(folder: Path) -> _Header:
    path = folder / HEADER
    if not path.is_file():
        raise MapError(f"{folder} is not a map: it has no {HEADER}; expected a folder written by `vinspect map save`")
    if path.stat().st_size > _MAX_HEADER:
        raise MapError(f"{path} is too large for the header of a map; the map is damaged")
    try:
        document = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        if document.get("format") != FORMAT:
            raise MapError(f"{path} is not the header of a map: expected format {FORMAT!r}")
        if document.get("schema") != SCHEMA:
            raise MapError(
                f"{path} has map schema {document.get('schema')!r} but this version reads {SCHEMA}; "
                "save the map again with this version"
            )
        return msgspec.convert(document, _Header)
    except (msgspec.MsgspecError, RecursionError, ValueError, OSError) as problem:
        raise MapError(f"{path} is damaged: {problem}; save the map again") from None


def _read_part(folder: Path, part: _Part) -> bytes:
    path = folder / part.file
    if Path(part.file).name != part.file or not path.is_file():
        raise MapError(f"the map {folder} lacks its part {part.file!r}; copy the whole folder or save the map again")
    if not 0 <= part.bytes <= _MAX_PART or path.stat().st_size != part.bytes:
        raise MapError(f"{path} has {path.stat().st_size} bytes, expected {part.bytes}; save the map again")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != part.sha256:
        raise MapError(f"{path} is damaged: its checksum does not match; save the map again")
    return data
