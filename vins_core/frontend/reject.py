"""Tracks that no rigid scene explains: a fundamental matrix by RANSAC on lifted points (REFERENCE T7).

Points are put in a virtual camera of focal length 460, so that the threshold means the same for every lens.  A plane
cannot hold rays near or beyond 90 degrees; those take no part in the estimate and are tested against its outcome by
their angle to the epipolar plane, in the same unit.
"""

from __future__ import annotations

import cv2
import numpy as np

FOCAL_PX = 460.0
MIN_POINTS = 8
MIN_COS = 0.5
"""Rays within 60 degrees of the optical axis go onto the virtual image plane."""


def fundamental_ransac(
    rays_a: np.ndarray, rays_b: np.ndarray, threshold_px: float, confidence: float
) -> np.ndarray | None:
    """Which pairs of unit rays (n, 3) agree on one motion, (n,) bool.

    None with fewer than 8 pairs near the optical axis, or when they agree on nothing.  threshold_px: largest distance
    to the epipolar line, px460.  Deterministic: OpenCV seeds its own generator.
    """
    central = (rays_a[:, 2] > MIN_COS) & (rays_b[:, 2] > MIN_COS)
    if central.sum() < MIN_POINTS:
        return None
    plane_a, plane_b = (FOCAL_PX * r[central, :2] / r[central, 2:] for r in (rays_a, rays_b))
    F_px, mask = cv2.findFundamentalMat(
        plane_a.astype(np.float32), plane_b.astype(np.float32), cv2.FM_RANSAC, threshold_px, confidence
    )
    if F_px is None or F_px.shape != (3, 3):
        return None
    K = np.diag([FOCAL_PX, FOCAL_PX, 1.0])
    F = K @ F_px @ K
    inlier = np.ones(len(rays_a), bool)
    inlier[central] = mask.ravel() == 1
    wide = ~central
    inlier[wide] = epipolar_distance_px(F, rays_a[wide], rays_b[wide]) <= threshold_px
    return inlier


def epipolar_distance_px(F: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray) -> np.ndarray:
    """The larger of the two angles between a ray and the epipolar plane of its partner, times 460, (n,)."""
    return FOCAL_PX * np.maximum(_off_plane(rays_b, rays_a @ F.T), _off_plane(rays_a, rays_b @ F))


def _off_plane(rays: np.ndarray, normals: np.ndarray) -> np.ndarray:
    sine = np.einsum("ni,ni->n", rays, normals) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    return np.abs(np.arcsin(np.clip(sine, -1.0, 1.0)))
