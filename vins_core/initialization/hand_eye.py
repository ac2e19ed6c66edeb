"""The rotation between camera and IMU from how both turn (REFERENCE N14, seeds 000.2 and 004.13).

For every pair of consecutive frames, with C the rotation of the camera, G that of the gyroscope and X = R_b_c,

    Exp(-w_a td) G Exp(J b_g) Exp(w_b td)  =  X C X^T,

w_a and w_b being the gyroscope's rates at both frames.  VINS solves G X = X C as it is; a bias of 0.08 rad/s (EuRoC) or
images stamped 30 ms early then pass for ten degrees of rotation.  So bias and time offset are solved for as well, and
whether the device has turned enough to tell the three apart is what the gates ask.

Start: mean rates are a rigid motion apart, w_G = X w_C + b, which Kabsch's method solves in closed form, robustly by
reweighting.  Then Gauss-Newton on (X, b_g, td) with the covariance of every pair and Cauchy weights.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..geometry import se3, so3
from ..params import Init
from ..report import Gate, HandEyeReport, InitStage, all_pass
from ..window.state import WindowFrame
from .rotation_pairs import RotationPairs, measure

MAX_PAIRS = 200
"""The newest so many pairs are looked at, so that a long wait costs no more than a short one."""
ITERATIONS = 20
OUTLIER_SIGMA = 3.0


@dataclass(frozen=True)
class HandEye:
    """What a run carries while it does not know how its camera is turned."""

    pairs: RotationPairs = field(default_factory=RotationPairs.empty)
    R_b_c: np.ndarray | None = None  # (3, 3) once every gate has passed


@dataclass(frozen=True)
class Solution:
    """Tangent of the covariance: d in R_b_c Exp(d), b_g, td."""

    R_b_c: np.ndarray  # (3, 3)
    b_g: np.ndarray  # (3,) rad/s
    td_s: float  # beyond what the calibration says
    covariance: np.ndarray  # (7, 7), enlarged where the pairs disagree by more than their own
    misfit: float  # rms residual in standard deviations
    agreement: float  # share of the pairs within OUTLIER_SIGMA

    @property
    def sigma_deg(self) -> np.ndarray:
        """(3,) about the axes of the camera."""
        return np.rad2deg(np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def worst_sigma_deg(self) -> float:
        """About whatever axis is known least."""
        return float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1])))


def calibrate(params: Init, state: HandEye, a: WindowFrame, b: WindowFrame) -> tuple[HandEye, HandEyeReport]:
    """One attempt, with the pair of the two newest frames added: R_b_c if every gate passes, and why it does not.

    Once found, R_b_c is the newest that passed.
    """
    assert b.imu is not None
    pairs = (state.pairs + measure(params, a.observations, b.observations, b.imu, b.t_ns))[-MAX_PAIRS:]
    solution = solve(params, pairs)
    singular = singular_values(pairs, solution)
    gates = _gates(params, pairs, solution, singular)
    if solution is None:
        return HandEye(pairs, state.R_b_c), HandEyeReport(
            len(pairs), None, None, singular, None, None, gates, False, state.R_b_c is not None
        )
    accepted = all_pass(gates)
    state = HandEye(pairs, solution.R_b_c if accepted else state.R_b_c)
    return state, HandEyeReport(
        n_pairs=len(pairs),
        q_b_c=so3.from_matrix(solution.R_b_c),
        sigma_deg=solution.sigma_deg,
        singular_values=singular,
        b_g=solution.b_g,
        td_s=solution.td_s,
        gates=gates,
        accepted=accepted,
        found=state.R_b_c is not None,
    )


def mount(T_b_c: np.ndarray, R_b_c: np.ndarray | None) -> np.ndarray:
    """(cameras, 4, 4): all cameras turned together until the first has the rotation that was found, if one was.

    The first keeps its translation, VINS' zero where none was given; the others keep their place beside it.
    """
    if R_b_c is None:
        return T_b_c
    first = se3.from_rotation_translation(R_b_c, T_b_c[0, :3, 3])
    return np.concatenate([first[None], first @ se3.inverse(T_b_c[0]) @ T_b_c[1:]])


def stage(report: HandEyeReport) -> InitStage:
    """What the attempt to initialise says about it."""
    values = {}
    if report.q_b_c is not None and report.sigma_deg is not None and report.b_g is not None:
        found = {
            "rotation_deg_{}": np.rad2deg(so3.log(report.q_b_c)),
            "sigma_deg_{}": report.sigma_deg,
            "b_g_{}": report.b_g,
        }
        values = {name.format(axis): float(v) for name, row in found.items() for axis, v in zip("xyz", row)}
        values["td_ms"] = 1e3 * (report.td_s or 0.0)
    return InitStage("extrinsic rotation", report.gates, _outcome(report), values)


def solve(params: Init, pairs: RotationPairs) -> Solution | None:
    """The most likely rotation, bias and time offset; None with fewer than four pairs, or where they say nothing."""
    if len(pairs) < 4:
        return None
    X, b_g = _align_rates(pairs)
    x = np.array([*b_g, 0.0])
    noise = np.deg2rad(params.hand_eye_pair_sigma_deg) ** 2 * np.eye(3) + pairs.body_covariance
    information = np.linalg.inv(noise + X @ pairs.camera_covariance @ X.T)
    prior = np.zeros(7)
    prior[6] = 1.0 / max(params.hand_eye_td_sigma_s, 1e-9) ** 2
    for _ in range(ITERATIONS):
        r, J = _residuals(pairs, X, x[:3], x[3])
        d2 = np.einsum("ni,nij,nj->n", r, information, r)
        weight = 1.0 / (1.0 + d2 / OUTLIER_SIGMA**2)
        WJ = weight[:, None, None] * (information @ J)
        H = np.einsum("nij,nik->jk", J, WJ) + np.diag(prior)
        gradient = np.einsum("nij,ni->j", WJ, r) + prior * np.array([*np.zeros(6), x[3]])
        H[:3, :3] += 1e-9 * np.eye(3)  # no rotation at all: the step stays finite, and sigma tells
        step = -np.linalg.solve(H, gradient)
        step[:3] *= min(1.0, 0.5 / max(float(np.linalg.norm(step[:3])), 1e-12))
        X, x = X @ so3.to_matrix(so3.exp(step[:3])), x + step[3:]
        if np.abs(step).max() < 1e-8:
            break
    misfit = float(np.sqrt(np.sum(weight * d2) / max(3.0 * np.sum(weight) - 6.0, 1.0)))
    covariance = np.linalg.inv(H) * max(misfit, 1.0) ** 2
    return Solution(X, x[:3], float(x[3]), covariance, misfit, float(np.mean(d2 < OUTLIER_SIGMA**2 * 3.0)))


def singular_values(pairs: RotationPairs, solution: Solution | None) -> np.ndarray:
    """(4,) of VINS' stacked system (L(q_G) - R(q_C)) q = 0, descending, without the bias.

    The last is what the best rotation leaves; the second smallest says how clearly it is the best: zero while all
    turning is about one axis.  Grows with the root of the number of pairs.
    """
    b_g = np.zeros(3) if solution is None else solution.b_g
    q_body = so3.multiply(pairs.q_body, so3.exp(pairs.J_bias @ b_g))
    stacked = so3.left_matrix(q_body) - so3.right_matrix(pairs.q_camera)
    return np.linalg.svd(stacked.reshape(-1, 4), compute_uv=False) if len(pairs) else np.zeros(4)


def _align_rates(pairs: RotationPairs) -> tuple[np.ndarray, np.ndarray]:
    """Kabsch: X and b that minimise sum rho(|w_G - X w_C - b| dt)."""
    dt = pairs.dt_s[:, None]
    body, camera = so3.log(pairs.q_body) / dt, so3.log(pairs.q_camera) / dt
    weight = np.ones(len(pairs))
    for _ in range(10):
        share = weight / weight.sum()
        mean_body, mean_camera = share @ body, share @ camera
        U, _, Vt = np.linalg.svd((body - mean_body).T @ (weight[:, None] * (camera - mean_camera)))
        X = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        b = mean_body - X @ mean_camera
        error = np.linalg.norm(body - camera @ X.T - b, axis=1) * pairs.dt_s
        weight = 1.0 / (1.0 + (error / (1.5 * np.median(error) + 1e-4)) ** 2)
    return X, b


def _residuals(pairs: RotationPairs, X: np.ndarray, b_g: np.ndarray, td_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Log(G' (X C X^T)^T) (n, 3) in the body at a, and its Jacobian (n, 3, 7) by d in X Exp(d), b_g and td."""
    rate_a, rate_b = pairs.rates_rad_s[:, 0] - b_g, pairs.rates_rad_s[:, 1] - b_g
    q = so3.multiply(pairs.q_body, so3.exp(pairs.J_bias @ b_g))
    q = so3.multiply(so3.multiply(so3.exp(-td_s * rate_a), q), so3.exp(td_s * rate_b))
    q_X = so3.from_matrix(X)
    q_seen = so3.multiply(so3.multiply(q_X, pairs.q_camera), so3.inverse(q_X))
    r = so3.log(so3.multiply(q, so3.inverse(q_seen)))
    G = so3.to_matrix(q)
    by_td = (G @ rate_b[:, :, None])[:, :, 0] - rate_a
    return r, np.concatenate([(G - np.eye(3)) @ X, G @ pairs.J_bias, by_td[:, :, None]], 2)


def _gates(params: Init, pairs: RotationPairs, solution: Solution | None, singular: np.ndarray) -> tuple[Gate, ...]:
    sigma = second = misfit = agreement = smallest = halves = td = None
    if solution is not None:
        sigma, misfit, agreement = solution.worst_sigma_deg, solution.misfit, solution.agreement
        second, smallest, td = second_axis_deg_s(pairs), float(singular[2]), abs(solution.td_s) * 1e3
        halves = _halves_deg(params, pairs)
    return (
        Gate("pairs", len(pairs), ">=", params.hand_eye_min_pairs, "init.hand_eye_min_pairs"),
        Gate("second_axis", second, ">=", params.hand_eye_min_turn_deg_s, "init.hand_eye_min_turn_deg_s", "deg/s"),
        Gate("singular_value", smallest, ">", params.hand_eye_min_singular, "init.hand_eye_min_singular"),
        Gate("rotation_sigma", sigma, "<=", params.hand_eye_max_sigma_deg, "init.hand_eye_max_sigma_deg", "deg"),
        Gate("rotation_misfit", misfit, "<=", params.hand_eye_max_misfit, "init.hand_eye_max_misfit", "sigma"),
        Gate("rotation_agreement", agreement, ">=", params.hand_eye_min_agreement, "init.hand_eye_min_agreement"),
        Gate("rotation_halves", halves, "<=", params.hand_eye_max_halves_deg, "init.hand_eye_max_halves_deg", "deg"),
        Gate("time_offset", td, "<=", params.hand_eye_max_td_ms, "init.hand_eye_max_td_ms", "ms", decides=False),
    )


def second_axis_deg_s(pairs: RotationPairs) -> float:
    """rms rate of turning about the second strongest axis, beside what never changes: that may be bias."""
    rates = so3.log(pairs.q_camera) / pairs.dt_s[:, None]
    spread = np.linalg.svd(rates - rates.mean(0), compute_uv=False)
    return float(np.rad2deg(spread[1] / np.sqrt(len(pairs))))


def _halves_deg(params: Init, pairs: RotationPairs) -> float | None:
    """Angle between what the earlier and the later half of the pairs say."""
    middle = len(pairs) // 2
    first, second = (solve(params, pairs[rows]) for rows in (slice(0, middle), slice(middle, None)))
    if first is None or second is None:
        return None
    return float(np.rad2deg(np.linalg.norm(so3.log(so3.from_matrix(first.R_b_c.T @ second.R_b_c)))))


def _outcome(report: HandEyeReport) -> str:
    """Nothing once a rotation has been found, even if this attempt does not pass."""
    if report.found:
        return ""
    value = {g.name: g.value for g in report.gates}
    failed = {g.name for g in report.gates if g.decides and not g.passed}
    second, sigma = value["second_axis"], value["rotation_sigma"]
    if not failed & {"pairs", "second_axis"}:
        if "rotation_misfit" in failed:
            return "no rotation between camera and IMU explains how both turn: check the axes and stamps of the IMU"
        if "rotation_agreement" in failed:
            return "many frames disagree on the rotation between camera and IMU: avoid what moves in the image"
        if failed == {"rotation_halves"}:
            return "earlier and later frames disagree on the rotation between camera and IMU: keep rotating the device"
    if failed == {"singular_value"}:
        return (
            f"turning about two axes amounts to a singular value of only {value['singular_value']:.2f}: keep rotating "
            "the device about two axes"
        )
    if second is None or sigma is None:
        return "the rotation between camera and IMU is not known yet: rotate the device about two axes"
    known = f"to {sigma:.2f} deg" if sigma < 30.0 else "not at all"
    return (
        f"the rotation between camera and IMU is known {known} and the device turns by {second:.1f} deg/s about a "
        "second axis: rotate the device about two axes"
    )
