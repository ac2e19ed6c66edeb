"""Every encoding gives the grey image that a camera of that kind means."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from tiny_recording import FORMATS, T0, encoded, picture, recorded

from vins_core.io import images
from vins_core.io.messages import ImageMessage


def grey(format: str, data: np.ndarray | bytes) -> np.ndarray:
    return images.grey(ImageMessage(T0, "/cam0", format, data), "a.bag")


def test_mono8_is_taken_as_it_is() -> None:
    assert np.array_equal(grey("mono8", picture(0)), picture(0))


def test_mono16_spans_black_to_white() -> None:
    levels = np.arange(256, dtype=np.uint16)[None] * 257
    assert np.array_equal(grey("mono16", levels)[0], np.arange(256))
    assert grey("mono16", np.array([[0, 65535]], np.uint16)).tolist() == [[0, 255]]


@pytest.mark.parametrize(("encoding", "order"), [("bgr8", (0, 1, 2)), ("rgb8", (2, 1, 0)), ("bgra8", (0, 1, 2, 3))])
def test_colours_become_their_luma(encoding: str, order: tuple[int, ...]) -> None:
    bgra = picture(0, (48, 64, 4))
    b, g, r = (bgra[..., k].astype(float) for k in range(3))
    assert np.abs(grey(encoding, bgra[..., order]) - (0.114 * b + 0.587 * g + 0.299 * r)).max() <= 1.0


@pytest.mark.parametrize(
    ("encoding", "red", "blue"),
    [
        ("bayer_rggb8", (0, 0), (1, 1)),
        ("bayer_bggr8", (1, 1), (0, 0)),
        ("bayer_gbrg8", (1, 0), (0, 1)),
        ("bayer_grbg8", (0, 1), (1, 0)),
    ],
)
def test_a_bayer_mosaic_of_one_colour_gives_its_luma(
    encoding: str, red: tuple[int, int], blue: tuple[int, int]
) -> None:
    mosaic = np.full((48, 64), 120, np.uint8)  # green
    mosaic[red[0] :: 2, red[1] :: 2], mosaic[blue[0] :: 2, blue[1] :: 2] = 250, 20
    luma = 0.299 * 250 + 0.587 * 120 + 0.114 * 20
    assert np.abs(grey(encoding, mosaic)[4:-4, 4:-4] - luma).max() <= 1.5


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 3)])
def test_a_png_and_its_raw_pixels_give_the_same_bits(shape: tuple[int, ...]) -> None:
    raw = picture(3, shape)
    png = cv2.imencode(".png", raw)[1].tobytes()
    assert np.array_equal(grey("png", png), grey("mono8" if raw.ndim == 2 else "bgr8", raw))


def test_a_16_bit_png_is_scaled_like_raw_pixels() -> None:
    raw = picture(4, dtype=np.uint16)
    assert np.array_equal(grey("png", cv2.imencode(".png", raw)[1].tobytes()), grey("mono16", raw))


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize(("suffix", "mime"), [(".jpg", "image/jpeg"), (".png", "image/png")])
def test_a_browser_gets_the_stored_bytes(tmp_path: Path, format: str, suffix: str, mime: str) -> None:
    name = {".jpg": "jpeg", ".png": "png"}[suffix]
    recording = recorded(tmp_path, [ImageMessage(T0, "/cam0/image_raw", name, encoded(0, suffix))], format)
    assert recording.encoded(next(recording.images())) == (mime, encoded(0, suffix))


def test_a_browser_gets_raw_pixels_as_jpeg(tmp_path: Path) -> None:
    flat = np.full((48, 64), 77, np.uint8)
    recording = recorded(tmp_path, [ImageMessage(T0, "/cam0/image_raw", "mono8", flat)], "mcap")
    mime, data = recording.encoded(next(recording.images()))
    assert mime == "image/jpeg"
    assert np.abs(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE).astype(int) - 77).max() <= 1
