"""Pinhole camera with radial-tangential distortion (Brown-Conrady; VINS `PINHOLE`, Kalibr `pinhole-radtan`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from . import brown_conrady, radial


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
            x_d, y_d = brown_conrady.distort(self._factor, self.p1, self.p2, x, y)[:2]
        inside = (Z > 0) & (x * x + y * y < self._max_radius**2)
        uv = np.stack([self.fx * x_d + self.cx, self.fy * y_d + self.cy], -1)
        return np.where(inside[:, None], uv, np.nan)

    def lift(self, uv_px: np.ndarray) -> np.ndarray:
        u, v = np.asarray(uv_px, float).T
        x_d, y_d = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        x, y = brown_conrady.undistort(self._factor, self.p1, self.p2, x_d, y_d, self._max_radius)
        norm = np.sqrt(1.0 + (x * x + y * y))
        return np.stack([x / norm, y / norm, 1.0 / norm], -1)

    @property
    def _factor(self) -> brown_conrady.RadialFactor:
        return brown_conrady.polynomial(self.k1, self.k2)

    @cached_property
    def _max_radius(self) -> float:
        return radial.turning_point((self.k1, self.k2))
