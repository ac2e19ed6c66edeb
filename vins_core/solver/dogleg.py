"""Powell's dogleg as Ceres has it ("traditional"), as a state-in/state-out iteration; what VINS uses (REFERENCE O1).

In coordinates u = D d with D = sqrt(clip(diag J'J, 1e-6, 1e32)) and the scaled gradient s = D^-1 J'r, the path from
here goes along the gradient to the Cauchy point -a s, a = |s|^2 / |J D^-1 s|^2, and from there straight to the
Gauss-Newton point, which solves (J'J + mu D^2) d = -J'r.  The step is where this path leaves the ball |u| <= radius:

    gain ratio > 3/4   radius = max(radius, 3 |u|)          gain ratio < 1/4 or rejected   radius /= 2
    accepted           mu = max(min_mu, mu / 5)             J'J + mu D^2 indefinite        mu *= 10

A rejected step costs one evaluation and no factorisation: the path is kept.  One that ended inside the ball would be
tried again as it is until the ball has shrunk to it (Ceres does), so ours halves the length of the step instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import params
from ..report import IterationReport
from . import schur
from .linearize import Linearizer, NormalEquations
from .problem import States, WindowProblem
from .trust_region import Rules, Solution, gauge_damping, rules, terminate

MAX_MU = 1.0


@dataclass(frozen=True)
class Path:
    """Both corners of the path, in scaled coordinates (cameras, inverse depths)."""

    scale: np.ndarray  # D
    gradient: np.ndarray  # s
    cauchy: float  # a
    gauss_newton: np.ndarray
    mu: float  # with which it was found


@dataclass(frozen=True)
class Iteration:
    """Where the solver stands between two steps."""

    states: States
    system: NormalEquations  # at `states`
    radius: float
    mu: float
    path: Path | None = None  # at `states`, kept while steps are rejected
    curved: bool = False  # `system` has the curvature of the robust loss
    may_curve: bool = True
    reports: tuple[IterationReport, ...] = ()
    fall: float = float("inf")  # share of the cost that the last step removed, or was expected to if it was rejected


def init(settings: params.Solver, linearizer: Linearizer, states: States) -> Iteration:
    rule = rules(settings)
    return Iteration(states, linearizer.linearize(states), rule.radius, rule.min_mu)


def step(settings: params.Solver, linearizer: Linearizer, at: Iteration) -> Iteration:
    """One trial step, accepted or not."""
    rule, system = rules(settings), at.system
    cost = max(system.cost.total, 1e-300)
    path = at.path or _path(rule, system, at.states, at.mu, not linearizer.layout.inertial)
    if path is None:
        nothing = float("nan")
        return replace(
            at, radius=0.0, reports=(*at.reports, IterationReport(nothing, False, nothing, nothing, at.radius))
        )
    u, corner = _leave(path, at.radius)
    length = float(np.linalg.norm(u))
    d = u / path.scale
    D = len(system.g)
    dc, dl = d[:D], d[D:]
    expected = -float(system.g @ dc + system.g_l @ dl) - 0.5 * _curvature(system, dc, dl)
    states = linearizer.retract(at.states, dc, dl)
    curved = at.may_curve and expected < rule.curved_below * cost
    trial = linearizer.linearize(states, curved)
    trial_cost = trial.cost.total
    ratio = (cost - trial_cost) / expected if np.isfinite(trial_cost) and expected > 0 else float("nan")
    accepted = ratio > settings.min_gain_ratio
    report = IterationReport(trial_cost, accepted, float(np.linalg.norm(d)), ratio, at.radius, corner)
    reports = (*at.reports, report)
    halved = 0.5 * (min(at.radius, length) if rule.shrinks_to_step else at.radius)
    if not accepted and at.curved:
        plain = linearizer.linearize(at.states)
        return replace(
            at, system=plain, path=None, curved=False, may_curve=False, reports=reports, fall=expected / cost
        )
    if not accepted:
        return replace(at, radius=halved, path=path, reports=reports, fall=expected / cost)
    radius = halved if ratio < 0.25 else max(at.radius, 3.0 * length) if ratio > 0.75 else at.radius
    mu = max(rule.min_mu, path.mu / 5.0)
    radius = min(radius, settings.max_radius)
    return Iteration(states, trial, radius, mu, None, curved, at.may_curve, reports, (cost - trial_cost) / cost)


def solve(settings: params.Solver, max_iterations: int, problem: WindowProblem) -> Solution:
    """Minimise the cost of `problem` from its initial states."""
    linearizer = Linearizer(problem)
    at = init(settings, linearizer, problem.initial)
    before = at.system.cost
    while (why := terminate(settings, at, max_iterations)) is None:
        at = step(settings, linearizer, at)
    return Solution(at.states, at.system, before, at.system.cost, at.reports, why)


def _path(rule: Rules, system: NormalEquations, states: States, mu: float, whole_pose: bool = False) -> Path | None:
    """None when no mu up to MAX_MU makes the normal equations positive definite."""
    D2c, D2l = np.clip(system.H.diagonal(), 1e-6, 1e32), np.clip(system.h, 1e-6, 1e32)
    scale = np.sqrt(np.concatenate([D2c, D2l]))
    gradient = np.concatenate([system.g, system.g_l]) / scale
    back = gradient / scale
    cauchy = float(gradient @ gradient) / _curvature(system, back[: len(D2c)], back[len(D2c) :])
    gauge = gauge_damping(states.poses[0], whole_pose) if rule.holds_gauge else None
    while (solved := schur.solve_damped(system, mu * D2c, mu * D2l, gauge)) is None:
        mu *= 10.0
        if mu > MAX_MU:
            return None
    return Path(scale, gradient, cauchy, np.concatenate(solved) * scale, mu)


def _leave(path: Path, radius: float) -> tuple[np.ndarray, str]:
    """Where the path leaves the ball, and on which leg."""
    a, s, gn = path.cauchy, path.gradient, path.gauss_newton
    if np.linalg.norm(gn) <= radius:
        return gn, "gauss-newton"
    length = float(np.linalg.norm(s))
    if a * length >= radius:
        return (-radius / length) * s, "gradient"
    leg = gn + a * s  # from the Cauchy point
    b, c = float(leg @ (a * s)), radius * radius - (a * length) ** 2
    t = (b + np.sqrt(b * b + float(leg @ leg) * c)) / float(leg @ leg)
    return t * leg - a * s, "dogleg"


def _curvature(system: NormalEquations, dc: np.ndarray, dl: np.ndarray) -> float:
    """d' J'J d on the arrow system."""
    P = system.W.shape[1]
    return float(dc @ (system.H @ dc) + 2.0 * (dl @ (system.W @ dc[:P])) + (system.h * dl) @ dl)
