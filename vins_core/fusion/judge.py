"""Which fixes agree: each is compared with what all others in use and the odometry say of it.

At the minimum, with V = H S H' the covariance of the antenna's predicted position and R_w = R / w that of the fix as it
was weighted (w = 0: not used), leaving the fix out gives

    r_out = (I + K) r,    V_out = (I + K) V,    K = V (R_w - V)^-1,    chi2 = r_out' (R + V_out)^-1 r_out

without solving again.  A fix that was used and does not agree is taken out, the worst first, since one outlier makes
its neighbours look bad; one that was not used and agrees comes back.  So a verdict is open as long as the fix is in
the window: after an outage, when the prediction is too vague to tell an outlier from a good fix, the next fixes do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import params
from .chain import Linearizer
from .solve import Solution, minimize

MAX_ROUNDS = 12
"""Solves of one judgement at most; what still disagrees then is taken out."""


@dataclass(frozen=True)
class Judgement:
    solution: Solution
    covariances: np.ndarray  # (n, t, t) of the nodes
    used: np.ndarray  # (m,) bool
    chi2: np.ndarray  # (m,) of each fix against all others


def judge(
    settings: params.Gps, linearizer: Linearizer, x: np.ndarray, used: np.ndarray, neighbourhood: int | None = None
) -> Judgement:
    """Solve, compare, and solve again until the verdicts stand.

    `neighbourhood`: in one round a fix is taken out only if it is the worst of so many on either side (all).
    """
    used, returned = used.copy(), np.zeros(len(used), bool)
    for _ in range(MAX_ROUNDS):
        judgement = _compare(settings, linearizer, x, used)
        x, chi2 = judgement.solution.x, judgement.chi2
        out = used & ~(chi2 <= settings.max_chi2)
        if out.any():
            used = used & ~_worst(np.where(used, chi2, 0.0), out, neighbourhood)
            continue
        back = ~used & ~returned & (chi2 <= settings.max_chi2)
        if not back.any():
            return judgement
        used, returned = used | back, returned | back
    return _compare(settings, linearizer, x, used & (chi2 <= settings.max_chi2))


def _compare(settings: params.Gps, linearizer: Linearizer, x: np.ndarray, used: np.ndarray) -> Judgement:
    solution = minimize(settings, linearizer, x, used)
    covariances = solution.covariances()
    return Judgement(solution, covariances, used, chi_squares(linearizer, solution.x, covariances, used))


def chi_squares(linearizer: Linearizer, x: np.ndarray, covariances: np.ndarray, used: np.ndarray) -> np.ndarray:
    """(m,) of each fix against all others, at the minimum x with the fixes `used`."""
    fixes = linearizer.chain.fixes
    r, J = linearizer.antenna(x)
    V = J @ covariances[fixes.node] @ np.swapaxes(J, 1, 2)
    R, eye = fixes.covariance, np.eye(3)
    w = linearizer.weights(r, used)
    # K = V (R / w - V)^-1 = w V (R - w V)^-1, also for w = 0
    wV = w[:, None, None] * V
    leave = eye + wV @ np.linalg.inv(R - wV)
    out = np.einsum("mab,mb->ma", leave, r)
    return np.einsum("ma,mab,mb->m", out, np.linalg.inv(R + leave @ V), out)


def _worst(chi2: np.ndarray, out: np.ndarray, neighbourhood: int | None) -> np.ndarray:
    """(m,) bool: those of `out` that nothing nearby exceeds."""
    reach = len(chi2) if neighbourhood is None else neighbourhood
    worst = np.zeros(len(chi2), bool)
    for k in np.flatnonzero(out):
        around = slice(max(0, k - reach), k + reach + 1)
        worst[k] = chi2[k] >= np.max(chi2[around])
    return worst
