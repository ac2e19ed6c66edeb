"""Levenberg-Marquardt on a pose graph, as a state-in/state-out iteration.

Each iteration solves (H + D / radius) d = -g with D = diag H, and compares the fall of the cost with that of the
linear model.  Radius rules are those of the window's solver (solver/levenberg_marquardt.py).  Damping by the diagonal
holds back the long waves of a chain, in which drift is distributed: a chain of n keyframes has eigenvalues n^2 times
smaller than its diagonal.  So it begins where it is not felt; after a step that raised the cost it begins in earnest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import params
from ..report import GraphCost, IterationReport
from .cholesky import BlockCholesky
from .dissection import dissect
from .linearize import Linearizer, NormalEquations
from .problem import Problem

MIN_GAIN_RATIO = 1e-3
_MAX_RADIUS = 1e16
_FELT_RADIUS = 1e4
"""Damping from which a rejected step starts at the latest."""


class Model:
    """A problem with all that does not change between iterations: its linearizer and its factorisation's pattern."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.linearizer = Linearizer(problem)
        pairs = self.linearizer.pair_i, self.linearizer.pair_j
        coordinates = np.column_stack([problem.nodes[problem.free, :3], problem.free])
        fronts = dissect(*pairs, coordinates)
        self._parts = [(np.array(g), BlockCholesky(fronts, *pairs, len(g))) for g in problem.variant.groups]

    def solve(self, system: NormalEquations, radius: float) -> np.ndarray | None:
        """d (m, t) with (H + D / radius) d = -g; None when the matrix is not positive definite."""
        d = np.empty_like(system.g)
        for columns, cholesky in self._parts:
            row, column = np.ix_(columns, columns)
            diagonal = system.diagonal[:, row, column]
            k = np.arange(len(columns))
            diagonal[:, k, k] *= 1.0 + 1.0 / radius
            if not cholesky.factorize(diagonal, system.off_diagonal[:, row, column]):
                return None
            d[:, columns] = cholesky.solve(-system.g[:, columns])
        return d

    def retract(self, nodes: np.ndarray, d: np.ndarray) -> np.ndarray:
        moved = nodes.copy()
        moved[self.problem.free] = self.problem.variant.retract(nodes[self.problem.free], d)
        return moved


@dataclass(frozen=True)
class Iteration:
    """Where the solver stands between two steps."""

    nodes: np.ndarray  # (n, size)
    system: NormalEquations  # at `nodes`
    radius: float
    before: GraphCost  # at the start
    shrink: float = 2.0  # divides the radius at the next rejection
    reports: tuple[IterationReport, ...] = ()
    fall: float = float("inf")  # share of the cost that the last step removed, or was expected to


def init(settings: params.PoseGraph, model: Model) -> Iteration:
    nodes = model.problem.nodes
    system = model.linearizer.linearize(nodes)
    return Iteration(nodes, system, settings.initial_radius, system.cost)


def step(model: Model, at: Iteration) -> Iteration:
    """One trial step, accepted or not."""
    system, cost = at.system, max(at.system.cost.total, 1e-300)
    d = model.solve(system, at.radius)
    ratio, norm, trial_cost, expected = float("nan"), float("nan"), float("nan"), float("inf")
    if d is not None:
        norm = float(np.sqrt(np.sum(d * d)))
        D = np.einsum("mkk->mk", system.diagonal)
        # the model falls by -g.d - d'Hd/2, and (H + D / radius) d = -g
        expected = 0.5 * float(np.sum(D * d * d) / at.radius - np.sum(system.g * d))
        nodes = model.retract(at.nodes, d)
        trial = model.linearizer.linearize(nodes)
        trial_cost = trial.cost.total
        if np.isfinite(trial_cost) and expected > 0:
            ratio = (cost - trial_cost) / expected
    accepted = ratio > MIN_GAIN_RATIO
    reports = (*at.reports, IterationReport(trial_cost, accepted, norm, ratio, at.radius))
    if not accepted:
        radius = min(at.radius, _FELT_RADIUS * at.shrink) / at.shrink
        return replace(at, radius=radius, shrink=2.0 * at.shrink, reports=reports, fall=expected / cost)
    radius = at.radius / max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
    return Iteration(nodes, trial, min(radius, _MAX_RADIUS), at.before, 2.0, reports, (cost - trial_cost) / cost)


def terminate(settings: params.PoseGraph, at: Iteration) -> str | None:
    """Why the iteration ends here, as a sentence; None when it goes on."""
    if not np.isfinite(at.system.cost.total):
        return "not started: the cost of the graph is not finite"
    if at.system.cost.total == 0:
        return "converged: the cost is zero"
    if at.fall < settings.function_tolerance:
        return f"converged: the cost falls by less than {settings.function_tolerance:g} of itself"
    if at.radius < 1e-16:
        return "stopped: no step lowers the cost"
    if len(at.reports) >= settings.max_iterations:
        return f"stopped after {settings.max_iterations} iterations"
    return None


def solve(settings: params.PoseGraph, problem: Problem) -> Iteration:
    """Minimise the cost of `problem`; the last iteration, whose `terminate` says why it is the last."""
    model = Model(problem)
    at = init(settings, model)
    while terminate(settings, at) is None:
        at = step(model, at)
    return at
