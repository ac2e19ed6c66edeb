"""Has the estimator lost its way?  Failure detection F1-F6 (REFERENCE 11) after each solve."""

from __future__ import annotations

import numpy as np

from ..geometry import so3
from ..params import Health
from ..report import Gate, HealthReport, PoseEstimate


def check(
    params: Health, tracked: int, previous: PoseEstimate | None, pose: PoseEstimate, further: tuple[Gate, ...] = ()
) -> HealthReport:
    """Compare the newest frame's estimate with limits and with the previous frame's estimate.

    tracked: tracks the newest frame shares with the frame before it.  Advisory gates are shown and decide nothing,
    as in the original: few tracks (F1) and a fast turn (F6) alone do not mean that the estimate is wrong.  `further`:
    gates that were judged before the solve.
    """
    gates = [
        Gate("tracked", tracked, ">=", params.min_tracked, "health.min_tracked", decides=False),
        Gate("accelerometer bias", _norm(pose.b_a), "<=", params.max_acc_bias, "health.max_acc_bias", "m/s^2"),
        Gate("gyroscope bias", _norm(pose.b_g), "<=", params.max_gyr_bias, "health.max_gyr_bias", "rad/s"),
    ]
    if previous is not None:
        moved = pose.p_w_b - previous.p_w_b
        turned = np.degrees(_norm(so3.difference(pose.q_w_b, previous.q_w_b)))
        gates += [
            Gate("translation", _norm(moved), "<=", params.max_jump_m, "health.max_jump_m", "m"),
            Gate("vertical translation", abs(float(moved[2])), "<=", params.max_z_jump_m, "health.max_z_jump_m", "m"),
            Gate("rotation", turned, "<=", params.max_rotation_deg, "health.max_rotation_deg", "deg", decides=False),
        ]
    gates += further
    failed = [g for g in gates if g.decides and not g.passed]
    outcome = ""
    if failed:
        g = failed[0]
        value = "not a number" if g.value is None or not np.isfinite(g.value) else f"{g.value:.3g} {g.unit}"
        outcome = f"{g.name} is {value}, the limit is {g.limit:g} {g.unit} ({g.knob})"
    return HealthReport(tuple(gates), outcome)


def _norm(v: np.ndarray) -> float:
    return float(np.linalg.norm(v))
