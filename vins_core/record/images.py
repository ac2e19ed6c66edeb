"""Images in a record, losslessly."""

from __future__ import annotations

import numpy as np

from ..errors import RunError

MAX_IMAGE_PIXELS = 2**26


def encode(image: np.ndarray) -> bytes:
    import cv2

    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def decode(png: bytes, shape: tuple[int, int], where: str) -> np.ndarray:
    import cv2

    width, height = int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")  # of the IHDR chunk
    if (height, width) != shape or height * width > MAX_IMAGE_PIXELS:  # told before a forged size takes memory
        raise RunError(f"{where} holds an image of {width}x{height} where {shape[1]}x{shape[0]} is calibrated")
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise RunError(f"{where} does not hold an image")
    return image
