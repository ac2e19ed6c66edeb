"""A click in the 3D view -> the landmark or the frame under it."""

from __future__ import annotations

import numpy as np

from ..context import Selection
from .frame import SceneFrame

TOLERANCE_RAD = 0.013  # about 8 px


def pick(frame: SceneFrame, origin: np.ndarray, direction: np.ndarray) -> Selection:
    """The landmark or window frame nearest to the ray, nothing when none is near."""
    landmarks, window = frame.report.landmarks, frame.report.window
    if landmarks is None or window is None:
        return Selection()
    k, to_landmark = nearest_to_ray(landmarks.xyz_w, origin, direction)
    j, to_frame = nearest_to_ray(frame.camera_poses()[:, :3, 3], origin, direction)
    if min(to_landmark, to_frame) > TOLERANCE_RAD:
        return Selection()
    if to_landmark <= to_frame:
        return Selection("track", int(landmarks.ids[k]))
    return Selection("frame", int(window.frames[j]))


def nearest_to_ray(points: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[int, float]:
    """(row, angle in rad) of the point nearest to the ray, (-1, inf) without points in front; NaN rows are skipped."""
    v = np.asarray(points, float) - origin
    d = direction / np.linalg.norm(direction)
    along = v @ d
    with np.errstate(invalid="ignore"):
        angle = np.arctan2(np.linalg.norm(v - along[:, None] * d, axis=1), along)
    angle = np.where(np.isfinite(angle) & (along > 0), angle, np.inf)
    if not len(angle) or not np.isfinite(angle.min()):
        return -1, np.inf
    return int(angle.argmin()), float(angle.min())
