"""Two views of the same points: how far apart are the rays, and which relative pose explains them.

Everything works on unit rays, so that the same functions serve every camera model.  The epipolar error is an angle;
a threshold in px460 divided by 460 is that angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from . import se3, so3

_FORWARD_Z = 0.1
"""Rays flatter than this (84 degrees off the axis) are left out of the minimal solver, not out of the refinement."""
_MEDIAN_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over the median of its absolute values."""


@dataclass(frozen=True)
class RelativePose:
    """View b in the frame of view a; the translation has unit length."""

    T_a_b: np.ndarray  # (4, 4)
    inlier: np.ndarray  # (n,) bool, within the threshold of the epipolar plane
    in_front: np.ndarray  # (n,) bool, inliers with positive depth in both views


def estimate_relative_pose(
    rays_a: np.ndarray, rays_b: np.ndarray, threshold_rad: float, confidence: float = 0.999
) -> RelativePose | None:
    """Relative pose of two views from corresponding unit rays (n, 3), n >= 8; None when nothing fits.

    Five-point RANSAC (Nister 2004) on the rays that reach the image plane, the choice among the four decompositions
    of E by positive depth, then a Gauss-Newton refinement of the angular Sampson error over all inlying rays.
    Deterministic: OpenCV seeds the sampling with a constant.  REFERENCE N3.
    """
    forward = (rays_a[:, 2] > _FORWARD_Z) & (rays_b[:, 2] > _FORWARD_Z)
    if np.count_nonzero(forward) < 8:
        return None
    plane_a, plane_b = (r[forward, :2] / r[forward, 2:] for r in (rays_a, rays_b))
    E, _ = cv2.findEssentialMat(
        plane_b, plane_a, np.eye(3), method=cv2.USAC_ACCURATE, prob=confidence, threshold=threshold_rad, maxIters=1000
    )
    if E is None or E.shape != (3, 3):
        return None
    R_1, R_2, t = cv2.decomposeEssentialMat(E)
    candidates = [se3.from_rotation_translation(R, s * t[:, 0]) for R in (R_1, R_2) for s in (1.0, -1.0)]
    inlier = epipolar_angle(candidates[0], rays_a, rays_b) < threshold_rad
    T = max(candidates, key=lambda T: np.count_nonzero(_in_front(T, rays_a, rays_b) & inlier))
    T = _refine(T, rays_a, rays_b, threshold_rad)
    inlier = epipolar_angle(T, rays_a, rays_b) < threshold_rad
    return RelativePose(T, inlier, inlier & _in_front(T, rays_a, rays_b))


def epipolar_angle(T_a_b: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray) -> np.ndarray:
    """(n,) radians by which ray pairs miss a common epipolar plane (first-order, Sampson on the sphere).

    e = a . (t x R b) over the norm of its gradient when a and b move on the sphere.
    """
    e, norm, _, _ = _sampson(T_a_b, rays_a, rays_b)
    return np.abs(e) / norm


def rotation_covariance(T_a_b: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray, threshold_rad: float) -> np.ndarray:
    """(3, 3) covariance in rad^2 of d in R_a_b <- Exp(d) R_a_b, whatever the direction of translation is.

    With the weights of the refinement over all n >= 8 rays, whose noise is told by the median of their epipolar angles;
    infinite where they do not determine it.
    """
    e, norm, J_rotation, J_translation = _linearized(T_a_b, rays_a, rays_b)
    angle = e / norm
    sigma = _MEDIAN_TO_SIGMA * np.median(np.abs(angle))
    variance = sigma**2 * len(angle) / (len(angle) - 5)
    J = np.concatenate([J_rotation, J_translation], 1) / norm[:, None]
    weight = 1.0 / (1.0 + (angle / threshold_rad) ** 2)
    try:
        return variance * np.linalg.inv((J * weight[:, None]).T @ J)[:3, :3]
    except np.linalg.LinAlgError:
        return np.full((3, 3), np.inf)


def depths_along_rays(T_a_b: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray) -> np.ndarray:
    """(n, 2) distances along both rays to the points where they come closest; infinite for parallel rays.

    Solves depth_a a = depth_b R b + t in the least-squares sense.
    """
    b, t = rays_b @ T_a_b[:3, :3].T, T_a_b[:3, 3]
    ab, at, bt = np.sum(rays_a * b, 1), rays_a @ t, b @ t
    sine2 = 1.0 - ab * ab
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([(at - ab * bt) / sine2, (ab * at - bt) / sine2], 1)


def _in_front(T_a_b: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray) -> np.ndarray:
    return np.all(depths_along_rays(T_a_b, rays_a, rays_b) > 0.0, axis=1)


def _sampson(
    T_a_b: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Algebraic error, its gradient norm on the sphere, b in frame a, and t x b."""
    t, b = T_a_b[:3, 3], rays_b @ T_a_b[:3, :3].T
    normal_b, normal_a = np.cross(t, b), np.cross(rays_a, t)  # planes spanned by t and the *other* ray
    e = np.sum(rays_a * normal_b, 1)
    slope_a, slope_b = np.cross(rays_a, normal_b), np.cross(b, normal_a)
    norm = np.sqrt(np.sum(slope_a**2, 1) + np.sum(slope_b**2, 1))
    return e, np.maximum(norm, 1e-12), b, normal_b


def _linearized(
    T: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Algebraic error e, its gradient norm on the sphere, and de by rotation (n, 3) and by direction (n, 2).

    R <- Exp(d) R:  d(a . t x (d x b)) / dd;  t <- t + tangent d.
    """
    e, norm, b, _ = _sampson(T, rays_a, rays_b)
    t = T[:3, 3]
    return e, norm, -np.cross(np.cross(rays_a, t), b), np.cross(b, rays_a) @ _tangent(t)


def _tangent(t: np.ndarray) -> np.ndarray:
    """(3, 2), orthogonal to t."""
    return np.linalg.svd(t[None])[2][1:].T


def _refine(T: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray, threshold_rad: float) -> np.ndarray:
    """Gauss-Newton on rotation (3) and direction of translation (2) with Cauchy weights."""

    def robust_cost(T: np.ndarray) -> float:
        return float(np.sum(np.log1p((epipolar_angle(T, rays_a, rays_b) / threshold_rad) ** 2)))

    cost = robust_cost(T)
    for _ in range(10):
        e, norm, J_rotation, J_translation = _linearized(T, rays_a, rays_b)
        weight = 1.0 / (norm * np.sqrt(1.0 + (e / norm / threshold_rad) ** 2))
        J = np.concatenate([J_rotation, J_translation], 1) * weight[:, None]
        d = np.linalg.lstsq(J, -e * weight, rcond=None)[0]
        t_new = T[:3, 3] + _tangent(T[:3, 3]) @ d[3:]
        R_new = so3.to_matrix(so3.exp(d[:3])) @ T[:3, :3]
        T_new = se3.from_rotation_translation(R_new, t_new / np.linalg.norm(t_new))
        new_cost = robust_cost(T_new)
        if not new_cost < cost:
            break
        converged = cost - new_cost < 1e-6 * cost
        T, cost = T_new, new_cost
        if converged:
            break
    return T
