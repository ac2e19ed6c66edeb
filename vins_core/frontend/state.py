"""What the tracker carries from image to image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..sensors import ImageRef
from ..window.state import Observations


@dataclass(frozen=True)
class TrackerState:
    """Tracks alive in `image`, in tracker order (oldest first).  Pixels are not stored: `image` is a reference."""

    image: ImageRef | None  # the last image tracked; None before the first
    ids: np.ndarray  # (n,) int64
    uv_px: np.ndarray  # (n, 2) float32, in `image`
    rays: np.ndarray  # (n, 3) float64 unit rays of uv_px
    age: np.ndarray  # (n,) int32, images the track has been seen in
    frame_uv_px: (
        np.ndarray
    )  # (n, 2) float32, position in the last *frame* (what F-RANSAC compares with); NaN if born after it
    next_id: int
    right: Observations | None = None  # what the second camera saw at the last frame; None without one

    @staticmethod
    def empty() -> TrackerState:
        return TrackerState(
            None,
            np.zeros(0, np.int64),
            np.zeros((0, 2), np.float32),
            np.zeros((0, 3)),
            np.zeros(0, np.int32),
            np.zeros((0, 2), np.float32),
            0,
        )
