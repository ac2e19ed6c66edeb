"""Robust losses: the cost of a residual is rho(|r|^2) / 2 instead of |r|^2 / 2.

Least squares sees a reweighted residual and Jacobian.  The gradient of the cost is rho' J'r; of its Hessian, the part

    J' (rho' I + 2 rho'' r r') J

is either taken as rho' J'J (Ceres' choice where rho'' <= 0, as for all losses here): r and J times sqrt(rho').  It
never bends less than the cost, so every step is too short and convergence is linear.  Or it is taken as it is, but for
a floor under its curvature along r (Triggs et al. 2000): with k = max(1 + 2 s rho'' / rho', MIN_CURVATURE),

    J~ = sqrt(rho') (I - (1 - sqrt k) r r' / s) J,      r~ = sqrt(rho') r / sqrt k,      J~'r~ = rho' J'r

which converges quadratically where most residuals are small, and overshoots far from the minimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

MIN_CURVATURE = 0.2
"""Outliers bend the cost downwards; a Hessian must not."""


@dataclass(frozen=True)
class Loss:
    """With s = |r|^2 and a = scale (in standard deviations):

    none    rho = s
    cauchy  rho = a^2 log(1 + s / a^2)
    huber   rho = s for s <= a^2, else 2 a sqrt(s) - a^2
    """

    kind: str = "none"
    scale: float = 1.0

    def rho(self, s: np.ndarray) -> np.ndarray:
        a2 = self.scale * self.scale
        if self.kind == "cauchy":
            return a2 * np.log1p(s / a2)
        if self.kind == "huber":
            return np.where(s <= a2, s, 2.0 * self.scale * np.sqrt(s) - a2)
        return s

    def rho_symbolic(self, s: ca.SX) -> ca.SX:
        """rho of a CasADi expression, for solvers that want exact derivatives."""
        a2 = self.scale * self.scale
        if self.kind == "cauchy":
            return a2 * ca.log(1 + s / a2)
        if self.kind == "huber":
            return ca.if_else(s <= a2, s, 2 * self.scale * ca.sqrt(ca.fmax(s, a2)) - a2)
        return s

    def weight(self, s: np.ndarray) -> np.ndarray:
        """sqrt(rho'(s)), the factor on residual and Jacobian."""
        a2 = self.scale * self.scale
        if self.kind == "cauchy":
            return 1.0 / np.sqrt(1.0 + s / a2)
        if self.kind == "huber":
            return np.sqrt(self.scale / np.sqrt(np.maximum(s, a2)))
        return np.ones_like(s)

    def bend(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(1 - sqrt k) / s and sqrt k."""
        a2 = self.scale * self.scale
        if self.kind == "cauchy":
            u = s / a2
            k = np.maximum((1.0 - u) / (1.0 + u), MIN_CURVATURE)
        elif self.kind == "huber":
            k = np.where(s <= a2, 1.0, MIN_CURVATURE)
        else:
            k = np.ones_like(s)
        root = np.sqrt(k)
        return (1.0 - root) / np.maximum(s, 1e-300), root
