"""Gyroscope bias from the rotations that vision has seen (REFERENCE N7, seeds 000.2.3 and 004.15)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..factors.preintegration import Preintegration
from ..geometry import so3


def rotation_residuals(R_l_b: np.ndarray, imu: Sequence[Preintegration]) -> np.ndarray:
    """(K - 1, 3) rad: Log(gamma^-1 R_k^T R_k+1), how much more vision turned than the gyroscope."""
    q = so3.from_matrix(R_l_b)
    gamma = np.array([p.delta_q for p in imu])
    return so3.log(so3.multiply(so3.inverse(gamma), so3.multiply(so3.inverse(q[:-1]), q[1:])))


def estimate(R_l_b: np.ndarray, imu: Sequence[Preintegration]) -> np.ndarray:
    """Change of the gyroscope bias (3,) rad/s that minimises sum |J db - residual|^2.

    R_l_b: (K, 3, 3) rotations of the body seen by vision; `imu[k]` integrates from frame k to k + 1, and its
    Jacobian of the rotation by the bias is J.
    """
    J = np.concatenate([p.jacobian[3:6, 3:6] for p in imu])
    return np.linalg.lstsq(J, rotation_residuals(R_l_b, imu).ravel(), rcond=None)[0]
