"""Robust losses: the cost of a residual is rho(|r|^2) / 2 instead of |r|^2 / 2.

Least squares sees a reweighted residual and Jacobian (Triggs' correction, as in Ceres).  For the losses here
rho'' <= 0, where that correction is the scaling by sqrt(rho') alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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

    def weight(self, s: np.ndarray) -> np.ndarray:
        """sqrt(rho'(s)), the factor on residual and Jacobian."""
        a2 = self.scale * self.scale
        if self.kind == "cauchy":
            return 1.0 / np.sqrt(1.0 + s / a2)
        if self.kind == "huber":
            return np.sqrt(self.scale / np.sqrt(np.maximum(s, a2)))
        return np.ones_like(s)
