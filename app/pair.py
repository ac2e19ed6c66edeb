"""Two keyframes side by side as arrays: what was matched, what became of it, and where the pose found sees it.

All pixels are those of the recorded images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vins_core.geometry import se3
from vins_core.geometry.camera import CameraModel
from vins_core.loop.keyframe import LoopKeyframe
from vins_core.report import LoopCandidate, LoopMatches

DEPTHS_M = np.geomspace(0.2, 100.0, 24)
"""Distances along a ray at which its image in the other camera is looked up: a line for any camera model."""


@dataclass(frozen=True)
class PairPicture:
    """One row per landmark of the later keyframe that has a match; (2, ...) is later, earlier."""

    width: int
    height: int
    matches: LoopMatches
    track_ids: np.ndarray  # (n,)
    uv_px: np.ndarray  # (2, n, 2) where it is seen, and where its match is
    reprojected_px: np.ndarray  # (n, 2) where the pose sees the landmark in the earlier image; NaN without a pose
    epipolar_px: np.ndarray  # (2, n, s, 2) images of the other point's ray; NaN outside and without a pose


def pair_picture(
    candidate: LoopCandidate, later: LoopKeyframe, earlier: LoopKeyframe, camera: CameraModel
) -> PairPicture | None:
    """None when nothing was matched."""
    matches = candidate.matches
    if matches is None or not len(matches.row):
        return None
    n = len(matches.row)
    seen, found = later.uv_px[:n].astype(float), earlier.uv_px[matches.row].astype(float)
    rays = later.rays[:n].astype(float), earlier.rays[matches.row].astype(float)
    reprojected = np.full((n, 2), np.nan)
    lines = np.full((2, n, len(DEPTHS_M), 2), np.nan)
    if candidate.T_match_query is not None:
        T_c0_c = _between_cameras(candidate.T_match_query, later, earlier)
        landmarks = se3.transform(se3.inverse(later.T_w_c), later.points_w[:n])
        reprojected = _inside(camera, se3.transform(T_c0_c, landmarks))
        lines[1] = _image_of(camera, T_c0_c, rays[0])
        lines[0] = _image_of(camera, se3.inverse(T_c0_c), rays[1])
    return PairPicture(
        camera.width, camera.height, matches, later.track_ids[:n], np.stack([seen, found]), reprojected, lines
    )


def _between_cameras(T_match_query: np.ndarray, later: LoopKeyframe, earlier: LoopKeyframe) -> np.ndarray:
    """(4, 4) T_c0_c of the earlier camera and the later one."""
    T = se3.from_quaternion_translation(T_match_query[3:], T_match_query[:3])
    return se3.inverse(earlier.T_b_c) @ T @ later.T_b_c


def _image_of(camera: CameraModel, T_a_b: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(n, s, 2) pixels in camera a of points along rays (n, 3) of camera b."""
    points = se3.transform(T_a_b, (rays[:, None] * DEPTHS_M[:, None]).reshape(-1, 3))
    return _inside(camera, points).reshape(len(rays), len(DEPTHS_M), 2)


def _inside(camera: CameraModel, points_c: np.ndarray) -> np.ndarray:
    """(n, 2) pixels, NaN for what the image does not show."""
    with np.errstate(all="ignore"):
        uv = np.asarray(camera.project(points_c), float)
        shown = np.all((uv >= 0) & (uv <= [camera.width, camera.height]), axis=1)
    return np.where(shown[:, None], uv, np.nan)
