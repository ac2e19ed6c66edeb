"""Where tracks live: Shi-Tomasi corners, spread over the image by a minimum distance (REFERENCE T8, T9)."""

from __future__ import annotations

import cv2
import numpy as np

from ..params import Frontend


def keep_spaced(uv_px: np.ndarray, min_dist: float, usable: np.ndarray | None) -> np.ndarray:
    """(n,) bool: tracks that keep their place, given in order of precedence (n, 2).

    A track goes when it lies outside the usable area or within `min_dist` of a kept track before it.
    """
    free = np.ones(len(uv_px), bool) if usable is None else usable[tuple(np.rint(uv_px).astype(int).T[::-1])] > 0
    u, v = uv_px.T
    apart = np.square(u[:, None] - u) + np.square(v[:, None] - v) > min_dist**2
    keep = np.zeros(len(uv_px), bool)
    for i in range(len(uv_px)):
        if free[i]:
            keep[i] = True
            free &= apart[i]
    return keep


def detect_corners(
    image: np.ndarray, n: int, taken_uv_px: np.ndarray, params: Frontend, usable: np.ndarray | None
) -> np.ndarray:
    """Up to n new corners (k, 2) float32, strongest first, away from the border and the tracks there are."""
    if n <= 0:
        return np.zeros((0, 2), np.float32)
    border = params.border_px
    inside = slice(border, image.shape[0] - border), slice(border, image.shape[1] - border)
    mask = np.zeros(image.shape, np.uint8)
    mask[inside] = 255 if usable is None else usable[inside]
    for u, v in np.rint(taken_uv_px).astype(int).tolist():
        cv2.circle(mask, (u, v), params.min_dist, 0, cv2.FILLED)
    corners = cv2.goodFeaturesToTrack(image, n, params.corner_quality, params.min_dist, mask=mask)
    return np.zeros((0, 2), np.float32) if corners is None else corners.reshape(-1, 2)
