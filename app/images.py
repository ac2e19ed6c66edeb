"""Images for the page: as the recording holds them, kept for scrubbing."""

from __future__ import annotations

import base64
from collections import OrderedDict
from typing import Protocol

import cv2
import numpy as np

from vins_core.errors import RecordingError
from vins_core.record.recording import RunReader
from vins_core.sensors import ImageRef

CACHE_BYTES = 128 * 1024 * 1024
JPEG_QUALITY = 90


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
        self._kept: OrderedDict[ImageRef, tuple[str, bytes]] = OrderedDict()
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

    def _encoded(self, ref: ImageRef) -> tuple[str, bytes]:
        if ref in self._kept:
            self._kept.move_to_end(ref)
            return self._kept[ref]
        self._kept[ref] = mime, data = self._source.encoded(ref)
        self._size += len(data)
        while self._size > self._keep_bytes and len(self._kept) > 1:
            _, (_, dropped) = self._kept.popitem(last=False)
            self._size -= len(dropped)
        return mime, data
