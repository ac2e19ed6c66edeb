"""YAML as calibration tools write it, read strictly: OpenCV's dialect, no duplicate keys, no missing ones.

Only plain values are constructed, so opening a file can run nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError, SafeConstructor
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode

from ..errors import CalibrationError

MAX_BYTES = 1_000_000


class _Constructor(SafeConstructor):
    """YAML 1.2 plain values, and OpenCV's matrix as the mapping it is."""


def _opencv_matrix(constructor: SafeConstructor, node: MappingNode) -> dict[str, Any]:
    return dict(constructor.construct_mapping(node, deep=True))


_Constructor.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a file; raises CalibrationError naming file and line."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise CalibrationError(f"{path}: {path.stat().st_size} bytes; a calibration file has less than {MAX_BYTES}")
        text = path.read_text(encoding="utf-8-sig", errors="replace")  # comments come in any encoding
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error
    if text.startswith("%YAML:"):  # OpenCV's header, which YAML itself does not allow, and its tolerance of tabs
        text = "#" + text.expandtabs()
    yaml = YAML(typ="safe", pure=True)
    yaml.Constructor = _Constructor
    try:
        content = yaml.load(text)
    except DuplicateKeyError as error:
        raise CalibrationError(f"{path}, line {_line(error)}: {_first_line(error)}; keep one of them") from error
    except MarkedYAMLError as error:
        raise CalibrationError(f"{path}, line {_line(error)}: not valid YAML: {error.problem}") from error
    except (YAMLError, ValueError, RecursionError) as error:
        raise CalibrationError(f"{path}: not valid YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(content, dict):
        raise CalibrationError(f"{path}: expected YAML with `key: value` lines")
    return content


def _line(error: MarkedYAMLError) -> int | str:
    return error.problem_mark.line + 1 if error.problem_mark else "?"


def _first_line(error: MarkedYAMLError) -> str:
    return str(error.problem).splitlines()[0]


class Keys:
    """A mapping that must have what is asked of it: a missing or ill-typed key is an error that names the file."""

    def __init__(self, path: Path, content: Mapping[str, Any], where: str = "") -> None:
        self.path = path
        self.content = content
        self.where = where
        self.used: set[str] = set()

    def __contains__(self, key: str) -> bool:
        return key in self.content

    def unused(self) -> list[str]:
        return [key for key in self.content if key not in self.used]

    def raw(self, key: str, expected: str) -> Any:
        self.used.add(key)
        if self.content.get(key) is None:
            raise CalibrationError(f"{self.path}: key {self.where}{key} is missing; expected {expected}")
        return self.content[key]

    def number(self, key: str, expected: str, *, positive: bool = False) -> float:
        value = self.raw(key, expected)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise self.wrong(key, value, expected)
        if positive and value <= 0:
            raise self.wrong(key, value, f"{expected}, greater than zero")
        return float(value)

    def integer(self, key: str, expected: str) -> int:
        value = self.number(key, expected)
        if value != int(value):
            raise self.wrong(key, value, expected)
        return int(value)

    def text(self, key: str, expected: str) -> str:
        value = self.raw(key, expected)
        if not isinstance(value, str) or not value.strip():
            raise self.wrong(key, value, expected)
        return value.strip()

    def mapping(self, key: str, expected: str) -> Keys:
        value = self.raw(key, expected)
        if not isinstance(value, dict):
            raise self.wrong(key, value, expected)
        return Keys(self.path, value, f"{self.where}{key}.")

    def numbers(self, key: str, n: int, expected: str) -> list[float]:
        value = self.raw(key, expected)
        good = isinstance(value, list) and len(value) == n
        if not good or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in value):
            raise self.wrong(key, value, f"{expected}, {n} numbers")
        return [float(v) for v in value]

    def matrix(self, key: str, rows: int, cols: int, expected: str) -> np.ndarray:
        """OpenCV's `rows, cols, data`, or a list of rows."""
        value = self.raw(key, expected)
        if isinstance(value, dict):
            if (value.get("rows"), value.get("cols")) != (rows, cols):
                raise self.wrong(key, f"{value.get('rows')}x{value.get('cols')}", f"a {rows}x{cols} matrix: {expected}")
            value = value.get("data")
        try:
            array = np.array(value, float)
            if array.size != rows * cols or not np.all(np.isfinite(array)):
                raise ValueError
        except (TypeError, ValueError):
            raise self.wrong(key, "something else", f"{rows * cols} numbers: {expected}") from None
        return array.reshape(rows, cols)

    def transform(self, key: str, expected: str) -> np.ndarray:
        """A rigid 4x4 transform, its rotation made orthonormal where the file rounds it."""
        T = self.matrix(key, 4, 4, expected)
        if np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-9:
            raise self.wrong(key, "another last row", f"0 0 0 1 there: {expected}")
        return rigid(T[:3, :3], T[:3, 3], self, key)

    def wrong(self, key: str, value: Any, expected: str) -> CalibrationError:
        return CalibrationError(f"{self.path}: key {self.where}{key} is {str(value)[:60]}; expected {expected}")


def rigid(R: np.ndarray, t: np.ndarray, keys: Keys, key: str) -> np.ndarray:
    """4x4 transform with the rotation nearest to R; refuses what is no rotation."""
    U, _, Vt = np.linalg.svd(R)
    nearest = U @ Vt
    error = np.abs(nearest - R).max()
    if error > 1e-2 or np.linalg.det(nearest) < 0:
        raise keys.wrong(key, "no rotation", "orthonormal rows and determinant 1")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = (R if error < 1e-9 else nearest), t
    return T
