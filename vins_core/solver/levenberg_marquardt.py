"""Levenberg-Marquardt with the damping rules of Ceres, as a state-in/state-out iteration.

Each iteration solves (J'J + D / radius) d = -J'r with D = clip(diag J'J, 1e-6, 1e32), compares the fall of the cost
with that of the linear model (the gain ratio) and

    accepts the step when the ratio exceeds min_gain_ratio:  radius /= max(1/3, 1 - (2 ratio - 1)^3)
    rejects it otherwise:                                    radius /= 2, 4, 8, ... in a row

Position and yaw of the whole window are invisible to camera and IMU; without damping, rounding errors and the
prior's linearisation decide them.  The oldest pose is therefore damped strongly in these four directions, which
holds them without changing the minimum over all others (VINS lets them go and puts them back, REFERENCE O9).

`init`, `step`, `terminate` can be called one by one; `solve` loops over them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import params
from ..report import CostSplit, IterationReport
from . import schur
from .linearize import Linearizer, NormalEquations
from .problem import States, WindowProblem

GAUGE_INFORMATION = 1e8
"""Damping of position and yaw of the oldest frame, 1/m^2 and 1/rad^2."""


@dataclass(frozen=True)
class Iteration:
    """Where the solver stands between two steps."""

    states: States
    system: NormalEquations  # at `states`
    radius: float
    shrink: float  # divides the radius at the next rejection
    reports: tuple[IterationReport, ...] = ()
    fall: float = float("inf")  # share of the cost that the last step removed, or was expected to if it was rejected


@dataclass(frozen=True)
class Solution:
    states: States
    system: NormalEquations  # at `states`
    before: CostSplit
    after: CostSplit
    iterations: tuple[IterationReport, ...]
    termination: str


def init(settings: params.Solver, linearizer: Linearizer, states: States) -> Iteration:
    return Iteration(states, linearizer.linearize(states), settings.initial_radius, 2.0)


def step(settings: params.Solver, linearizer: Linearizer, at: Iteration) -> Iteration:
    """One trial step, accepted or not."""
    system = at.system
    cost = max(system.cost.total, 1e-300)
    Dc = np.clip(system.H.diagonal(), 1e-6, 1e32)
    Dl = np.clip(system.h, 1e-6, 1e32)
    gauge = gauge_damping(at.states.poses[0])
    solved = schur.solve_damped(system, Dc / at.radius, Dl / at.radius, gauge)
    ratio, step_norm, trial_cost, expected = float("nan"), float("nan"), float("nan"), float("inf")
    if solved is not None:
        dc, dl = solved
        step_norm = float(np.sqrt(dc @ dc + dl @ dl))
        # the model falls by -g.d - d'Hd/2, and (H + damping) d = -g
        damping = ((Dc * dc) @ dc + (Dl * dl) @ dl) / at.radius + dc[:6] @ gauge @ dc[:6]
        expected = 0.5 * float(damping - system.g @ dc - system.g_l @ dl)
        states = linearizer.retract(at.states, dc, dl)
        trial = linearizer.linearize(states)
        trial_cost = trial.cost.total
        if np.isfinite(trial_cost) and expected > 0:
            ratio = (cost - trial_cost) / expected
    accepted = ratio > settings.min_gain_ratio
    report = IterationReport(trial_cost, accepted, step_norm, ratio, at.radius)
    reports = (*at.reports, report)
    if not accepted:
        return replace(at, radius=at.radius / at.shrink, shrink=2.0 * at.shrink, reports=reports, fall=expected / cost)
    radius = min(at.radius / max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3), settings.max_radius)
    return Iteration(states, trial, radius, 2.0, reports, (cost - trial_cost) / cost)


def gauge_damping(pose: np.ndarray) -> np.ndarray:
    """(6, 6) on the position of a pose and on its rotation about gravity, whose axis in the body is R' e_z."""
    w, x, y, z = pose[3:]
    axis = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    damping = np.zeros((6, 6))
    damping[:3, :3] = np.eye(3)
    damping[3:, 3:] = np.outer(axis, axis)
    return GAUGE_INFORMATION * damping


def terminate(settings: params.Solver, at: Iteration, max_iterations: int) -> str | None:
    """Why the iteration ends here, as a sentence; None when it goes on."""
    if not np.isfinite(at.system.cost.total):
        return "not started: the cost of the initial state is not finite"
    if at.system.cost.total == 0:
        return "converged: the cost is zero"
    if at.fall < settings.function_tolerance:
        return f"converged: the cost falls by less than {settings.function_tolerance:g} of itself"
    if at.radius < 1e-32:
        return "stopped: no step lowers the cost"
    if len(at.reports) >= max_iterations:
        return f"stopped after {max_iterations} iterations"
    return None


def solve(settings: params.Solver, max_iterations: int, problem: WindowProblem) -> Solution:
    """Minimise the cost of `problem` from its initial states."""
    linearizer = Linearizer(problem)
    at = init(settings, linearizer, problem.initial)
    before = at.system.cost
    while (why := terminate(settings, at, max_iterations)) is None:
        at = step(settings, linearizer, at)
    return Solution(at.states, at.system, before, at.system.cost, at.reports, why)
