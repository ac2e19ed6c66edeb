"""The IMU residual between two frames (seed 000.3.3.2, REFERENCE I3, I4).

    r_p  = R_i' (p_j - p_i - v_i dt + g dt^2 / 2) - dp(b)
    r_q  = 2 vec( dq(b)^-1 q_i^-1 q_j )
    r_v  = R_i' (v_j - v_i + g dt) - dv(b)
    r_ba = b_a_j - b_a_i,     r_bg = b_g_j - b_g_i

with g = (0, 0, |g|), and dp, dq, dv the pre-integrated motion corrected to first order for the bias of frame i.
The whitened residual is L^-1 r with L L' the covariance: L is lower triangular, so the position part is divided by
its own standard deviation and each later part by what the earlier ones leave open.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from .factor import Factor, pose, vector
from .preintegration import Preintegration
from .symbolic import conjugate, multiply, small_rotation

_SPLIT = np.cumsum([0, 1, 3, 4, 3, 3, 3, 54, 1]).tolist()


def _residual(values: list, data: ca.SX) -> ca.SX:
    pose_i, sb_i, pose_j, sb_j = values
    dt, dp, dq, dv, b_a0, b_g0, jacobian, gravity = ca.vertsplit(data, _SPLIT)
    (dp_dba, dp_dbg), (_, dq_dbg), (dv_dba, dv_dbg) = ca.blocksplit(ca.reshape(jacobian, 6, 9).T, 3, 3)
    v_i, b_a_i, b_g_i = ca.vertsplit(sb_i, [0, 3, 6, 9])
    v_j, b_a_j, b_g_j = ca.vertsplit(sb_j, [0, 3, 6, 9])
    dba, dbg = b_a_i - b_a0, b_g_i - b_g0
    g = ca.vertcat(0, 0, gravity)
    dp = dp + dp_dba @ dba + dp_dbg @ dbg
    dq = multiply(dq, small_rotation(dq_dbg @ dbg))
    dv = dv + dv_dba @ dba + dv_dbg @ dbg
    return ca.vertcat(
        pose_i.inverse_rotate(pose_j.p - pose_i.p - v_i * dt + 0.5 * g * dt * dt) - dp,
        2 * multiply(conjugate(dq), multiply(conjugate(pose_i.q), pose_j.q))[1:],
        pose_i.inverse_rotate(v_j - v_i + g * dt) - dv,
        b_a_j - b_a_i,
        b_g_j - b_g_i,
    )


IMU = Factor(
    "imu",
    (pose("pose_i"), vector("speed_bias_i", 9), pose("pose_j"), vector("speed_bias_j", 9)),
    _SPLIT[-1],
    _residual,
)
"""Speed-bias blocks are (v, b_a, b_g).  The residual is not whitened; see `Preintegration.whitening`."""

ACTIVE = tuple(b.name for b in IMU.blocks)


def measurement(preintegrations: Sequence[Preintegration], gravity_m_s2: float) -> np.ndarray:
    """The data of the factor, one column per interval, (n_data, k)."""
    rows = np.empty((len(preintegrations), IMU.n_data))
    for row, m in zip(rows, preintegrations):
        row[0] = m.dt_s
        row[1:4], row[4:8], row[8:11] = m.delta_p, m.delta_q, m.delta_v
        row[11:14], row[14:17] = m.b_a, m.b_g
        row[17:71] = m.jacobian[:9].reshape(-1)
    rows[:, 71] = gravity_m_s2
    return rows.T
