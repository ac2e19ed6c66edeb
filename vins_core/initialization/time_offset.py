"""The time offset from the rotations that vision has seen, before anything is known of positions.

Were the images taken delta later than believed, the body turned from one to the next by

    Exp(-w_k delta) gamma Exp(w_k+1 delta),      gamma the gyroscope's rotation over the believed interval,

which is linear in delta beside the bias of gyro_bias.py:  residual_k = J_k db + (w_k+1 - gamma' w_k) delta.  A wrong
offset of 20 ms otherwise costs seconds of failed attempts, because the refinement finds camera and IMU in disagreement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..factors.preintegration import Preintegration
from ..geometry import so3
from ..params import Online
from ..report import Gate, InitStage
from .gyro_bias import rotation_residuals

AGREES_S = 1e-3
"""An offset that changes by less needs no further attempt: the window finds the rest."""


def estimate(online: Online, td_s: float, R_l_b: np.ndarray, imu: Sequence[Preintegration]) -> tuple[float, InitStage]:
    """The time offset in s, from `td_s` on, at which the rays were taken; arguments else as of `gyro_bias.calibrate`.

    What the parameters say of the given offset counts as a measurement of it.
    """
    r = rotation_residuals(R_l_b, imu).ravel()
    J = np.concatenate([p.jacobian[3:6, 3:6] for p in imu])
    b_g = imu[0].b_g + np.linalg.lstsq(J, r, rcond=None)[0]
    A = np.column_stack([J, np.concatenate([_by_offset(p, b_g) for p in imu])])
    x = np.linalg.lstsq(A, r, rcond=None)[0]
    variance = float(np.sum((r - A @ x) ** 2) / max(len(r) - 4, 1))
    information = A.T @ A / variance
    information[3, 3] += 1.0 / online.td_sigma_s**2
    covariance = np.linalg.pinv(information, hermitian=True)
    change_s, sigma_s = float(covariance[3] @ (A.T @ r) / variance), float(np.sqrt(covariance[3, 3]))
    gate = Gate("offset_sigma", sigma_s, "<=", online.td_sigma_s, "online.td_sigma_s", "s", decides=False)
    values = {"td_s": td_s + change_s, "change_s": change_s, "sigma_s": sigma_s}
    return td_s + change_s, InitStage("time offset", (gate,), "", values)


def _by_offset(imu: Preintegration, b_g: np.ndarray) -> np.ndarray:
    """(3,) change of the rotation residual with the offset, rad/s."""
    first, last = imu.imu.gyro_rad_s[0] - b_g, imu.imu.gyro_rad_s[-1] - b_g
    return last - so3.to_matrix(imu.delta_q).T @ first
