"""Following points from one image to the next: pyramidal Lucas-Kanade with a check backwards (REFERENCE T4, T5, TF4).

Source: Bouguet, Pyramidal implementation of the Lucas Kanade feature tracker, 2000.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..params import Frontend
from ..report import LossReason
from .ledger import FATES, KEPT

BACK_LEVELS = 1
"""Tracking back starts from where the point was, so a flat pyramid will do."""


def follow(
    previous: np.ndarray, current: np.ndarray, uv_px: np.ndarray, params: Frontend
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 2) float32 in the current image and what became of each point, (n,) uint8 as in `ledger`."""
    fate = np.full(len(uv_px), KEPT, np.uint8)
    if not len(uv_px):
        return uv_px, fate
    found_px, found = _lucas_kanade(previous, current, uv_px, params, params.klt_levels)
    fate[~found] = FATES[LossReason.FLOW]
    fate[found & ~_inside(found_px, current.shape, params.border_px)] = FATES[LossReason.BORDER]
    if params.flow_back:
        alive = np.flatnonzero(fate == KEPT)
        start_px, back = _lucas_kanade(current, previous, found_px[alive], params, BACK_LEVELS, guess=uv_px[alive])
        error_px = np.linalg.norm(start_px - uv_px[alive], axis=1)
        fate[alive[~(back & (error_px <= params.flow_back_px))]] = FATES[LossReason.FLOW_BACK]
    return found_px, fate


def _lucas_kanade(
    previous: np.ndarray,
    current: np.ndarray,
    uv_px: np.ndarray,
    params: Frontend,
    levels: int,
    guess: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    if not len(uv_px):
        return uv_px, np.zeros(0, bool)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, params.klt_iterations, params.klt_epsilon)
    found_px, status, _ = cv2.calcOpticalFlowPyrLK(
        previous,
        current,
        np.ascontiguousarray(uv_px, np.float32),
        np.array(uv_px if guess is None else guess, np.float32),
        winSize=(params.klt_window, params.klt_window),
        maxLevel=levels,
        criteria=criteria,
        flags=0 if guess is None else cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return found_px, status.ravel() == 1


def _inside(uv_px: np.ndarray, shape: tuple[int, ...], border_px: int) -> np.ndarray:
    pixel = np.rint(uv_px)
    return ((pixel >= border_px) & (pixel < np.array([shape[1], shape[0]]) - border_px)).all(1)
