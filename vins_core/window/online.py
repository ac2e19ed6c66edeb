"""Calibration while running: which of time offset and extrinsics are variables of a window (REFERENCE O5, O6).

What is estimated enters the first prior with a standard deviation about what is given, stays a variable of every prior
after it, and is held in a solve that could tell nothing about it: td while the body hardly moves, extrinsics also until
the window is full.  Unlike VINS-Fusion, which lets extrinsics go for good once the body has moved, both are held again
whenever it stops: what the prior knows by then stays in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import params
from ..geometry import se3, so3
from ..report import CalibrationReport, Gate, all_pass
from ..sensors import Calibration
from ..solver.covariance import calibration_sigmas
from ..solver.problem import WindowProblem
from ..solver.trust_region import Solution
from .state import BlockKey, Calibrates, Prior, WindowState


def wanted(online: params.Online, calibration: Calibration) -> Calibrates:
    """What a run estimates: as the parameters say, or else the calibration.  Without IMU nothing can be told."""
    if not calibration.has_imu:
        return Calibrates()
    asked = {"td": calibration.estimate_td, "extrinsics": calibration.extrinsics != "fixed"}
    return Calibrates(
        **{k: asks if getattr(online, k) == "auto" else getattr(online, k) == "on" for k, asks in asked.items()}
    )


def believe(online: params.Online, window: WindowState) -> WindowState:
    """`window` whose prior knows what is estimated as well as the parameters say; a block that it has stays."""
    keys, sigmas = [], []
    if window.calibrates.td:
        keys.append(BlockKey("td", 0))
        sigmas.append(np.array([online.td_sigma_s]))
    if window.calibrates.extrinsics:
        sigma_m = online.translation_sigma_m if window.T_b_c[0, :3, 3].any() else online.unknown_sigma_m
        sigma = np.repeat([sigma_m, np.radians(online.rotation_sigma_deg)], 3)
        keys += [BlockKey("extrinsic", camera) for camera in range(len(window.T_b_c))]
        sigmas += [sigma] * len(window.T_b_c)
    known = window.prior.blocks if window.prior else ()
    new = [(key, sigma) for key, sigma in zip(keys, sigmas) if key not in known]
    if not new:
        return window
    prior = window.prior or Prior((), (), np.zeros((0, 0)), np.zeros(0))
    n, m = len(prior.r), sum(key.size for key, _ in new)
    J = np.zeros((n + m, n + m))
    J[:n, :n] = prior.J
    J[range(n, n + m), range(n, n + m)] = 1.0 / np.concatenate([sigma for _, sigma in new])
    blocks, x0 = (
        (*prior.blocks, *(key for key, _ in new)),
        (*prior.x0, *(calibrated_value(window, key) for key, _ in new)),
    )
    return replace(window, prior=Prior(blocks, x0, J, np.append(prior.r, np.zeros(m))))


def calibrated_value(window: WindowState, key: BlockKey) -> np.ndarray:
    """Of `td` (1,), or of an `extrinsic` (7,) p and q wxyz."""
    if key.kind == "td":
        return np.array([window.td_s])
    T_b_c = window.T_b_c[key.id]
    return np.append(T_b_c[:3, 3], so3.from_matrix(T_b_c[:3, :3]))


@dataclass(frozen=True)
class Release:
    """What is free in one solve, and the gates that decide it; no gates where nothing is estimated."""

    td_gates: tuple[Gate, ...] = ()
    extrinsic_gates: tuple[Gate, ...] = ()

    @property
    def td(self) -> bool:
        return bool(self.td_gates) and all_pass(self.td_gates)

    @property
    def extrinsics(self) -> bool:
        return bool(self.extrinsic_gates) and all_pass(self.extrinsic_gates)

    def free(self, problem: WindowProblem) -> WindowProblem:
        if not (self.td or self.extrinsics):
            return problem
        return replace(problem, free_td=self.td, free_extrinsics=self.extrinsics)


def release(settings: params.Params, window: WindowState) -> Release:
    """The gates of `window` as it goes into its solve."""
    wish = window.calibrates
    if not (wish.td or wish.extrinsics):
        return Release()
    speed = float(np.linalg.norm(window.frames[0].v_w_b))
    moving = Gate("speed of the oldest frame", speed, ">=", settings.online.min_speed, "online.min_speed", "m/s")
    full = Gate("frames before the newest", len(window.frames) - 1, ">=", settings.window.size, "window.size")
    return Release((moving,) if wish.td else (), (full, moving) if wish.extrinsics else ())


def report(
    window: WindowState, released: Release, problem: WindowProblem, solution: Solution
) -> CalibrationReport | None:
    """What the solve made of the calibration; None where nothing is estimated.  `window`: as solved."""
    if window.calibrates == Calibrates():
        return None
    td_sigma_s, extrinsic_sigma = calibration_sigmas(problem, solution.states, solution.system)
    return CalibrationReport(
        td_s=window.td_s,
        td_sigma_s=td_sigma_s,
        td_gates=released.td_gates,
        T_b_c=window.T_b_c,
        extrinsic_sigma=extrinsic_sigma,
        extrinsic_gates=released.extrinsic_gates,
    )


def moved(T_b_c: np.ndarray, given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far extrinsics (4, 4) are from given ones: translation in body axes (3,) m, rotation vector in camera axes
    (3,) rad, as in the tangent space of the estimator."""
    turn = so3.log(so3.from_matrix(se3.inverse(given)[:3, :3] @ T_b_c[:3, :3]))
    return T_b_c[:3, 3] - given[:3, 3], turn
