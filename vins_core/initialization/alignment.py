"""Velocity, gravity and scale from visual poses and pre-integration (REFERENCE N8, N9; seeds 000.2.4, 004.16-17).

For consecutive frames i, j with camera positions p (up to scale s), body rotations R, lever arm p_bc = position of
the camera in the body, and pre-integrated alpha, beta, all in the frame of the reference camera:

    s (p_j - p_i) - v_i dt - g dt^2 / 2 = R_i alpha + (R_j - R_i) p_bc
    v_j - v_i - g dt                    = R_i beta

g points down.  Linear in v, g and s; the refinement keeps |g| and moves g on its tangent plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..factors.preintegration import Preintegration
from ..params import Init
from ..report import Gate, InitStage, all_pass

_SCALE_UNIT = 100.0
"""The scale is solved for in this unit, which keeps the system well conditioned (as VINS does)."""


@dataclass(frozen=True)
class Alignment:
    v: np.ndarray  # (K, 3) velocities in the reference frame, m/s
    gravity: np.ndarray  # (3,) m/s^2, down
    scale: float  # metres per unit of the structure
    scale_sigma: float  # relative, from the residuals of the linear system
    residual_m: float  # rms of the position rows


def align(
    params: Init,
    g_norm: float,
    p_l_c: np.ndarray,
    R_l_b: np.ndarray,
    imu: Sequence[Preintegration],
    p_b_c: np.ndarray,
    scale: float | None = None,
) -> tuple[Alignment, InitStage]:
    """N8: velocities, gravity (3) and scale, unless it is known, by least squares.

    p_l_c (K, 3), R_l_b (K, 3, 3); `imu[k]` integrates from frame k to k + 1.  That gravity, solved for freely, comes
    out near its known size is the first sign that structure and IMU fit together.
    """
    solved = _solve(p_l_c, R_l_b, imu, p_b_c, np.zeros(3), np.eye(3), scale)
    norm = float(np.linalg.norm(solved.gravity))
    gates = (
        Gate("gravity_error", abs(norm - g_norm), "<=", params.gravity_tolerance, "init.gravity_tolerance", "m/s^2"),
        Gate("scale", solved.scale, ">", 0.0),
    )
    outcome = ""
    if not gates[0].passed:
        outcome = (
            f"gravity comes out as {norm:.2f} m/s^2 instead of {g_norm:.2f}, structure and IMU do not fit together: "
            "check IMU units and axes, and the rotation between camera and IMU"
        )
    elif not gates[1].passed:
        outcome = "the scale comes out negative, structure and IMU do not fit together: change speed or direction more"
    values = {"gravity_norm": norm, "scale_sigma": solved.scale_sigma, "residual_m": solved.residual_m}
    return solved, InitStage("alignment", gates, outcome, values)


def refine_gravity(
    params: Init,
    g_norm: float,
    p_l_c: np.ndarray,
    R_l_b: np.ndarray,
    imu: Sequence[Preintegration],
    p_b_c: np.ndarray,
    linear: Alignment,
    scale: float | None = None,
) -> tuple[Alignment, InitStage]:
    """N9: the same system with g = |g| direction + B w, w (2,) in the tangent plane, from the new direction again."""
    g = g_norm * linear.gravity / np.linalg.norm(linear.gravity)
    solved = linear
    for _ in range(params.gravity_iterations):
        tangent = np.linalg.svd(g[None])[2][1:].T  # (3, 2)
        solved = _solve(p_l_c, R_l_b, imu, p_b_c, g, tangent, scale)
        g = g_norm * solved.gravity / np.linalg.norm(solved.gravity)
    solved = replace(solved, gravity=g)
    gates = (Gate("scale", solved.scale, ">", 0.0),)
    outcome = "" if all_pass(gates) else "the scale turns negative once gravity has its known size: move more"
    cosine = float(linear.gravity @ g / np.linalg.norm(linear.gravity) / g_norm)
    values = {
        "turned_deg": float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))),
        "scale_sigma": solved.scale_sigma,
        "residual_m": solved.residual_m,
    }
    return solved, InitStage("gravity", gates, outcome, values)


def _solve(
    p_l_c: np.ndarray,
    R_l_b: np.ndarray,
    imu: Sequence[Preintegration],
    p_b_c: np.ndarray,
    g_0: np.ndarray,
    tangent: np.ndarray,
    scale: float | None,
) -> Alignment:
    """Unknowns: v_0 ... v_K-1, w with g = g_0 + tangent w, s / 100 unless it is known."""
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
    if scale is not None:  # as if measured without any doubt
        b, A = b - A[:, :, -1] * (scale / _SCALE_UNIT), A[:, :, :-1]
    flat = A.reshape(-1, A.shape[2])
    H = flat.T @ flat
    x = np.linalg.solve(H + 1e-12 * np.eye(len(H)), flat.T @ b.ravel())
    residual = (A @ x - b).reshape(-1, 6)
    v, gravity = x[: 3 * K].reshape(K, 3), g_0 + tangent @ x[3 * K : 3 * K + m]
    residual_m = float(np.sqrt(np.mean(np.sum(residual[:, :3] ** 2, 1))))
    if scale is not None:
        return Alignment(v, gravity, scale, 0.0, residual_m)
    freedom = max(residual.size - len(x), 1)
    unit = np.zeros(len(x))
    unit[-1] = 1.0
    variance = float(np.linalg.solve(H + 1e-12 * np.eye(len(H)), unit)[-1]) * float(np.sum(residual**2)) / freedom
    return Alignment(
        v=v,
        gravity=gravity,
        scale=float(x[-1] / _SCALE_UNIT),
        scale_sigma=float(np.sqrt(variance) / abs(x[-1])) if x[-1] else np.inf,
        residual_m=residual_m,
    )
