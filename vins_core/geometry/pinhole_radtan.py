"""Pinhole camera with radial-tangential distortion (Brown-Conrady; VINS `PINHOLE`, Kalibr `pinhole-radtan`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from . import radial


@dataclass(frozen=True)
class PinholeRadtan:
    """With (x, y) = (X/Z, Y/Z) and s = x^2 + y^2 (REFERENCE C1, OpenCV's first four coefficients):

        x_d = x (1 + k1 s + k2 s^2) + 2 p1 x y + p2 (s + 2 x^2)
        y_d = y (1 + k1 s + k2 s^2) + p1 (s + 2 y^2) + 2 p2 x y
        uv  = (fx x_d + cx, fy y_d + cy)

    The domain is Z > 0 up to the angle where the radial part stops growing.
    """

    name: ClassVar[str] = "pinhole-radtan"

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

    def project(self, points_c: np.ndarray) -> np.ndarray:
        X, Y, Z = np.asarray(points_c, float).T
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = X / Z, Y / Z
            x_d, y_d = self._distort(x, y)[:2]
        inside = (Z > 0) & (x * x + y * y < self._max_radius**2)
        uv = np.stack([self.fx * x_d + self.cx, self.fy * y_d + self.cy], -1)
        return np.where(inside[:, None], uv, np.nan)

    def lift(self, uv_px: np.ndarray) -> np.ndarray:
        """Newton's method with the analytic Jacobian, to 1e-13 on the normalised plane."""
        u, v = np.asarray(uv_px, float).T
        x_d, y_d = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        x, y = x_d, y_d
        with np.errstate(all="ignore"):
            for _ in range(30):
                fx, fy, a, b, c = self._distort(x, y)
                ex, ey = fx - x_d, fy - y_d
                det = a * c - b * b
                dx, dy = (c * ex - b * ey) / det, (a * ey - b * ex) / det
                x, y = x - dx, y - dy
                if not np.any(np.abs(dx) + np.abs(dy) > 1e-7):  # the next step would be its square
                    break
            fx, fy = self._distort(x, y)[:2]
            s = x * x + y * y
            solved = (np.abs(fx - x_d) + np.abs(fy - y_d) < 1e-12) & (s < self._max_radius**2)
            norm = np.sqrt(1.0 + s)
            rays = np.stack([x / norm, y / norm, 1.0 / norm], -1)
        return np.where(solved[:, None], rays, np.nan)

    @cached_property
    def _max_radius(self) -> float:
        return radial.turning_point((self.k1, self.k2))

    def _distort(
        self, x: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """x_d, y_d and the symmetric Jacobian [[a, b], [b, c]]."""
        s, xy = x * x + y * y, x * y
        radial_factor = 1.0 + s * (self.k1 + self.k2 * s)
        slope = 2.0 * (self.k1 + 2.0 * self.k2 * s)
        p1, p2 = 2.0 * self.p1, 2.0 * self.p2
        x_d = x * radial_factor + p1 * xy + self.p2 * (s + 2.0 * x * x)
        y_d = y * radial_factor + self.p1 * (s + 2.0 * y * y) + p2 * xy
        a = radial_factor + slope * x * x + p1 * y + 3.0 * p2 * x
        b = slope * xy + p1 * x + p2 * y
        c = radial_factor + slope * y * y + 3.0 * p1 * y + p2 * x
        return x_d, y_d, a, b, c
