"""How camera and gyroscope turned between the same two frames: what the hand-eye calibration is made of.

The rotation of the camera comes from the tracks alone, by whichever of two motions explains them with less doubt: a
rotation, or a rotation and a translation.  The first is the only one that a camera which merely turns can tell; the
second the only one that is not pulled aside by parallax.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..factors.preintegration import Preintegration
from ..geometry import so3
from ..geometry.two_view import estimate_relative_pose, rotation_covariance
from ..params import Init
from ..window.keyframe import FOCAL_460
from ..window.state import Observations

_GAUSS_MEDIAN = 1.1774
"""Median of the length of a plane vector whose components have standard deviation 1."""


@dataclass(frozen=True)
class RotationPairs:
    """n pairs of consecutive frames a, b.  Rotations are of b in a; covariances of d in Exp(d) R, rad^2, in a."""

    t_ns: np.ndarray  # (n,) int64 of frame b
    q_camera: np.ndarray  # (n, 4) wxyz
    camera_covariance: np.ndarray  # (n, 3, 3)
    q_body: np.ndarray  # (n, 4) by the gyroscope without bias
    body_covariance: np.ndarray  # (n, 3, 3) of its noise
    J_bias: np.ndarray  # (n, 3, 3): q_body * Exp(J_bias b_g)
    rates_rad_s: np.ndarray  # (n, 2, 3) of the gyroscope at a and at b
    dt_s: np.ndarray  # (n,)

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, rows: slice) -> RotationPairs:
        return RotationPairs(*(getattr(self, f.name)[rows] for f in fields(self)))

    def __add__(self, more: RotationPairs) -> RotationPairs:
        return RotationPairs(*(np.concatenate([getattr(p, f.name) for p in (self, more)]) for f in fields(self)))

    @staticmethod
    def empty() -> RotationPairs:
        q, C = np.zeros((0, 4)), np.zeros((0, 3, 3))
        return RotationPairs(np.zeros(0, np.int64), q, C, q, C, C, np.zeros((0, 2, 3)), np.zeros(0))


def measure(params: Init, a: Observations, b: Observations, imu: Preintegration, t_ns: int) -> RotationPairs:
    """The pair of two frames, `imu` integrated between them; none where they share too few tracks."""
    _, i, j = np.intersect1d(a.ids, b.ids, assume_unique=True, return_indices=True)
    if len(i) < params.min_matches or len(imu.imu) < 2:
        return RotationPairs.empty()
    R, covariance = camera_rotation(a.rays[i], b.rays[j], params.ransac_px / FOCAL_460)
    R_body = so3.to_matrix(imu.delta_q)
    J = imu.jacobian[3:6, 3:6]
    return RotationPairs(
        np.array([t_ns], np.int64),
        so3.from_matrix(R)[None],
        covariance[None],
        so3.multiply(imu.delta_q, so3.exp(-J @ imu.b_g))[None],
        (R_body @ imu.covariance[3:6, 3:6] @ R_body.T)[None],
        J[None],
        imu.imu.gyro_rad_s[[0, -1]][None],
        np.array([imu.dt_s]),
    )


def camera_rotation(rays_a: np.ndarray, rays_b: np.ndarray, threshold_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """R_a_b (3, 3) from corresponding unit rays (n, 3), and its covariance (3, 3) in a, rad^2.

    Rotation alone: Wahba's problem with Cauchy weights.  What it leaves unexplained may be parallax, which pulls all
    rays the same way and does not average out: the median of it is the standard deviation.
    """
    R, residual = _turn(rays_a, rays_b, threshold_rad)
    covariance = (np.median(residual) / _GAUSS_MEDIAN) ** 2 * np.eye(3)
    pose = estimate_relative_pose(rays_a, rays_b, threshold_rad)
    if pose is not None:
        of_pose = rotation_covariance(pose.T_a_b, rays_a, rays_b, threshold_rad)
        if np.trace(of_pose) < np.trace(covariance):
            return pose.T_a_b[:3, :3], of_pose
    return R, covariance


def _turn(rays_a: np.ndarray, rays_b: np.ndarray, scale_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """The rotation that minimises sum rho(|a - R b|), and |a - R b| (n,)."""
    weight = np.ones(len(rays_a))
    for _ in range(10):
        U, _, Vt = np.linalg.svd((weight[:, None] * rays_a).T @ rays_b)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        residual = np.linalg.norm(rays_a - rays_b @ R.T, axis=1)
        weight = 1.0 / (1.0 + (residual / scale_rad) ** 2)
    return R, residual
