"""How well a solved window knows its states: marginal covariances from the normal equations.

    [ H  W' ]^-1
    [ W  h  ]          position and yaw of the oldest pose held, so that everything is relative to them

With S = H - W' h^-1 W and w_k = W_k / h_k,  Cov(c) = S^-1,  Cov(c, l_k) = -S^-1 w_k,  Var(l_k) = 1/h_k + w_k' S^-1 w_k.
A landmark in the world is X = T_w_b T_b_c (f / lambda) of its anchor, a function of (dp, dtheta, lambda) with

    dX = dp - R [x_b]x dtheta - (X - o) dlambda / lambda,      x_b the point in the body, o the camera's centre

These are the estimator's own claims: a prior that leaks, or observations used twice, make them too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack, solve_triangular

from ..geometry import inverse_depth, se3, so3
from . import schur
from .linearize import Linearizer, NormalEquations, layout_of
from .problem import States, WindowProblem
from .trust_region import gauge_damping


@dataclass(frozen=True)
class Covariances:
    """Marginal covariances; tangents as in `States`."""

    poses: np.ndarray  # (n, 6, 6) of the frames, dp in m, dtheta in rad (body side)
    speed_biases: np.ndarray  # (n, 9, 9) v, b_a, b_g; NaN without IMU
    inv_depths: np.ndarray  # (M,) variances, 1/m^2; NaN without information
    points_w: np.ndarray  # (M, 3) landmarks in the world, m
    landmarks_w: np.ndarray  # (M, 3, 3) their covariances, m^2; NaN without information


def covariances(problem: WindowProblem, states: States) -> Covariances | None:
    """None when the normal equations are singular beyond position and yaw, as without IMU or prior."""
    linearizer = Linearizer(problem)
    layout, system = linearizer.layout, linearizer.linearize(states)
    factor = _factor_cameras(system, gauge_damping(states.poses[0], not problem.inertial))
    if factor is None:
        return None
    C = factor.inverse()
    of_poses = _diagonal_blocks(C, layout.columns("pose", np.arange(layout.n_frames)))
    of_speed_biases = np.full((layout.n_frames, 9, 9), np.nan)
    if layout.inertial:
        of_speed_biases = _diagonal_blocks(C, layout.columns("speed_bias", np.arange(layout.n_frames)))
    known = system.h > 0
    w = np.divide(system.W, system.h[:, None], out=np.full_like(system.W, np.nan), where=known[:, None])
    P = layout.visual
    coupled = -w @ C[:P, :P]  # (M, P) Cov(l, c)
    with np.errstate(divide="ignore"):
        variance = np.where(known, 1.0 / system.h - np.sum(coupled * w, 1), np.nan)
    return Covariances(of_poses, of_speed_biases, variance, *_in_world(problem, states, of_poses, coupled, variance))


def relative_poses(
    problem: WindowProblem, states: States, pairs: Sequence[tuple[int, int]], system: NormalEquations | None = None
) -> list[np.ndarray | None]:
    """Per pair (i, j) of slots the covariance (6, 6) of T_i_j = T_w_i^-1 T_w_j, tangent (p + dp, q * Exp(dtheta)).

        dp = R_w_i' (dp_j - dp_i) + p x dtheta_i,      dtheta = dtheta_j - R_i_j' dtheta_i

    None when the normal equations are singular beyond position and yaw.  `system`: those at `states`, where a solver
    has left them.
    """
    if not pairs:
        return []
    layout, factor = layout_of(problem), _factor_at(problem, states, system)
    if factor is None:
        return [None] * len(pairs)
    Ts_w_b = se3.from_quaternion_translation(states.poses[:, 3:], states.poses[:, :3])
    A = np.zeros((layout.size, len(pairs), 6))  # transposed derivatives of (dp, dtheta)
    for k, (i, j) in enumerate(pairs):
        R_w_i, T_i_j = Ts_w_b[i, :3, :3], se3.inverse(Ts_w_b[i]) @ Ts_w_b[j]
        at_i, at_j = layout.columns("pose", [i, j])
        A[at_i[:3], k, :3], A[at_i[3:], k, :3] = -R_w_i, -so3.skew(T_i_j[:3, 3])
        A[at_i[3:], k, 3:], A[at_j[3:], k, 3:] = -T_i_j[:3, :3], np.eye(3)
        A[at_j[:3], k, :3] = R_w_i
    half = factor.half(A.reshape(layout.size, -1)).reshape(A.shape)
    return [half[:, k].T @ half[:, k] for k in range(len(pairs))]


def calibration_sigmas(
    problem: WindowProblem, states: States, system: NormalEquations | None = None
) -> tuple[float, np.ndarray]:
    """Standard deviations of the time offset in s and of the extrinsics (cameras, 6) as in `States`; NaN where held.

    `system` as in `relative_poses`.
    """
    layout = layout_of(problem)
    td_s, extrinsics = np.nan, np.full((len(states.extrinsics), 6), np.nan)
    columns = [*layout.columns("extrinsic", np.arange(layout.n_extrinsics)).ravel(), *range(layout.visual)[-1:]]
    columns = columns if layout.n_td else columns[:-1]
    factor = _factor_at(problem, states, system) if columns else None
    if factor is None:
        return td_s, extrinsics
    sigmas = np.linalg.norm(factor.half(np.eye(layout.size)[:, columns]), axis=0)
    if layout.n_td:
        td_s = float(sigmas[-1])
    if layout.n_extrinsics:
        extrinsics = sigmas[: 6 * layout.n_extrinsics].reshape(-1, 6)
    return td_s, extrinsics


def ellipsoid(covariance: np.ndarray, sigmas: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Half axes (..., 3) in m, ascending, and their directions as columns of a rotation (..., 3, 3)."""
    values, axes = np.linalg.eigh(covariance)
    axes[..., :, 2] *= np.sign(np.linalg.det(axes))[..., None]
    return sigmas * np.sqrt(np.maximum(values, 0.0)), axes


@dataclass(frozen=True)
class _Factor:
    """S = diag(1/scale) L L' diag(1/scale): in units of each variable's own standard deviation."""

    L: np.ndarray
    scale: np.ndarray

    def inverse(self) -> np.ndarray:
        inverse, _ = lapack.dpotri(self.L, lower=1)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        return inverse * np.outer(self.scale, self.scale)

    def half(self, A: np.ndarray) -> np.ndarray:
        """B with B' B = A' S^-1 A."""
        return solve_triangular(self.L, A * self.scale[:, None], lower=True, check_finite=False)


def _factor_at(problem: WindowProblem, states: States, system: NormalEquations | None) -> _Factor | None:
    """Of the normal equations at `states`: those of `system`, unless a loss that bends H has left them indefinite."""
    gauge = gauge_damping(states.poses[0], not problem.inertial)
    factor = _factor_cameras(system, gauge) if system else None
    return factor or _factor_cameras(Linearizer(problem).linearize(states), gauge)


def _factor_cameras(system: NormalEquations, gauge: np.ndarray) -> _Factor | None:
    S, _ = schur.eliminate(system, system.h)
    S[:6, :6] += gauge
    diagonal = S.diagonal()
    if not (diagonal > 0).all():
        return None
    scale = 1.0 / np.sqrt(diagonal)
    L, info = lapack.dpotrf(S * np.outer(scale, scale), lower=1, clean=1)
    return None if info else _Factor(L, scale)


def _diagonal_blocks(C: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(n, k, k) of the columns (n, k)."""
    return C[at[:, :, None], at[:, None, :]]


def _in_world(
    problem: WindowProblem, states: States, of_poses: np.ndarray, coupled: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points (M, 3) and covariances (M, 3, 3) of the landmarks."""
    M, camera = problem.n_landmarks, problem.projections.camera  # the same for all tables
    anchor, ray = np.zeros(M, np.int64), np.full((M, 3), np.nan)
    for table in problem.tables:
        anchor[table.landmark], ray[table.landmark] = table.anchor, table.rays_i
    T_b_c = se3.from_quaternion_translation(states.extrinsics[camera, 3:], states.extrinsics[camera, :3])
    x_c = inverse_depth.point(ray, states.inv_depths)
    x_b = se3.transform(T_b_c, x_c)
    R = so3.to_matrix(states.poses[anchor, 3:])
    from_camera = np.einsum("kij,kj->ki", R, x_b - T_b_c[:3, 3])

    J = np.empty((M, 3, 7))  # of X with respect to (dp, dtheta, lambda)
    J[:, :, :3] = np.eye(3)
    J[:, :, 3:6] = -R @ so3.skew(x_b)
    J[:, :, 6] = -from_camera / states.inv_depths[:, None]
    joint = np.empty((M, 7, 7))
    joint[:, :6, :6] = of_poses[anchor]
    columns = 6 * anchor[:, None] + np.arange(6)
    joint[:, 6, :6] = joint[:, :6, 6] = np.take_along_axis(coupled, columns, 1)
    joint[:, 6, 6] = variance
    points = states.poses[anchor, :3] + np.einsum("kij,kj->ki", R, x_b)
    return points, J @ joint @ J.transpose(0, 2, 1)
