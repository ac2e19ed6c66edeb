"""Gyroscope bias from the rotations that vision has seen (REFERENCE N7, seeds 000.2.3 and 004.15)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..factors.preintegration import Preintegration, repropagate
from ..geometry import so3
from ..params import Init
from ..report import Gate, InitStage
from ..sensors import ImuNoise


def calibrate(
    params: Init, noise: ImuNoise, R_l_b: np.ndarray, imu: Sequence[Preintegration]
) -> tuple[np.ndarray, list[Preintegration], InitStage]:
    """The bias (3,) rad/s and the pre-integrations, integrated again with it and without accelerometer bias.

    R_l_b: (K, 3, 3) rotations of the body seen by vision; `imu[k]` integrates from frame k to k + 1.  What remains of
    the residuals is the first sign of a wrong extrinsic rotation or time offset, which no bias can explain.
    """
    before = _rms_deg(rotation_residuals(R_l_b, imu))
    b_g = imu[0].b_g + bias_change(R_l_b, imu)
    imu = [repropagate(p, np.zeros(3), b_g, noise) for p in imu]
    after = _rms_deg(rotation_residuals(R_l_b, imu))
    gate = Gate("rotation_error", after, "<=", params.max_rotation_error_deg, "init.max_rotation_error_deg", "deg")
    outcome = ""
    if not gate.passed:
        outcome = (
            f"gyroscope and images turn differently by {after:.1f} deg per frame whatever the bias: "
            "check the rotation between camera and IMU, and their time offset"
        )
    values = {"before_deg": before, **{f"b_g_{axis}": float(b) for axis, b in zip("xyz", b_g)}}
    return b_g, imu, InitStage("gyroscope bias", (gate,), outcome, values)


def rotation_residuals(R_l_b: np.ndarray, imu: Sequence[Preintegration]) -> np.ndarray:
    """(K - 1, 3) rad: Log(gamma^-1 R_k^T R_k+1), how much more vision turned than the gyroscope."""
    q = so3.from_matrix(R_l_b)
    gamma = np.array([p.delta_q for p in imu])
    return so3.log(so3.multiply(so3.inverse(gamma), so3.multiply(so3.inverse(q[:-1]), q[1:])))


def bias_change(R_l_b: np.ndarray, imu: Sequence[Preintegration]) -> np.ndarray:
    """The change of bias (3,) rad/s that minimises sum |J db - residual|^2, J the Jacobian of gamma by the bias."""
    J = np.concatenate([p.jacobian[3:6, 3:6] for p in imu])
    return np.linalg.lstsq(J, rotation_residuals(R_l_b, imu).ravel(), rcond=None)[0]


def _rms_deg(rotations: np.ndarray) -> float:
    return float(np.rad2deg(np.sqrt(np.mean(np.sum(rotations**2, 1)))))
