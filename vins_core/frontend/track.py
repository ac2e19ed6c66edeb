"""Following points from one image to the next: pyramidal Lucas-Kanade, checked backwards (REFERENCE T4, T5, TF2, TF4).

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
    previous: np.ndarray, current: np.ndarray, uv_px: np.ndarray, params: Frontend, guess_px: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 2) float32 in the current image and what became of each point, (n,) uint8 as in `ledger`.

    With a guess of the positions (n, 2) there are two ways to go: flow alone, and flow from the guess on a flatter
    pyramid; `params.predict` says which comes first.  When it keeps less than `predict_min_share` of the points, the
    other is tried as well, and the better one counts (after TF2).
    """
    if not len(uv_px):
        return uv_px, np.zeros(0, np.uint8)
    ways = [(params.klt_levels, uv_px)]
    if guess_px is not None:
        ways.insert(0 if params.predict == "always" else 1, (params.predict_levels, guess_px))
    best, most = (uv_px, np.full(len(uv_px), FATES[LossReason.FLOW])), -1
    for levels, start_px in ways:
        attempt = there_and_back(previous, current, uv_px, params, levels, start_px)
        kept = int((attempt[1] == KEPT).sum())
        if kept > most:
            best, most = attempt, kept
        if most >= params.predict_min_share * len(uv_px):
            break
    return best


def there_and_back(
    previous: np.ndarray, current: np.ndarray, uv_px: np.ndarray, params: Frontend, levels: int, guess_px: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Flow from a guess over so many levels, and back; results as of `follow`."""
    found_px, found = _lucas_kanade(previous, current, uv_px, params, levels, guess_px)
    fate = np.full(len(uv_px), KEPT, np.uint8)
    fate[~found] = FATES[LossReason.FLOW]
    fate[found & ~_inside(found_px, current.shape, params.border_px)] = FATES[LossReason.BORDER]
    if params.flow_back:
        alive = np.flatnonzero(fate == KEPT)
        start_px, back = _lucas_kanade(current, previous, found_px[alive], params, BACK_LEVELS, uv_px[alive])
        error_px = np.linalg.norm(start_px - uv_px[alive], axis=1)
        fate[alive[~(back & (error_px <= params.flow_back_px))]] = FATES[LossReason.FLOW_BACK]
    return found_px, fate


def _lucas_kanade(
    previous: np.ndarray, current: np.ndarray, uv_px: np.ndarray, params: Frontend, levels: int, guess_px: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where points (n, 2) went, starting from a guess, and which were found, (n,) bool."""
    if not len(uv_px):
        return uv_px, np.zeros(0, bool)
    found_px, status, _ = cv2.calcOpticalFlowPyrLK(
        previous,
        current,
        np.ascontiguousarray(uv_px, np.float32),
        np.array(guess_px, np.float32),  # a copy: OpenCV writes its answer there
        winSize=(params.klt_window, params.klt_window),
        maxLevel=levels,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, params.klt_iterations, params.klt_epsilon),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return found_px, status.ravel() == 1


def _inside(uv_px: np.ndarray, shape: tuple[int, ...], border_px: int) -> np.ndarray:
    pixel = np.rint(uv_px)
    return ((pixel >= border_px) & (pixel < np.array([shape[1], shape[0]]) - border_px)).all(1)
