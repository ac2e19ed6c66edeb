"""Kannala-Brandt fisheye camera (VINS `KANNALA_BRANDT`, Kalibr and OpenCV `equidistant`/`fisheye`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from . import radial


@dataclass(frozen=True)
class KannalaBrandt:
    """With theta the angle between ray and optical axis, up to and beyond 90 degrees (REFERENCE C3):

        theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
        uv      = (fx theta_d X / |XY| + cx, fy theta_d Y / |XY| + cy)

    VINS calls the coefficients k2 .. k5 and the rest mu mv u0 v0.  The domain ends where theta_d stops growing, at the
    latest at 180 degrees.  Source: Kannala and Brandt, A generic camera model and calibration method, PAMI 2006.
    """

    name: ClassVar[str] = "kannala-brandt"

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float
    k3: float
    k4: float

    def project(self, points_c: np.ndarray) -> np.ndarray:
        X, Y, Z = np.asarray(points_c, float).T
        radius = np.hypot(X, Y)
        theta = np.arctan2(radius, Z)
        theta_d = self._radius(theta)[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(radius == 0, 0.0, theta_d / radius)
        uv = np.stack([self.fx * scale * X + self.cx, self.fy * scale * Y + self.cy], -1)
        inside = (theta < self._max_theta) & (np.maximum(radius, np.abs(Z)) > 0)
        return np.where(inside[:, None], uv, np.nan)

    def lift(self, uv_px: np.ndarray) -> np.ndarray:
        u, v = np.asarray(uv_px, float).T
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        theta_d = np.hypot(x, y)
        theta = radial.invert(self._radius, theta_d, self._max_theta)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(theta_d == 0, 1.0, np.sin(theta) / theta_d)
        return np.stack([scale * x, scale * y, np.cos(theta)], -1)

    def _radius(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return radial.value_and_slope(self._k, theta)

    @property
    def _k(self) -> tuple[float, float, float, float]:
        return self.k1, self.k2, self.k3, self.k4

    @cached_property
    def _max_theta(self) -> float:
        return min(np.pi, radial.turning_point(self._k))
