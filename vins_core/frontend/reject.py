"""Tracks that no rigid scene explains: epipolar RANSAC on lifted points (REFERENCE T7).

Points are put in a virtual camera of focal length 460, so that the threshold means the same for every lens.  As the
camera is calibrated, five points give an essential matrix; a locally optimised RANSAC over it throws away about a
tenth of the good tracks that VINS' seven-point fundamental matrix loses (parity keeps that one).

A plane cannot hold rays near or beyond 90 degrees: those take no part in the estimate and are tested against its
outcome by their angle to the epipolar plane, in the same unit.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..params import Frontend

FOCAL_PX = 460.0
MIN_PAIRS = 8
MIN_COS = 0.5
"""Rays within 60 degrees of the optical axis go onto the virtual image plane."""


def epipolar_inliers(rays_a: np.ndarray, rays_b: np.ndarray, params: Frontend) -> np.ndarray | None:
    """Which pairs of unit rays (n, 3) agree on one motion of the camera, (n,) bool; None when that cannot be judged.

    It cannot with fewer than 8 pairs near the optical axis.  Deterministic: OpenCV's estimators seed themselves.
    """
    central = (rays_a[:, 2] > MIN_COS) & (rays_b[:, 2] > MIN_COS)
    if central.sum() < MIN_PAIRS:
        return None
    uv_a, uv_b = (FOCAL_PX * rays[central, :2] / rays[central, 2:] for rays in (rays_a, rays_b))
    if params.epipolar_model == "essential":
        E, mask = cv2.findEssentialMat(
            uv_a, uv_b, FOCAL_PX, (0.0, 0.0), cv2.USAC_ACCURATE, params.F_confidence, params.F_threshold
        )
    else:
        F_px, mask = cv2.findFundamentalMat(uv_a, uv_b, cv2.FM_RANSAC, params.F_threshold, params.F_confidence)
        K = np.diag([FOCAL_PX, FOCAL_PX, 1.0])
        E = None if F_px is None else K @ F_px[:3] @ K
    moved = E is not None and mask is not None and mask.any()
    inlier = np.zeros(len(rays_a), bool)
    if moved:
        inlier[central] = mask.ravel() > 0
        inlier[~central] = epipolar_distance_px(E, rays_a[~central], rays_b[~central]) <= params.F_threshold
    still = FOCAL_PX * np.linalg.norm(rays_b - rays_a, axis=1) <= params.F_threshold
    return inlier if inlier.sum() >= still.sum() else still  # without any motion E is anything


def epipolar_distance_px(E: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray) -> np.ndarray:
    """The larger of the two angles between a ray and the epipolar plane of its partner (r_b' E r_a = 0), px460."""
    return FOCAL_PX * np.maximum(_angle_off_plane(rays_b, rays_a @ E.T), _angle_off_plane(rays_a, rays_b @ E))


def _angle_off_plane(rays: np.ndarray, normals: np.ndarray) -> np.ndarray:
    sine = np.einsum("ni,ni->n", rays, normals) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    return np.abs(np.arcsin(np.clip(sine, -1.0, 1.0)))
