"""Images for the page: as the recording holds them, kept for scrubbing."""

from __future__ import annotations

import base64
from collections import OrderedDict
from typing import Protocol

import cv2
import numpy as np

from vins_core.errors import RecordingError
from vins_core.record.reader import RunReader
from vins_core.sensors import DepthCalibration, DepthRef, DepthSource, ImageRef

CACHE_BYTES = 128 * 1024 * 1024
JPEG_QUALITY = 90
NEAREST_M, FARTHEST_M = 0.3, 10.0
"""Ends of the colours of depth where the calibration is wider."""


class ImageBytes(Protocol):
    """Gives images a browser can show; recordings implement it."""

    def encoded(self, ref: ImageRef) -> tuple[str, bytes]:
        """(mime type, bytes); raises VinspectError."""
        ...


class EmbeddedImages:
    """The images inside a run record."""

    def __init__(self, run: RunReader) -> None:
        self._run = run

    def encoded(self, ref: ImageRef) -> tuple[str, bytes]:
        pixels = self._run.load(ref)
        return "image/jpeg", cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()

    def load(self, ref: ImageRef) -> np.ndarray:
        return self._run.load(ref)

    def load_depth(self, ref: DepthRef, scale_m: float) -> np.ndarray:
        return self._run.load_depth(ref, scale_m)


class NoImages:
    """Stands where a recording cannot be opened any more; every image is the same sentence."""

    def __init__(self, why: str) -> None:
        self._why = why

    def encoded(self, ref: ImageRef) -> tuple[str, bytes]:
        raise RecordingError(self._why)


class Images:
    """The images of a run by reference; the most recent ones stay in memory, so that scrubbing encodes nothing."""

    def __init__(self, source: ImageBytes, keep_bytes: int = CACHE_BYTES) -> None:
        self._source = source
        self._keep_bytes = keep_bytes
        self._kept: OrderedDict[ImageRef | DepthRef, tuple[str, bytes]] = OrderedDict()
        self._size = 0

    def uri(self, ref: ImageRef) -> str:
        """`data:` URI for an `img` element.  Raises VinspectError."""
        mime, data = self._encoded(ref)
        return f"data:{mime};base64,{base64.b64encode(data).decode()}"

    def thumbnail(self, ref: ImageRef, width: int = 240) -> np.ndarray:
        """(rows, columns, 3) uint8 of at most this width, for the frustum in the 3D view.  Raises VinspectError."""
        _, data = self._encoded(ref)
        grey = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_2)
        if grey is None:
            raise RecordingError(f"image {ref.index} of camera {ref.camera} at {ref.t_ns} ns cannot be decoded")
        if grey.shape[1] > width:
            size = (width, max(round(width * grey.shape[0] / grey.shape[1]), 1))
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        return cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)

    def depth_uri(self, ref: DepthRef, calibration: DepthCalibration) -> str:
        """A depth image in colours, magma, near bright; `data:` URI of a PNG that is
        transparent where there is no depth, "" from a source without depth images.  Raises VinspectError."""
        if not isinstance(self._source, DepthSource):
            return ""
        if ref not in self._kept:
            self._keep(ref, "image/png", _coloured(self._source.load_depth(ref, calibration.scale_m), calibration))
        self._kept.move_to_end(ref)
        mime, data = self._kept[ref]
        return f"data:{mime};base64,{base64.b64encode(data).decode()}"

    def _encoded(self, ref: ImageRef) -> tuple[str, bytes]:
        if ref in self._kept:
            self._kept.move_to_end(ref)
            return self._kept[ref]
        self._keep(ref, *self._source.encoded(ref))
        return self._kept[ref]

    def _keep(self, ref: ImageRef | DepthRef, mime: str, data: bytes) -> None:
        self._kept[ref] = mime, data
        self._size += len(data)
        while self._size > self._keep_bytes and len(self._kept) > 1:
            _, (_, dropped) = self._kept.popitem(last=False)
            self._size -= len(dropped)


def _coloured(depth_m: np.ndarray, calibration: DepthCalibration) -> bytes:
    """PNG of (rows, columns) metres, NaN transparent."""
    near, far = max(calibration.min_m, NEAREST_M), min(calibration.max_m, FARTHEST_M)
    known = np.isfinite(depth_m)
    share = (far - np.where(known, depth_m, far)) / (far - near)
    bgr = cv2.applyColorMap((255 * np.clip(share, 0, 1)).astype(np.uint8), cv2.COLORMAP_MAGMA)
    bgra = np.dstack([bgr, np.where(known, np.uint8(255), np.uint8(0))])
    return cv2.imencode(".png", bgra, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
