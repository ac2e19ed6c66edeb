"""Pinhole camera with rational distortion (OpenCV's first eight coefficients; camodocal `PINHOLE_FULL`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.polynomial import Polynomial

from . import brown_conrady, radial

WIDEST = 1e4
"""Largest radius on the normalised plane: what lies nearer to 90 degrees no pinhole shows."""


@dataclass(frozen=True)
class PinholeRational:
    """With (x, y) = (X/Z, Y/Z) and s = x^2 + y^2 (REFERENCE C5):

        f   = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3)
        x_d = x f + 2 p1 x y + p2 (s + 2 x^2)
        y_d = y f + p1 (s + 2 y^2) + 2 p2 x y
        uv  = (fx x_d + cx, fy y_d + cy)

    The domain is Z > 0 up to the angle where the radial part r f(r^2) stops growing.
    """

    name: ClassVar[str] = "pinhole-rational"

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    k4: float
    k5: float
    k6: float

    def project(self, points_c: np.ndarray) -> np.ndarray:
        X, Y, Z = np.asarray(points_c, float).T
        with np.errstate(all="ignore"):
            x, y = X / Z, Y / Z
            x_d, y_d = brown_conrady.distort(self._factor, self.p1, self.p2, x, y)[:2]
            inside = (Z > 0) & (x * x + y * y < self._max_radius**2)
        uv = np.stack([self.fx * x_d + self.cx, self.fy * y_d + self.cy], -1)
        return np.where(inside[:, None], uv, np.nan)

    def lift(self, uv_px: np.ndarray) -> np.ndarray:
        """Along the radius first, which finds its root wherever it is; the tangential share is small."""
        u, v = np.asarray(uv_px, float).T
        x_d, y_d = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        r_d = np.hypot(x_d, y_d)
        r = radial.invert(self._radius, r_d, self._max_radius)
        shrink = np.where(r_d == 0, 1.0, np.where(np.isnan(r), self._max_radius, r) / np.where(r_d == 0, 1.0, r_d))
        start = shrink * x_d, shrink * y_d
        x, y = brown_conrady.undistort(self._factor, self.p1, self.p2, x_d, y_d, self._max_radius, start)
        norm = np.sqrt(1.0 + (x * x + y * y))
        return np.stack([x / norm, y / norm, 1.0 / norm], -1)

    def _factor(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        above, below = (
            1.0 + s * (self.k1 + s * (self.k2 + s * self.k3)),
            1.0 + s * (self.k4 + s * (self.k5 + s * self.k6)),
        )
        above_slope = self.k1 + s * (2.0 * self.k2 + s * 3.0 * self.k3)
        below_slope = self.k4 + s * (2.0 * self.k5 + s * 3.0 * self.k6)
        f = above / below
        return f, 2.0 * (above_slope - f * below_slope) / below

    def _radius(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s = r * r
        f, slope = self._factor(s)
        return r * f, f + slope * s

    @cached_property
    def _max_radius(self) -> float:
        """(r f)' = ((a + 2 s a') b - 2 s a b') / b^2 for f = a / b."""
        a, b, s = (
            Polynomial([1, self.k1, self.k2, self.k3]),
            Polynomial([1, self.k4, self.k5, self.k6]),
            Polynomial([0, 1]),
        )
        slope = (a + 2 * s * a.deriv()) * b - 2 * s * a * b.deriv()
        return min(WIDEST, radial.first_root(slope), radial.first_root(b))
