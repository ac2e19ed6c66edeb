"""Pixels of image messages: any encoding to grey, and bytes a browser can show."""

from __future__ import annotations

import cv2
import numpy as np

from ..errors import RecordingError
from .messages import ImageMessage

MIME = {"jpeg": "image/jpeg", "png": "image/png"}

TO_GREY = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
    # OpenCV names a Bayer pattern by its second row, ROS by its first
    "bayer_rggb8": cv2.COLOR_BayerBG2GRAY,
    "bayer_bggr8": cv2.COLOR_BayerRG2GRAY,
    "bayer_gbrg8": cv2.COLOR_BayerGR2GRAY,
    "bayer_grbg8": cv2.COLOR_BayerGB2GRAY,
}
CHANNELS = {"mono8": 1, "8UC1": 1, "mono16": 1, "16UC1": 1, "bgr8": 3, "8UC3": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4}
CHANNELS |= {"32FC1": 1}
CHANNELS |= {name: 1 for name in TO_GREY if name.startswith("bayer")}


DEPTH = ("16UC1", "32FC1")
COMPRESSED_DEPTH_HEADER = 12
"""Bytes before the PNG in a compressedDepth message of 16UC1: how 32FC1 would be quantised."""


def depth_bytes(encoding: str) -> int:
    """Bytes per channel of a raw encoding."""
    return 4 if "32" in encoding else 2 if "16" in encoding else 1


def is_depth(message: ImageMessage) -> bool:
    return message.format in DEPTH or "compressedDepth" in message.format


def without_depth_header(data: bytes) -> bytes:
    """The PNG in a compressedDepth message."""
    inner = data[COMPRESSED_DEPTH_HEADER:]
    return inner if not sniff(data) and sniff(inner) else data


def raw_depth(t_ns: int, topic: str, data: bytes | np.ndarray, source: str) -> ImageMessage:
    """A depth image as pixels, 16UC1 or 32FC1, from them or from a file (16-bit PNG, float TIFF)."""
    pixels = data
    if isinstance(pixels, bytes):
        encoded = np.frombuffer(without_depth_header(pixels), np.uint8)
        try:
            found = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if len(encoded) else None
        except cv2.error:
            found = None
        pixels = np.zeros(0) if found is None else np.asarray(found)
    if pixels.ndim != 2 or pixels.dtype not in (np.uint16, np.float32):
        raise RecordingError(
            f"{source}: the depth image of {topic} at {t_ns} ns cannot be read: "
            "expected 16UC1 or 32FC1, one channel of 16-bit integers or 32-bit floating point"
        )
    return ImageMessage(t_ns, topic, "16UC1" if pixels.dtype == np.uint16 else "32FC1", pixels)


def depth_m(message: ImageMessage, scale_m: float, source: str) -> np.ndarray:
    """(rows, columns) float32 in metres, NaN where there is none (0, infinite or negative).

    Integers count `scale_m`; floating point is in metres already (REP 118).
    """
    pixels = raw_depth(message.t_ns, message.topic, message.data, source).data
    assert isinstance(pixels, np.ndarray)
    depth = pixels.astype(np.float32)
    if pixels.dtype == np.uint16:
        depth *= np.float32(scale_m)
    depth[~((depth > 0) & np.isfinite(depth))] = np.nan
    return depth


def grey(message: ImageMessage, source: str) -> np.ndarray:
    """Grey image (rows, columns) uint8.  16 bits are scaled by 1/257, colour by the BT.601 luma.

    A JPEG gives its own luma, so that no rounding depends on a detour over colours.
    """
    if isinstance(message.data, np.ndarray):
        return _raw_grey(message.format, message.data, message, source)
    flags = cv2.IMREAD_GRAYSCALE if message.format == "jpeg" else cv2.IMREAD_UNCHANGED
    data = np.frombuffer(message.data, np.uint8)
    try:
        pixels = cv2.imdecode(data, flags) if len(data) else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise RecordingError(
            f"{source}: the image of {message.topic} at {message.t_ns} ns cannot be read: "
            f"{len(data)} bytes that are no complete {message.format.upper()}"
        )
    depth = 16 if pixels.dtype == np.uint16 else 8
    encoding = {1: f"mono{depth}", 3: "bgr8", 4: "bgra8"}[1 if pixels.ndim == 2 else pixels.shape[2]]
    if depth == 16 and pixels.ndim == 3:
        pixels = _to_8_bits(pixels)
    return _raw_grey(encoding, pixels, message, source)


def _raw_grey(encoding: str, pixels: np.ndarray, message: ImageMessage, source: str) -> np.ndarray:
    if encoding in ("mono16", "16UC1"):
        return _to_8_bits(pixels)
    if encoding in ("mono8", "8UC1"):
        return pixels
    code = TO_GREY.get("bgr8" if encoding == "8UC3" else encoding)
    if code is None:
        raise RecordingError(
            f"{source}: the image of {message.topic} at {message.t_ns} ns has encoding {encoding!r}; "
            f"expected one of {', '.join(CHANNELS)}"
        )
    return np.asarray(cv2.cvtColor(pixels, code))


def _to_8_bits(pixels: np.ndarray) -> np.ndarray:
    return ((pixels.astype(np.uint32) + 128) // 257).astype(np.uint8)


def for_browser(message: ImageMessage, source: str) -> tuple[str, bytes]:
    """(mime type, bytes)."""
    if isinstance(message.data, bytes) and message.format in MIME:
        return MIME[message.format], message.data
    done, data = cv2.imencode(".jpg", grey(message, source), [cv2.IMWRITE_JPEG_QUALITY, 90])
    assert done
    return MIME["jpeg"], data.tobytes()


def sniff(data: bytes) -> str:
    """Format of encoded bytes by their signature: "jpeg", "png", or "" when it is neither."""
    if data[:2] == b"\xff\xd8":
        return "jpeg"
    return "png" if data[:4] == b"\x89PNG" else ""
