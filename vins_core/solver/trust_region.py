"""What Levenberg-Marquardt and dogleg share: rules of damping, the gauge, when to stop, what a solve gives.

The rules of Ceres (parity) freeze these windows: information about bias random walks reaches 1e15, and damping by the
diagonal of J'J acts on the *common* bias of all frames, about which little is known, as if it were known that well.
Started from a radius of 1e12 the damping is felt only where the normal equations are singular (SOLVER.md).

Position and yaw of the whole window are invisible to camera and IMU; without damping, rounding errors and the
prior's linearisation decide them.  Ours therefore damps the oldest pose strongly in these four directions, which
holds them without changing the minimum over all others (VINS lets them go and puts them back, REFERENCE O9).

Near the minimum, ours lets the curvature of the robust loss into H (factors/robust.py), and 8 steps end two orders
closer to it.  A step from such an H that is rejected is tried again from one without, until the end of the solve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .. import params
from ..report import CostSplit, IterationReport
from .linearize import NormalEquations
from .problem import States

GAUGE_INFORMATION = 1e12
"""Damping of position and yaw of the oldest frame, 1/m^2 and 1/rad^2."""


@dataclass(frozen=True)
class Rules:
    """How strongly steps are held back."""

    radius: float  # of the first trust region
    min_mu: float  # dogleg: smallest damping of the Gauss-Newton step, relative to diag J'J
    holds_gauge: bool  # damp position and yaw of the oldest pose
    shrinks_to_step: bool  # dogleg: a rejected step halves the region from its own length, not from the radius
    curved_below: float  # share of the cost that a step is expected to remove, below which the loss may bend H


CERES = Rules(radius=1e4, min_mu=1e-8, holds_gauge=False, shrinks_to_step=False, curved_below=0.0)


def rules(settings: params.Solver) -> Rules:
    """The rules that `solver.damping` names."""
    if settings.damping == "ceres":
        return CERES
    return Rules(settings.initial_radius, settings.dogleg_min_mu, True, True, settings.curved_below)


@dataclass(frozen=True)
class Solution:
    """Where a solver ended and how it came there."""

    states: States
    system: NormalEquations  # at `states`
    before: CostSplit
    after: CostSplit
    iterations: tuple[IterationReport, ...]
    termination: str


class Progress(Protocol):
    """What every method's iteration knows."""

    @property
    def system(self) -> NormalEquations: ...
    @property
    def radius(self) -> float: ...
    @property
    def reports(self) -> tuple[IterationReport, ...]: ...
    @property
    def fall(self) -> float: ...


def terminate(settings: params.Solver, at: Progress, max_iterations: int) -> str | None:
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


def gauge_damping(pose: np.ndarray, whole: bool = False) -> np.ndarray:
    """(6, 6) on the position of a pose and on its rotation about gravity, whose axis in the body is R' e_z.

    `whole`: on the whole pose, for a problem without IMU.
    """
    if whole:
        return GAUGE_INFORMATION * np.eye(6)
    w, x, y, z = pose[3:]
    axis = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    damping = np.zeros((6, 6))
    damping[:3, :3] = np.eye(3)
    damping[3:, 3:] = np.outer(axis, axis)
    return GAUGE_INFORMATION * damping
