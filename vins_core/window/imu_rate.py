"""The newest state at the rate of the IMU, for those who cannot wait for the next image (SPEC 3.2).

A frame's estimate (p, q, v, b_a, b_g) is carried on from sample to sample, by the mid-point rule as in
factors/preintegration.py:

    q_k+1 = q_k * (1, w dt / 2) normalised,   w = (w_k + w_k+1) / 2 - b_g
    p_k+1 = p_k + v_k dt + a dt^2 / 2,        v_k+1 = v_k + a dt,   a = (R_k f_k + R_k+1 f_k+1) / 2 - R b_a - g

What loops say of the odometry's drift, T_g_w, may be applied to the states, or to the frame before it is carried on:
both give the same, since the integration only ever sees body coordinates and gravity (seed 000.4, last paragraphs).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..factors.preintegration import rotations
from ..geometry import so3
from ..report import PoseEstimate
from ..sensors import ImuSamples


@dataclass(frozen=True)
class States:
    """Of the body at IMU samples."""

    t_ns: np.ndarray  # (n,) int64, on the IMU's clock
    p_w_b: np.ndarray  # (n, 3) m
    q_w_b: np.ndarray  # (n, 4) wxyz
    v_w_b: np.ndarray  # (n, 3) m/s


def carry_on(newest: PoseEstimate, imu: ImuSamples, g_w: np.ndarray) -> States:
    """The states at all samples of `imu`, the first of which is at the frame of `newest`.

    g_w: (3,) m/s^2, the acceleration of free fall, (0, 0, -|g|) in a world with z up.
    """
    dt = np.diff(imu.t_ns)[:, None] * 1e-9
    w = 0.5 * (imu.gyro_rad_s[:-1] + imu.gyro_rad_s[1:]) - newest.b_g
    q = so3.normalize(so3.multiply(newest.q_w_b, rotations(w, dt[:, 0])))
    force = so3.rotate(q, imu.accel_m_s2 - newest.b_a)
    a = 0.5 * (force[:-1] + force[1:]) + g_w
    v = np.concatenate([newest.v_w_b[None], newest.v_w_b + np.cumsum(a * dt, 0)])
    p = np.cumsum(np.concatenate([newest.p_w_b[None], (v[:-1] + 0.5 * a * dt) * dt]), 0)
    return States(imu.t_ns, p, q, v)


def moved(states: States, T_g_w: np.ndarray) -> States:
    """The same states in another world, T_g_w (7,) of p and q wxyz."""
    p, q = T_g_w[:3], T_g_w[3:]
    return States(
        states.t_ns,
        p + so3.rotate(q, states.p_w_b),
        so3.normalize(so3.multiply(q, states.q_w_b)),
        so3.rotate(q, states.v_w_b),
    )


def moved_estimate(newest: PoseEstimate, T_g_w: np.ndarray) -> PoseEstimate:
    """One estimate in another world; its biases are the body's own."""
    p, q = T_g_w[:3], T_g_w[3:]
    return replace(
        newest,
        p_w_b=p + so3.rotate(q, newest.p_w_b),
        q_w_b=so3.normalize(so3.multiply(q, newest.q_w_b)),
        v_w_b=so3.rotate(q, newest.v_w_b),
    )
