"""Visual-inertial bundle adjustment of the window, and how well it knows its scale.

The linear alignment trusts the visual poses and knows no accelerometer bias; over the first second both cost several
percent of scale and most of a degree of gravity.  Here poses, velocities, points and biases are solved for together,

    sum |reprojection|^2_Cauchy + sum |imu|^2_P + |b_a|^2 / sigma_a^2,

with both biases constant over the window and the accelerometer's held near zero, because gravity and b_a can hardly
be told apart yet.  The curvature at the optimum says whether scale was observable: `scale_sigma` is the verdict that
keeps an ill-conditioned attempt (constant velocity, constant acceleration) from starting a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..factors import imu as imu_factor
from ..factors.preintegration import Preintegration
from ..geometry import so3
from ..params import Params
from ..report import Gate, InitStage
from ..window.keyframe import FOCAL_460
from ..window.state import BlockKey, Prior
from .bundle import NormalEquations, Rays, Structure, linearize, minimize, reproject, retract


@dataclass(frozen=True)
class Motion:
    """Unknowns of the window in a world with z up: bodies and points, velocities, constant biases."""

    structure: Structure
    v: np.ndarray  # (K, 3)
    b_a: np.ndarray  # (3,)
    b_g: np.ndarray  # (3,)

    def rotated(self, R: np.ndarray) -> Motion:
        s = self.structure
        return replace(self, structure=Structure(s.p @ R.T, R @ s.R, s.points @ R.T), v=self.v @ R.T)

    def anchored(self) -> Motion:
        """The same motion with the oldest body at the origin and its yaw 0."""
        s = self.structure
        shifted = replace(self, structure=Structure(s.p - s.p[0], s.R, s.points - s.p[0]))
        yaw = float(so3.heading(so3.from_matrix(s.R[0])))
        return shifted.rotated(so3.to_matrix(so3.exp(np.array([0.0, 0.0, -yaw]))))

    @property
    def extent_m(self) -> float:
        """Rms distance of the bodies from their mean."""
        p = self.structure.p
        return float(np.sqrt(np.mean(np.sum((p - p.mean(0)) ** 2, 1))))


@dataclass(frozen=True)
class Refinement:
    motion: Motion
    scale_sigma: float  # relative standard deviation of the scale
    gravity_sigma_deg: float  # of the direction of gravity in the oldest body
    imu_rms: float  # rms of the whitened IMU residuals: 1 when the noise model is right
    rms_rad: float  # of the reprojection
    iterations: int
    converged: bool


def refine(
    motion: Motion,
    T_b_c: np.ndarray,
    rays: Rays,
    imu: Sequence[Preintegration],
    gravity_m_s2: float,
    sigma_rad: float,
    acc_bias_sigma: float,
    max_iterations: int = 30,
) -> Refinement:
    """Minimises the cost above.  `imu[k]` integrates from frame k to k + 1 with biases near those of `motion`."""
    inertial = _Inertial(imu, gravity_m_s2, acc_bias_sigma)
    n = 9 * len(motion.v) + 6

    def equations(m: Motion) -> NormalEquations:
        return inertial.add(linearize(m.structure, T_b_c, rays, sigma_rad, n), m)

    motion, final, iterations, converged = minimize(motion, equations, _step, np.ones(n, bool), max_iterations)
    S, _, _ = final.reduce(0.0)
    covariance = np.linalg.inv(S)
    error = reproject(motion.structure, T_b_c, rays)[2]
    return Refinement(
        motion,
        _scale_sigma(motion.structure.p, covariance),
        _gravity_sigma_deg(motion.structure.R[0], covariance),
        inertial.rms(motion),
        float(np.sqrt(np.mean(np.sum(error**2, 1)))),
        iterations,
        converged,
    )


TRACKING_NOISE_PX = 0.25
"""Vision never fits much better than this, in px460; a smaller error says nothing about the IMU."""


def verdict(params: Params, refined: Refinement, before: Motion, visual_rms_rad: float) -> InitStage:
    """Do vision and IMU agree, and was the scale observable?

    visual_rms_rad: what the reprojection was before the IMU had a say.  A right calibration raises it by a few
    percent; wrong extrinsics or a wrong time offset, which the IMU residuals themselves hardly show because they weigh
    so much more, raise it severalfold.
    """
    init, health, m = params.init, params.health, refined.motion
    b_a, b_g = float(np.linalg.norm(m.b_a)), float(np.linalg.norm(m.b_g))
    error_px = FOCAL_460 * refined.rms_rad
    misfit = error_px / max(FOCAL_460 * visual_rms_rad, TRACKING_NOISE_PX)
    gates = (
        Gate("scale_sigma", refined.scale_sigma, "<=", init.max_scale_sigma, "init.max_scale_sigma"),
        Gate("imu_misfit", misfit, "<=", init.max_imu_misfit, "init.max_imu_misfit"),
        Gate("imu_error", refined.imu_rms, "<=", init.max_imu_error, "init.max_imu_error", "sigma"),
        Gate("reprojection", error_px, "<=", init.max_reprojection_px, "init.max_reprojection_px", "px460"),
        Gate("acc_bias", b_a, "<=", health.max_acc_bias, "health.max_acc_bias", "m/s^2"),
        Gate("gyr_bias", b_g, "<=", health.max_gyr_bias, "health.max_gyr_bias", "rad/s"),
    )
    why = {
        "scale_sigma": f"the scale is only known to {100 * refined.scale_sigma:.0f} %: change speed or direction more",
        "imu_misfit": f"the IMU makes the tracks fit {misfit:.1f} times worse: check extrinsics and time offset",
        "imu_error": "camera and IMU saw different motions: check extrinsics, time offset, IMU units and noise",
        "reprojection": "no motion the IMU allows fits the tracks: check extrinsics and time offset",
        "acc_bias": f"the accelerometer bias would have to be {b_a:.1f} m/s^2: check IMU units and gravity",
        "gyr_bias": f"the gyroscope bias would have to be {b_g:.2f} rad/s: check IMU units",
    }
    values = {
        "scale_change": m.extent_m / max(before.extent_m, 1e-9),
        "gravity_sigma_deg": refined.gravity_sigma_deg,
        "iterations": float(refined.iterations),
        **{f"b_a_{axis}": float(b) for axis, b in zip("xyz", m.b_a)},
        **{f"b_g_{axis}": float(b) for axis, b in zip("xyz", m.b_g)},
    }
    return InitStage("refinement", gates, next((why[g.name] for g in gates if not g.passed), ""), values)


def bias_prior(frame: int, motion: Motion, acc_bias_sigma: float) -> Prior:
    """|b_a|^2 / sigma^2 on the oldest frame: what the refinement assumed must stay with the window it initialised.

    Without it the first windows would explain noise by a bias that only later frames can tell from gravity
    (REFERENCE 23.15).
    """
    J = np.zeros((9, 9))
    J[3:6, 3:6] = np.eye(3) / acc_bias_sigma
    x0 = np.concatenate([motion.v[0], np.zeros(3), motion.b_g])
    return Prior((BlockKey("speed_bias", frame),), (x0,), J, np.zeros(9))


def _step(m: Motion, d: np.ndarray, d_points: np.ndarray) -> Motion:
    k = len(m.v)
    v = m.v + d[6 * k : 9 * k].reshape(k, 3)
    return Motion(retract(m.structure, d, d_points), v, m.b_a + d[-6:-3], m.b_g + d[-3:])


class _Inertial:
    """IMU factors between consecutive frames, the prior on b_a, and the gauge; one set of buffers for a solve."""

    GAUGE_INFORMATION = 1e8  # position and yaw of the oldest body are free: holding them stiffly costs nothing

    def __init__(self, imu: Sequence[Preintegration], gravity_m_s2: float, acc_bias_sigma: float):
        self._batch = imu_factor.IMU.batch(len(imu), imu_factor.ACTIVE, backend="vm")
        self._batch.data[:] = imu_factor.measurement(imu, gravity_m_s2)
        # the random walk of the biases is left out: rows p, q, v of the triangular whitening stand on their own
        self._whitening = np.stack([p.whitening[:9, :9] for p in imu])
        self._acc_bias_information = 1.0 / acc_bias_sigma**2

    def add(self, e: NormalEquations, m: Motion) -> NormalEquations:
        r, J = self._linearize(m)
        K = len(m.v)
        H, g = e.H, e.g
        for k in range(K - 1):
            # columns of the factor: pose_i, (v, b_a, b_g)_i, pose_j, (v, b_a, b_g)_j; both biases are the common ones
            columns = np.r_[6 * k : 6 * k + 12, 6 * K + 3 * k : 6 * K + 3 * k + 6, 9 * K : 9 * K + 6]
            J_k = np.hstack([J[k][:, 0:6], J[k][:, 15:21], J[k][:, 6:9], J[k][:, 21:24], J[k][:, 9:15]])
            H[np.ix_(columns, columns)] += J_k.T @ J_k
            g[columns] += J_k.T @ r[k]
        b_a = slice(9 * K, 9 * K + 3)
        H[b_a, b_a] += self._acc_bias_information * np.eye(3)
        g[b_a] += self._acc_bias_information * m.b_a
        up = m.structure.R[0][2]  # world z in the oldest body
        H[:3, :3] += self.GAUGE_INFORMATION * np.eye(3)
        H[3:6, 3:6] += self.GAUGE_INFORMATION * np.outer(up, up)
        prior = 0.5 * self._acc_bias_information * float(m.b_a @ m.b_a)
        return NormalEquations(e.cost + 0.5 * float(np.sum(r * r)) + prior, H, g, e.W, e.V, e.h)

    def rms(self, m: Motion) -> float:
        r, _ = self._linearize(m)
        return float(np.sqrt(np.mean(r * r)))

    def _linearize(self, m: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals (K - 1, 9) and Jacobians (K - 1, 9, 30)."""
        poses = np.hstack([m.structure.p, so3.from_matrix(m.structure.R)])
        biases = np.tile(np.concatenate([m.b_a, m.b_g]), (len(m.v), 1))
        speed_biases = np.hstack([m.v, biases])
        for k, values in enumerate((poses[:-1], speed_biases[:-1], poses[1:], speed_biases[1:])):
            self._batch.inputs[k].T[:] = values
        self._batch.evaluate()
        whitened = self._whitening @ self._batch.system[:, :9].transpose(2, 1, 0)
        return whitened[:, :, -1], whitened[:, :, :-1]


def _scale_sigma(p: np.ndarray, covariance: np.ndarray) -> float:
    """Relative deviation of s in p = mean + s (p_hat - mean), fitted by least squares to the positions.

    s is linear in the positions, ds = sum (p_k - mean) . dp_k / sum |p_k - mean|^2.
    """
    spread = p - p.mean(0)
    weights = np.zeros(len(covariance))
    weights[: 6 * len(p)] = np.concatenate([spread, np.zeros_like(spread)], axis=1).ravel()
    weights /= max(float(np.sum(spread**2)), 1e-12)
    return float(np.sqrt(max(weights @ covariance @ weights, 0.0)))


def _gravity_sigma_deg(R_w_b: np.ndarray, covariance: np.ndarray) -> float:
    """Root of the mean variance of roll and pitch of the oldest body."""
    tilt = R_w_b @ covariance[3:6, 3:6] @ R_w_b.T
    return float(np.rad2deg(np.sqrt(max(0.5 * (tilt[0, 0] + tilt[1, 1]), 0.0))))
