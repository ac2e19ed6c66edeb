"""Velocity, gravity and scale from visual poses and pre-integration (REFERENCE N8, N9; seeds 000.2.4, 004.16-17).

For consecutive frames i, j with camera positions p (up to scale s), body rotations R, lever arm p_bc = position of
the camera in the body, and pre-integrated alpha, beta, all in the frame of the reference camera:

    s (p_j - p_i) - v_i dt - g dt^2 / 2 = R_i alpha + (R_j - R_i) p_bc
    v_j - v_i - g dt                    = R_i beta

g points down.  Linear in v, g and s; the refinement keeps |g| and moves g on its tangent plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..factors.preintegration import Preintegration

_SCALE_UNIT = 100.0
"""The scale is solved for in this unit, which keeps the system well conditioned (as VINS does)."""


@dataclass(frozen=True)
class Alignment:
    v: np.ndarray  # (K, 3) velocities in the reference frame, m/s
    gravity: np.ndarray  # (3,) m/s^2, down
    scale: float  # metres per unit of the structure
    scale_sigma: float  # relative, from the residuals of the linear system
    residual_m: float  # rms of the position rows


def align(p_l_c: np.ndarray, R_l_b: np.ndarray, imu: Sequence[Preintegration], p_b_c: np.ndarray) -> Alignment:
    """Least squares for velocities, gravity (3) and scale.  p_l_c (K, 3), R_l_b (K, 3, 3), `imu[k]` from k to k + 1."""
    return _solve(p_l_c, R_l_b, imu, p_b_c, np.zeros(3), np.eye(3))


def refine_gravity(
    p_l_c: np.ndarray,
    R_l_b: np.ndarray,
    imu: Sequence[Preintegration],
    p_b_c: np.ndarray,
    gravity: np.ndarray,
    norm: float,
    iterations: int,
) -> Alignment:
    """The same system with g = norm * direction + B w, w (2,) in the tangent plane, repeated with the new direction."""
    g = norm * gravity / np.linalg.norm(gravity)
    result = None
    for _ in range(iterations):
        tangent = np.linalg.svd(g[None])[2][1:].T  # (3, 2)
        result = _solve(p_l_c, R_l_b, imu, p_b_c, g, tangent)
        g = norm * result.gravity / np.linalg.norm(result.gravity)
    assert result is not None
    return Alignment(result.v, g, result.scale, result.scale_sigma, result.residual_m)


def _solve(
    p_l_c: np.ndarray,
    R_l_b: np.ndarray,
    imu: Sequence[Preintegration],
    p_b_c: np.ndarray,
    g_0: np.ndarray,
    tangent: np.ndarray,
) -> Alignment:
    """Unknowns: v_0 ... v_K-1, w with g = g_0 + tangent w, s / 100."""
    K, m = len(p_l_c), tangent.shape[1]
    A = np.zeros((K - 1, 6, 3 * K + m + 1))
    b = np.zeros((K - 1, 6))
    for k, pre in enumerate(imu):
        R_i, R_j, dt = R_l_b[k], R_l_b[k + 1], pre.dt_s
        A[k, :3, 3 * k : 3 * k + 3] = -dt * np.eye(3)
        A[k, 3:, 3 * k : 3 * k + 6] = np.hstack([-np.eye(3), np.eye(3)])
        A[k, :3, 3 * K : 3 * K + m] = -0.5 * dt * dt * tangent
        A[k, 3:, 3 * K : 3 * K + m] = -dt * tangent
        A[k, :3, -1] = (p_l_c[k + 1] - p_l_c[k]) / _SCALE_UNIT
        b[k, :3] = R_i @ pre.delta_p + (R_j - R_i) @ p_b_c + 0.5 * dt * dt * g_0
        b[k, 3:] = R_i @ pre.delta_v + dt * g_0
    flat = A.reshape(-1, A.shape[2])
    H = flat.T @ flat
    x = np.linalg.solve(H + 1e-12 * np.eye(len(H)), flat.T @ b.ravel())
    residual = (A @ x - b).reshape(-1, 6)
    freedom = max(residual.size - len(x), 1)
    unit = np.zeros(len(x))
    unit[-1] = 1.0
    variance = float(np.linalg.solve(H + 1e-12 * np.eye(len(H)), unit)[-1]) * float(np.sum(residual**2)) / freedom
    return Alignment(
        v=x[: 3 * K].reshape(K, 3),
        gravity=g_0 + tangent @ x[3 * K : 3 * K + m],
        scale=float(x[-1] / _SCALE_UNIT),
        scale_sigma=float(np.sqrt(variance) / abs(x[-1])) if x[-1] else np.inf,
        residual_m=float(np.sqrt(np.mean(np.sum(residual[:, :3] ** 2, 1)))),
    )
