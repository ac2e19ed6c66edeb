"""Mid-point IMU pre-integration (SPEC 3.1, seed 004.10, REFERENCE I1-I5).

Between samples k and k + 1, with bias-corrected acceleration a and angular rate w:

    w   = (w_k + w_k+1) / 2                      q_k+1 = q_k * (1, w dt / 2) normalised
    acc = (R_k a_k + R_k+1 a_k+1) / 2            p_k+1 = p_k + v_k dt + acc dt^2 / 2,    v_k+1 = v_k + acc dt

Only the rotation is a recursion, so everything else is computed for all samples at once.  The error state
e = (p, theta, v, b_a, b_g) follows e_k+1 = F_k e_k + V_k n_k with n = (acc_k, gyr_k, acc_k+1, gyr_k+1, b_a, b_g):
the covariance is P_k+1 = F_k P_k F_k' + V_k Q V_k', the bias Jacobian the last six columns of F_n-1 ... F_0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from ..geometry import so3
from ..sensors import ImuNoise, ImuSamples


@dataclass(frozen=True)
class Preintegration:
    """Relative motion from the first to the last sample, in the body frame of the first.

    Error state order of `jacobian` and `covariance`: p, theta, v, b_a, b_g.
    """

    imu: ImuSamples  # the raw samples; the first is at the earlier frame, the last at the later one
    b_a: np.ndarray  # (3,) bias it was integrated with
    b_g: np.ndarray  # (3,)
    dt_s: float
    delta_p: np.ndarray  # (3,)
    delta_q: np.ndarray  # (4,) wxyz
    delta_v: np.ndarray  # (3,)
    jacobian: np.ndarray  # (15, 6): columns b_a, b_g
    covariance: np.ndarray  # (15, 15)

    @cached_property
    def whitening(self) -> np.ndarray:
        """L^-1 (15, 15) with L L' the covariance: the square root of the information.

        A covariance without full rank (an interval of zero length) is floored at a standard deviation of 1e-8.
        """
        L, info = lapack.dpotrf(self.covariance, lower=1)
        if info:
            L = np.linalg.cholesky(self.covariance + 1e-16 * np.eye(15))
        return lapack.dtrtri(L, lower=1)[0]


def preintegrate(imu: ImuSamples, b_a: np.ndarray, b_g: np.ndarray, noise: ImuNoise) -> Preintegration:
    """Integrate `imu` with constant biases.  Fewer than two samples, or equal stamps, give no motion."""
    dt = np.diff(imu.t_ns) * 1e-9
    w = 0.5 * (imu.gyro_rad_s[:-1] + imu.gyro_rad_s[1:]) - b_g
    a = imu.accel_m_s2 - b_a
    q = rotations(w, dt)
    R = so3.to_matrix(q)
    Ra = (R @ a[:, :, None])[:, :, 0] if len(imu) else np.zeros((0, 3))
    dv = 0.5 * (Ra[:-1] + Ra[1:]) * dt[:, None]
    v = np.concatenate([np.zeros((1, 3)), np.cumsum(dv, 0)])
    delta_p = np.sum((v[:-1] + 0.5 * dv) * dt[:, None], 0)

    F, Q = _error_propagation(R, a, w, dt, noise)
    J, P = np.eye(15), np.zeros((15, 15))
    for F_k, Q_k in zip(F, Q):
        J = F_k @ J
        P = F_k @ P @ F_k.T + Q_k
    return Preintegration(
        imu,
        np.array(b_a, float),
        np.array(b_g, float),
        float(dt.sum()),
        delta_p,
        q[-1],
        v[-1],
        J[:, 9:],
        0.5 * (P + P.T),
    )


def repropagate(pre: Preintegration, b_a: np.ndarray, b_g: np.ndarray, noise: ImuNoise) -> Preintegration:
    """The same samples integrated again with other biases."""
    return preintegrate(pre.imu, b_a, b_g, noise)


def merge(first: Preintegration, second: Preintegration, noise: ImuNoise) -> Preintegration:
    """One interval from two consecutive ones, integrated again with the biases of the first (REFERENCE W5)."""
    shared = len(first.imu) > 0 and len(second.imu) > 0 and first.imu.t_ns[-1] == second.imu.t_ns[0]
    rest = second.imu[1:] if shared else second.imu
    return preintegrate(ImuSamples.concatenate([first.imu, rest]), first.b_a, first.b_g, noise)


def rotations(w: np.ndarray, dt: np.ndarray) -> np.ndarray:
    """q_0 = 1 and q_k+1 = q_k * (1, w_k dt_k / 2) normalised; plain floats, because it is a recursion."""
    qw, qx, qy, qz = 1.0, 0.0, 0.0, 0.0
    out = [(qw, qx, qy, qz)]
    for hx, hy, hz in (0.5 * w * dt[:, None]).tolist():
        s = 1.0 / math.sqrt((qw * qw + qx * qx + qy * qy + qz * qz) * (1.0 + hx * hx + hy * hy + hz * hz))
        qw, qx, qy, qz = (
            s * (qw - qx * hx - qy * hy - qz * hz),
            s * (qx + qw * hx + qy * hz - qz * hy),
            s * (qy + qw * hy + qz * hx - qx * hz),
            s * (qz + qw * hz + qx * hy - qy * hx),
        )
        out.append((qw, qx, qy, qz))
    return np.array(out)


def _error_propagation(
    R: np.ndarray, a: np.ndarray, w: np.ndarray, dt: np.ndarray, noise: ImuNoise
) -> tuple[np.ndarray, np.ndarray]:
    """F_k and V_k Q V_k' of every interval, (n - 1, 15, 15) each.  R and a are per sample, w and dt per interval."""
    n = len(dt)
    p, th, v, ba, bg = (slice(k, k + 3) for k in range(0, 15, 3))
    eye = np.eye(3)
    h = dt[:, None, None]
    R0, R1 = R[:n], R[1 : n + 1]
    turn = eye - so3.skew(w) * h  # theta_k+1 = turn theta_k - b_g dt
    RA = R @ so3.skew(a)
    A0, A1 = RA[:n], RA[1 : n + 1]
    acc_theta = -0.5 * (A0 + A1 @ turn)  # d acc / d theta_k
    acc_ba = -0.5 * (R0 + R1)
    acc_bg = 0.5 * A1 * h

    F = np.zeros((n, 15, 15))
    F[:, range(15), range(15)] = 1.0
    F[:, p, v] = h * eye
    F[:, th, th], F[:, th, bg] = turn, -h * eye
    F[:, v, th], F[:, v, ba], F[:, v, bg] = acc_theta * h, acc_ba * h, acc_bg * h
    F[:, p, th], F[:, p, ba], F[:, p, bg] = (0.5 * h * F[:, v, x] for x in (th, ba, bg))

    # noise enters acc at both ends, and theta_k+1 (hence acc) through the mean of both gyro noises
    sigma_a, sigma_g, walk_a, walk_g = _noise_per_interval(noise, dt)
    V = np.zeros((n, 15, 18))
    V[:, v, 0:3], V[:, v, 6:9] = 0.5 * h * R0 * sigma_a, 0.5 * h * R1 * sigma_a
    V[:, th, 3:6] = V[:, th, 9:12] = 0.5 * h * eye * sigma_g
    V[:, v, 3:6] = V[:, v, 9:12] = -0.25 * h * h * A1 * sigma_g
    V[:, p] = 0.5 * h * V[:, v]
    V[:, ba, 12:15], V[:, bg, 15:18] = eye * walk_a, eye * walk_g
    return F, V @ V.transpose(0, 2, 1)


def _noise_per_interval(noise: ImuNoise, dt: np.ndarray) -> tuple[np.ndarray, ...]:
    """Standard deviations (n, 1, 1) of one acc and gyro sample, and of the bias change over each interval.

    Discrete sigmas are used as they are, bias walks multiplied by dt (REFERENCE I2).  A density n means a variance
    n^2 dt of the integral over dt; the mean of two independent end samples must have variance n^2 / dt, hence each
    sample 2 n^2 / dt.  Bias walks grow with sqrt(dt).
    Over a gap in the samples the mean of acceleration and rate is uncertain by `gap_acc` and `gap_gyr` on top.
    """
    h = dt[:, None, None]
    if noise.kind == "discrete":
        one = np.ones_like(h)
        sigmas = noise.acc_n * one, noise.gyr_n * one, noise.acc_w * h, noise.gyr_w * h
    else:
        per_sample = np.sqrt(2.0 / np.maximum(h, 1e-12))
        sigmas = noise.acc_n * per_sample, noise.gyr_n * per_sample, noise.acc_w * np.sqrt(h), noise.gyr_w * np.sqrt(h)
    if not np.any(dt > noise.gap_s):
        return sigmas
    acc, gyr, *walks = sigmas
    in_gap = np.sqrt(2.0) * (h > noise.gap_s)
    return np.hypot(acc, noise.gap_acc * in_gap), np.hypot(gyr, noise.gap_gyr * in_gap), *walks
