"""Bit equality of trees of dataclasses, told as the list of where they differ."""

from __future__ import annotations

import dataclasses
import math

import numpy as np


def differences(a: object, b: object, path: str = "") -> list[str]:
    """Where two trees differ in type, value, or a single bit of an array."""
    if type(a) is not type(b):
        return [f"{path}: {type(a).__name__} != {type(b).__name__}"]
    if isinstance(a, np.ndarray):
        assert isinstance(b, np.ndarray)
        same = (a.dtype, a.shape, a.tobytes(), a.flags.fnc) == (b.dtype, b.shape, b.tobytes(), b.flags.fnc)
        return [] if same else [f"{path}: arrays differ"]
    if dataclasses.is_dataclass(a):
        names = [f.name for f in dataclasses.fields(a) if f.compare]  # others only grow, and are shared
        return [d for n in names for d in differences(getattr(a, n), getattr(b, n), f"{path}.{n}")]
    if isinstance(a, dict):
        assert isinstance(b, dict)
        if a.keys() != b.keys():
            return [f"{path}: keys {sorted(a)} != {sorted(b)}"]
        return [d for k in a for d in differences(a[k], b[k], f"{path}[{k!r}]")]
    if isinstance(a, (tuple, list)):
        assert isinstance(b, (tuple, list))
        if len(a) != len(b):
            return [f"{path}: {len(a)} != {len(b)} items"]
        return [d for i, (x, y) in enumerate(zip(a, b, strict=True)) for d in differences(x, y, f"{path}[{i}]")]
    if isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b):
        return []
    return [] if a == b else [f"{path}: {a!r} != {b!r}"]
