"""Camera models: pixels to unit rays and back.

Every model works on unit rays, so that fields of view beyond 180 degrees need no special case.
`project` of a point outside the model's domain gives NaN; `lift` of a pixel outside it gives NaN.

A model is one frozen dataclass in a file of its own whose fields are the calibrated numbers; listing it in `MODELS`
is all it takes for calibration readers and records to know it by name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np

from ..errors import CalibrationError
from .kannala_brandt import KannalaBrandt
from .mei import Mei
from .pinhole_radtan import PinholeRadtan
from .pinhole_rational import PinholeRational
from .scaramuzza import Scaramuzza


class CameraModel(Protocol):
    """Shape-only interface; one frozen dataclass a model, so that a calibration can be compared and stored."""

    name: ClassVar[str]

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    def __hash__(self) -> int: ...

    def project(self, points_c: np.ndarray) -> np.ndarray:
        """(n, 3) points or rays in the camera frame -> (n, 2) pixels, NaN where the model has no image of them."""
        ...

    def lift(self, uv_px: np.ndarray) -> np.ndarray:
        """(n, 2) pixels -> (n, 3) unit rays in the camera frame, NaN outside the model's domain."""
        ...


MODELS: Mapping[str, type[Any]] = MappingProxyType(
    {model.name: model for model in (PinholeRadtan, PinholeRational, KannalaBrandt, Mei, Scaramuzza)}
)


def camera_from_dict(model: str, **values: float) -> CameraModel:
    """The camera of a named model: `camera_from_dict("pinhole-radtan", width=752, ..., p2=0.0)`.

    Every parameter must be there, nothing else may be, and all must be usable numbers; raises CalibrationError.
    """
    if model not in MODELS:
        raise CalibrationError(f"unknown camera model {model!r}; expected one of {', '.join(MODELS)}")
    types = {f.name: int if f.name in ("width", "height") else float for f in dataclasses.fields(MODELS[model])}
    missing, unknown = types.keys() - values.keys(), values.keys() - types.keys()
    if missing or unknown:
        wrong = [
            f"{word} {', '.join(sorted(keys))}" for word, keys in (("missing", missing), ("unknown", unknown)) if keys
        ]
        raise CalibrationError(f"camera model {model}: {'; '.join(wrong)}; it needs {', '.join(types)}")
    for key, kind in types.items():
        value = values[key]
        number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        positive = key in ("width", "height", "fx", "fy")
        if not number or not np.isfinite(value) or value != kind(value) or (positive and value <= 0):
            expected = ("a positive " if positive else "a finite ") + ("integer" if kind is int else "number")
            raise CalibrationError(f"camera model {model}: {key}={value!r}; expected {expected}")
    return MODELS[model](**{key: kind(values[key]) for key, kind in types.items()})


def camera_to_dict(camera: CameraModel) -> dict[str, Any]:
    """Numbers that give the same camera again: `camera_from_dict(**camera_to_dict(camera)) == camera`."""
    return {"model": camera.name} | {f.name: getattr(camera, f.name) for f in dataclasses.fields(camera)}  # type: ignore
