"""The images the tracker looks at: equalised, and kept just long enough to be looked at twice.

Every image is used as the current one and then as the previous one.  Tracker states hold references only; an image
that is no longer kept is decoded again and gives the same pixels, so keeping some changes speed and nothing else.
"""

from __future__ import annotations

from collections import OrderedDict
from functools import lru_cache
from threading import Lock
from weakref import WeakKeyDictionary

import cv2
import numpy as np

from ..errors import CalibrationError
from ..geometry.camera import CameraModel
from ..params import Frontend
from ..sensors import CameraCalibration, ImageRef, ImageSource

CAPACITY = 4
"""Images kept for each source."""

_kept: WeakKeyDictionary[ImageSource, OrderedDict[tuple, np.ndarray]] = WeakKeyDictionary()
_lock = Lock()


def equalized(source: ImageSource, ref: ImageRef, params: Frontend) -> np.ndarray:
    """(rows, columns) uint8, read-only, after CLAHE when `params.equalize` (REFERENCE T3).

    Sources are told apart by identity, and what is kept of one goes when the source goes.
    """
    key = (ref, params.equalize, params.clahe_clip, params.clahe_tiles)
    with _lock:
        kept = _kept.setdefault(source, OrderedDict())
        if key in kept:
            kept.move_to_end(key)
            return kept[key]
    image = source.load(ref)
    if params.equalize:
        image = cv2.createCLAHE(params.clahe_clip, (params.clahe_tiles, params.clahe_tiles)).apply(image)
    image = image.view()
    image.flags.writeable = False
    with _lock:
        kept[key] = image
        while len(kept) > CAPACITY:
            kept.popitem(last=False)
    return image


def check_size(image: np.ndarray, camera: CameraCalibration, ref: ImageRef) -> None:
    """Raises CalibrationError when the image cannot come from the calibrated camera."""
    rows, columns = image.shape
    if (columns, rows) != (camera.model.width, camera.model.height):
        raise CalibrationError(
            f"{camera.topic or camera.name}: image {ref.index} at {ref.t_ns} ns is {columns}x{rows}, but the "
            f"calibration of {camera.name} says {camera.model.width}x{camera.model.height}; use the calibration of "
            "this camera at this resolution"
        )


def usable_area(camera: CameraCalibration) -> np.ndarray | None:
    """(rows, columns) uint8 with 255 where tracks may live: where the lens shows something and the mask is white.

    None when that is everywhere.
    """
    lens = _lens_area(camera.model)
    if not camera.mask:
        return lens
    mask = _read_mask(camera.mask)
    if mask.shape != (camera.model.height, camera.model.width):
        raise CalibrationError(
            f"mask {camera.mask} is {mask.shape[1]}x{mask.shape[0]}, but {camera.name} gives "
            f"{camera.model.width}x{camera.model.height} images; the mask must have the size of the images"
        )
    return mask if lens is None else mask & lens


@lru_cache(maxsize=4)
def _lens_area(model: CameraModel) -> np.ndarray | None:
    """255 where pixels have a ray; None when all have, which those on the border decide for every radial lens."""
    u, v = np.meshgrid(np.arange(model.width), np.arange(model.height))
    edge = (u == 0) | (v == 0) | (u == model.width - 1) | (v == model.height - 1)
    if np.isfinite(model.lift(np.stack([u[edge], v[edge]], -1))).all():
        return None
    seen = np.isfinite(model.lift(np.stack([u.ravel(), v.ravel()], -1))).all(1)
    area = np.where(seen, np.uint8(255), np.uint8(0)).reshape(u.shape)
    area.flags.writeable = False
    return area


@lru_cache(maxsize=4)
def _read_mask(path: str) -> np.ndarray:
    try:
        encoded = np.fromfile(path, np.uint8)
    except OSError as error:
        raise CalibrationError(f"mask {path} cannot be read: {error.strerror}; check the mask of the camera") from None
    image = cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE) if len(encoded) else None
    if image is None:
        raise CalibrationError(f"mask {path} is not an image; expected PNG or JPEG, white where usable")
    mask = np.where(image > 127, np.uint8(255), np.uint8(0))
    mask.flags.writeable = False
    return mask
