"""Levenberg-Marquardt with the damping rules of Ceres, as a state-in/state-out iteration.

Each iteration solves (J'J + D / radius) d = -J'r with D = clip(diag J'J, 1e-6, 1e32), compares the fall of the cost
with that of the linear model (the gain ratio) and

    accepts the step when the ratio exceeds min_gain_ratio:  radius /= max(1/3, 1 - (2 ratio - 1)^3)
    rejects it otherwise:                                    radius /= 2, 4, 8, ... in a row

How damping begins and how position and yaw are held: trust_region.py.
`init`, `step`, `terminate` can be called one by one; `solve` loops over them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import params
from ..report import IterationReport
from . import schur
from .linearize import Linearizer, NormalEquations
from .problem import States, WindowProblem
from .trust_region import Solution, gauge_damping, rules, terminate


@dataclass(frozen=True)
class Iteration:
    """Where the solver stands between two steps."""

    states: States
    system: NormalEquations  # at `states`
    radius: float
    shrink: float  # divides the radius at the next rejection
    curved: bool = False  # `system` has the curvature of the robust loss
    may_curve: bool = True
    reports: tuple[IterationReport, ...] = ()
    fall: float = float("inf")  # share of the cost that the last step removed, or was expected to if it was rejected


def init(settings: params.Solver, linearizer: Linearizer, states: States) -> Iteration:
    return Iteration(states, linearizer.linearize(states), rules(settings).radius, 2.0)


def step(settings: params.Solver, linearizer: Linearizer, at: Iteration) -> Iteration:
    """One trial step, accepted or not."""
    rule, system = rules(settings), at.system
    cost = max(system.cost.total, 1e-300)
    Dc = np.clip(system.H.diagonal(), 1e-6, 1e32)
    Dl = np.clip(system.h, 1e-6, 1e32)
    gauge = gauge_damping(at.states.poses[0], not linearizer.layout.inertial) if rule.holds_gauge else np.zeros((6, 6))
    solved = schur.solve_damped(system, Dc / at.radius, Dl / at.radius, gauge)
    ratio, step_norm, trial_cost, expected = float("nan"), float("nan"), float("nan"), float("inf")
    if solved is not None:
        dc, dl = solved
        step_norm = float(np.sqrt(dc @ dc + dl @ dl))
        # the model falls by -g.d - d'Hd/2, and (H + damping) d = -g
        damping = ((Dc * dc) @ dc + (Dl * dl) @ dl) / at.radius + dc[:6] @ gauge @ dc[:6]
        expected = 0.5 * float(damping - system.g @ dc - system.g_l @ dl)
        states = linearizer.retract(at.states, dc, dl)
        curved = at.may_curve and expected < rule.curved_below * cost
        trial = linearizer.linearize(states, curved)
        trial_cost = trial.cost.total
        if np.isfinite(trial_cost) and expected > 0:
            ratio = (cost - trial_cost) / expected
    accepted = ratio > settings.min_gain_ratio
    report = IterationReport(trial_cost, accepted, step_norm, ratio, at.radius)
    reports = (*at.reports, report)
    if not accepted and at.curved:
        plain = linearizer.linearize(at.states)
        return replace(at, system=plain, curved=False, may_curve=False, reports=reports, fall=expected / cost)
    if not accepted:
        return replace(at, radius=at.radius / at.shrink, shrink=2.0 * at.shrink, reports=reports, fall=expected / cost)
    radius = min(at.radius / max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3), settings.max_radius)
    return Iteration(states, trial, radius, 2.0, curved, at.may_curve, reports, (cost - trial_cost) / cost)


def solve(settings: params.Solver, max_iterations: int, problem: WindowProblem) -> Solution:
    """Minimise the cost of `problem` from its initial states."""
    linearizer = Linearizer(problem)
    at = init(settings, linearizer, problem.initial)
    before = at.system.cost
    while (why := terminate(settings, at, max_iterations)) is None:
        at = step(settings, linearizer, at)
    return Solution(at.states, at.system, before, at.system.cost, at.reports, why)
