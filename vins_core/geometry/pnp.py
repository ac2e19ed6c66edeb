"""Pose of a camera from points with known position and the rays that saw them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from . import se3, so3

MIN_POINTS = 6


@dataclass(frozen=True)
class Pnp:
    T_w_c: np.ndarray  # (4, 4)
    inlier: np.ndarray  # (n,) bool, in front of the camera and within three thresholds
    rms_rad: float  # of the inliers

    @property
    def n_inliers(self) -> int:
        return int(np.count_nonzero(self.inlier))


def tangent_basis(rays: np.ndarray) -> np.ndarray:
    """(n, 3) unit rays -> (n, 3, 2) orthonormal bases of their tangent planes (seed 000.3.3.3)."""
    helper = np.where(np.abs(rays[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(rays, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(rays, first)], -1)


def solve_pnp(
    points_w: np.ndarray, rays_c: np.ndarray, T_w_c_guess: np.ndarray, threshold_rad: float, tolerance: float = 1e-9
) -> Pnp | None:
    """Camera pose from points (n, 3) and unit rays (n, 3), starting at a guess; None for fewer than 6 points.

    Minimises sum log(1 + |r|^2 / threshold^2) with r = B(ray)^T normalised(R^T (p - t)), the miss on the tangent
    plane of the measured ray, until a step lowers it by a share of less than `tolerance`.  When the guess leads
    nowhere, P3P-RANSAC on the rays that reach the image plane gives another start.  Inliers are those of the final
    pose (REFERENCE 23.2); whether they are enough is for the caller.
    """
    if len(points_w) < MIN_POINTS:
        return None
    solved = _refine(points_w, rays_c, T_w_c_guess, threshold_rad, tolerance)
    if solved.n_inliers < 0.7 * len(points_w):
        start = _ransac(points_w, rays_c, threshold_rad)
        if start is not None:
            solved = max(solved, _refine(points_w, rays_c, start, threshold_rad, tolerance), key=lambda s: s.n_inliers)
    return solved


def pose_covariance(T_w_c: np.ndarray, points_w: np.ndarray, rays_c: np.ndarray, sigma_rad: float) -> np.ndarray:
    """(6, 6) covariance of a pose from PnP for rays of that deviation; tangent (dp, dtheta): p + dp, R Exp(dtheta).

    The inverse of J^T J / sigma^2 with J of the miss that `solve_pnp` minimises; the points count as exact.
    """
    J = _jacobian(T_w_c, se3.transform(se3.inverse(T_w_c), points_w), tangent_basis(rays_c)).reshape(-1, 6)
    H = J.T @ J
    return np.linalg.inv(H + 1e-12 * np.trace(H) * np.eye(6)) * sigma_rad**2  # large, not infinite, where undetermined


def _refine(
    points_w: np.ndarray,
    rays_c: np.ndarray,
    T: np.ndarray,
    threshold_rad: float,
    tolerance: float,
    iterations: int = 20,
) -> Pnp:
    """Levenberg-Marquardt on the six pose parameters, R <- R Exp(d)."""
    basis = tangent_basis(rays_c)

    def evaluate(T: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        local = se3.transform(se3.inverse(T), points_w)
        distance = np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-9)
        r = np.einsum("nij,ni->nj", basis, local / distance)
        behind = np.sum(local * rays_c, axis=1) <= 0
        squared = np.where(behind, 4.0, np.sum(r**2, 1)) / threshold_rad**2
        return local, r, squared, float(np.sum(np.log1p(squared)))

    local, r, squared, cost = evaluate(T)
    damping = 1e-4
    for _ in range(iterations):
        J = _jacobian(T, local, basis)
        weight = 1.0 / (1.0 + squared)
        JtW = (J * weight[:, None, None]).reshape(-1, 6).T
        H, g = JtW @ J.reshape(-1, 6), JtW @ r.ravel()
        d = np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-12), -g)
        T_new = se3.from_rotation_translation(T[:3, :3] @ so3.to_matrix(so3.exp(d[3:])), T[:3, 3] + d[:3])
        new = evaluate(T_new)
        if new[3] < cost:
            converged = cost - new[3] < tolerance * cost
            T, (local, r, squared, cost), damping = T_new, new, damping / 10
            if converged:
                break
        else:
            damping *= 10
            if damping > 1e8:
                break
    inlier = squared < 9.0
    rms = threshold_rad * np.sqrt(np.mean(squared[inlier])) if inlier.any() else np.inf
    return Pnp(T, inlier, float(rms))


def _jacobian(T: np.ndarray, local: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """(n, 2, 6) of B(ray)^T normalised(local) with local = R^T (p - t)."""
    distance = np.maximum(np.linalg.norm(local, axis=1), 1e-9)
    unit = local / distance[:, None]
    project = (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / distance[:, None, None]
    A = np.einsum("nij,nik->njk", basis, project)  # (n, 2, 3) d r / d local
    return np.concatenate([-A @ T[:3, :3].T, A @ so3.skew(local)], -1)


def _ransac(points_w: np.ndarray, rays_c: np.ndarray, threshold_rad: float) -> np.ndarray | None:
    forward = rays_c[:, 2] > 0.1
    if np.count_nonzero(forward) < MIN_POINTS:
        return None
    plane = rays_c[forward, :2] / rays_c[forward, 2:]
    found, rotation, translation, _ = cv2.solvePnPRansac(
        points_w[forward],
        plane,
        np.eye(3),
        None,
        useExtrinsicGuess=False,
        iterationsCount=200,
        reprojectionError=3.0 * threshold_rad,
        confidence=0.999,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found:
        return None
    R_c_w = cv2.Rodrigues(rotation)[0]
    return se3.inverse(se3.from_rotation_translation(R_c_w, translation[:, 0]))
