"""Bundle adjustment: poses and points from rays, points eliminated by the Schur complement.

`linearize` is the visual part of every structure problem of the initialisation: alone it refines the structure up to
scale (`adjust`), together with inertial terms it refines everything (refinement.py).  A body carries the camera at
`T_b_c`; with the identity the bodies are the cameras.

Tangent of a pose: (dp, dtheta) with p <- p + dp and R <- R Exp(dtheta).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from scipy.sparse import csr_array

from ..geometry import so3
from ..geometry.pnp import tangent_basis


@dataclass(frozen=True)
class Rays:
    """N observations of M points in K frames; each point at most once per frame."""

    frame: np.ndarray  # (N,) int
    point: np.ndarray  # (N,) int
    ray: np.ndarray  # (N, 3) unit, camera frame

    def __len__(self) -> int:
        return len(self.frame)

    @cached_property
    def basis(self) -> np.ndarray:
        """(N, 3, 2) bases of the tangent planes."""
        return tangent_basis(self.ray)

    def sum_by_frame(self, values: np.ndarray, n_frames: int) -> np.ndarray:
        """(N, ...) -> (n_frames, ...)."""
        return _sum(self.frame, values, n_frames)

    def sum_by_point(self, values: np.ndarray, n_points: int) -> np.ndarray:
        """(N, ...) -> (n_points, ...)."""
        return _sum(self.point, values, n_points)


def _sum(group: np.ndarray, values: np.ndarray, n_groups: int) -> np.ndarray:
    chosen = csr_array((np.ones(len(group)), (group, np.arange(len(group)))), (n_groups, len(group)))
    return (chosen @ values.reshape(len(group), -1)).reshape(n_groups, *values.shape[1:])


@dataclass(frozen=True)
class Structure:
    """Bodies and points in one frame of reference."""

    p: np.ndarray  # (K, 3)
    R: np.ndarray  # (K, 3, 3) body to reference
    points: np.ndarray  # (M, 3)


@dataclass(frozen=True)
class NormalEquations:
    """H d = -g of a robust least-squares problem with a dense part (n) and M points."""

    cost: float
    H: np.ndarray  # (n, n)
    g: np.ndarray  # (n,)
    W: np.ndarray  # (M, 3, n) points x dense
    V: np.ndarray  # (M, 3, 3)
    h: np.ndarray  # (M, 3)

    def reduce(self, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Schur complement: (S, s, V^-1) with S d = -s for the dense part."""
        size = np.trace(self.V, axis1=1, axis2=2)[:, None, None]
        V_inv = np.linalg.inv(self.V + (damping * self.V + 1e-9 * size + 1e-12) * np.eye(3))
        n = len(self.g)
        VW = (V_inv @ self.W).reshape(-1, n)
        W = self.W.reshape(-1, n)
        H = self.H + damping * np.diag(np.diag(self.H))
        return H - W.T @ VW, self.g - VW.T @ self.h.ravel(), V_inv

    def solve(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Steps of the dense part (n,) and of the points (M, 3)."""
        S, s, V_inv = self.reduce(damping)
        d = np.linalg.solve(S, -s)
        return d, -np.einsum("mij,mj->mi", V_inv, self.h + self.W @ d)


@dataclass(frozen=True)
class Adjustment:
    structure: Structure
    cost: float  # 1/2 sum |r|^2 in normalised coordinates, without loss (comparable with VINS' Ceres cost)
    rms_rad: float
    error_rad: np.ndarray  # (N,)
    iterations: int
    converged: bool


def reproject(structure: Structure, T_b_c: np.ndarray, rays: Rays) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points in their bodies (N, 3), in their cameras (N, 3), and residuals (N, 2) on the tangent plane of the ray.

    r = B(ray)^T x / |x| with x = R_bc^T (R^T (P - p) - p_bc).
    """
    R, offset = structure.R[rays.frame], structure.points[rays.point] - structure.p[rays.frame]
    in_body = np.einsum("nji,nj->ni", R, offset)
    in_camera = (in_body - T_b_c[:3, 3]) @ T_b_c[:3, :3]
    unit = in_camera / np.maximum(np.linalg.norm(in_camera, axis=1, keepdims=True), 1e-12)
    return in_body, in_camera, np.einsum("nij,ni->nj", rays.basis, unit)


def linearize(structure: Structure, T_b_c: np.ndarray, rays: Rays, sigma_rad: float, n_dense: int) -> NormalEquations:
    """Normal equations of the reprojection with Cauchy loss of scale 1 sigma x `ROBUST_SIGMAS`.

    Pose k occupies columns 6 k ... 6 k + 5 of the dense part, which may be wider than that (`n_dense`).
    """
    in_body, in_camera, r = reproject(structure, T_b_c, rays)
    distance = np.maximum(np.linalg.norm(in_camera, axis=1), 1e-12)
    unit = in_camera / distance[:, None]
    R_cb, R = T_b_c[:3, :3].T, structure.R[rays.frame]
    project = (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / distance[:, None, None]
    A = np.swapaxes(rays.basis, 1, 2) @ project @ R_cb / sigma_rad  # (N, 2, 3) d r / d in_body
    r = r / sigma_rad
    cost, weight = robust(r)
    J_point = A @ np.swapaxes(R, 1, 2)
    J_pose = np.concatenate([-J_point, A @ so3.skew(in_body)], -1)  # (N, 2, 6)
    WJ_pose, WJ_point = J_pose * weight[:, None, None], J_point * weight[:, None, None]

    n_frames, n_points = len(structure.p), len(structure.points)
    H = np.zeros((n_dense, n_dense))
    for k, block in enumerate(rays.sum_by_frame(np.swapaxes(WJ_pose, 1, 2) @ J_pose, n_frames)):
        H[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = block
    g = np.zeros(n_dense)
    g[: 6 * n_frames] = rays.sum_by_frame(np.einsum("nij,ni->nj", WJ_pose, r), n_frames).ravel()
    V = rays.sum_by_point(np.swapaxes(WJ_point, 1, 2) @ J_point, n_points)
    h = rays.sum_by_point(np.einsum("nij,ni->nj", WJ_point, r), n_points)
    W = np.zeros((n_points, 3, n_dense))
    cross = W[:, :, : 6 * n_frames].reshape(n_points, 3, n_frames, 6)
    cross[rays.point, :, rays.frame] = np.swapaxes(WJ_point, 1, 2) @ J_pose
    W[:, :, : 6 * n_frames] = cross.reshape(n_points, 3, -1)
    return NormalEquations(cost, H, g, W, V, h)


def robust(r: np.ndarray) -> tuple[float, np.ndarray]:
    """Cauchy loss of whitened residuals (N, 2): cost 1/2 sum log(1 + |r|^2) and weights rho'."""
    squared = np.sum(r * r, axis=1)
    return 0.5 * float(np.sum(np.log1p(squared))), 1.0 / (1.0 + squared)


def retract(structure: Structure, d: np.ndarray, d_points: np.ndarray) -> Structure:
    pose = d[: 6 * len(structure.p)].reshape(-1, 6)
    R = structure.R @ so3.to_matrix(so3.exp(pose[:, 3:]))
    return Structure(structure.p + pose[:, :3], R, structure.points + d_points)


State = TypeVar("State")


def minimize(
    state: State,
    equations: Callable[[State], NormalEquations],
    step: Callable[[State, np.ndarray, np.ndarray], State],
    free: np.ndarray,
    max_iterations: int,
    tolerance: float = 1e-6,
) -> tuple[State, NormalEquations, int, bool]:
    """Levenberg-Marquardt over the `free` (n,) part of the dense unknowns and all points.

    Returns the best state, its normal equations, the number of iterations, and whether the cost has settled.
    """
    current = _held(equations(state), free)
    damping = 1e-6
    for iteration in range(1, max_iterations + 1):
        d = np.zeros(len(free))
        d[free], d_points = current.solve(damping)
        trial_state = step(state, d, d_points)
        trial = _held(equations(trial_state), free)
        if trial.cost < current.cost:
            settled = current.cost - trial.cost < tolerance * current.cost
            state, current, damping = trial_state, trial, max(damping / 10, 1e-9)
            if settled:
                return state, current, iteration, True
        elif damping > 1e4:
            return state, current, iteration, True  # not even a tiny step helps: a minimum to machine precision
        else:
            damping *= 10
    return state, current, max_iterations, False


def _held(e: NormalEquations, free: np.ndarray) -> NormalEquations:
    return NormalEquations(e.cost, e.H[np.ix_(free, free)], e.g[free], e.W[:, :, free], e.V, e.h)


def adjust(
    structure: Structure, rays: Rays, fixed_frame: int, scale_frame: int, sigma_rad: float, max_iterations: int = 50
) -> Adjustment:
    """Visual bundle adjustment up to scale (REFERENCE N5).

    Gauge: `fixed_frame` is held, and of `scale_frame` the largest coordinate of its position relative to it.
    """
    n = 6 * len(structure.p)
    free = np.ones(n, bool)
    free[6 * fixed_frame : 6 * fixed_frame + 6] = False
    baseline = structure.p[scale_frame] - structure.p[fixed_frame]
    free[6 * scale_frame + int(np.argmax(np.abs(baseline)))] = False
    cameras = np.eye(4)
    structure, _, iterations, converged = minimize(
        structure, lambda s: linearize(s, cameras, rays, sigma_rad, n), retract, free, max_iterations
    )
    error = np.linalg.norm(reproject(structure, cameras, rays)[2], axis=1)
    return Adjustment(
        structure, 0.5 * float(error @ error), float(np.sqrt(np.mean(error**2))), error, iterations, converged
    )
