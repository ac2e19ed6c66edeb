"""The minimum of a chain by Gauss-Newton, damped (Levenberg-Marquardt) only where a step would raise the cost.

Heading apart the residuals are linear, so two steps are the rule.  It ends when a step is expected to lower the cost
by less than TOLERANCE: costs are in squared standard deviations, so that is a thousandth of one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import params
from .chain import Chain, Linearizer, retract
from .tridiagonal import BlockTridiagonal

TOLERANCE = 1e-6
_MIN_DAMPING = 1e-3


@dataclass(frozen=True)
class Solution:
    x: np.ndarray  # (n, 8)
    cost: float
    iterations: int
    converged: bool
    factor: BlockTridiagonal  # of H where the last step began, which is as good as at x

    def covariances(self) -> np.ndarray:
        """Of every node's free components, (n, t, t)."""
        return self.factor.covariances()


def minimize(settings: params.Gps, linearizer: Linearizer, x: np.ndarray, used: np.ndarray) -> Solution:
    """From nodes (n, 8), with the fixes of the mask (m,).  LinAlgError when the chain is not held by anything."""
    free = linearizer.chain.free
    at, damping = linearizer.linearize(x, used), 0.0
    factor = BlockTridiagonal(at.diagonal, at.above)
    for iteration in range(1, settings.max_iterations + 1):
        d = factor.solve(-at.g)
        expected = -0.5 * float(np.sum(at.g * d))
        trial_x = retract(free, x, d)
        if expected <= TOLERANCE and damping == 0.0:
            return Solution(trial_x, at.cost - expected, iteration, True, factor)
        trial = linearizer.linearize(trial_x, used)
        if trial.cost <= at.cost:
            x, at, damping = trial_x, trial, 0.1 * damping if damping > _MIN_DAMPING else 0.0
        else:
            damping = max(_MIN_DAMPING, 10.0 * damping)
        factor = BlockTridiagonal(_damped(at.diagonal, damping), at.above)
    return Solution(x, at.cost, settings.max_iterations, False, factor)


def solve(settings: params.Gps, chain: Chain, x: np.ndarray, used: np.ndarray) -> Solution:
    return minimize(settings, Linearizer(chain), x, used)


def _damped(diagonal: np.ndarray, damping: float) -> np.ndarray:
    if damping == 0.0:
        return diagonal
    k = np.arange(diagonal.shape[-1])
    diagonal = diagonal.copy()
    diagonal[:, k, k] *= 1.0 + damping
    return diagonal
