"""Unified omnidirectional camera with radial-tangential distortion (Mei; VINS `MEI`, Kalibr `omni`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..errors import CalibrationError
from . import brown_conrady, radial


@dataclass(frozen=True)
class Mei:
    """The point goes onto the unit sphere and is seen from xi behind its centre (REFERENCE C2):

        (x, y) = (X, Y) / (Z + xi |XYZ|),  distorted as by `brown_conrady` with k1, k2, p1, p2
        uv     = (fx x_d + cx, fy y_d + cy)

    and back, with s = x^2 + y^2 and eta = (xi + sqrt(1 + (1 - xi^2) s)) / (1 + s), the ray is (eta x, eta y, eta - xi).
    VINS calls fx fy cx cy gamma1 gamma2 u0 v0.  The domain ends where |xy| stops growing with the angle to the optical
    axis, at cos = -xi, or -1/xi where xi > 1, or where the distortion folds back.  xi = 0 is a pinhole, xi = 1 a
    parabolic mirror.  Source: Mei and Rives, Single view point omnidirectional camera calibration, ICRA 2007.
    """

    name: ClassVar[str] = "mei"

    width: int
    height: int
    xi: float
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float

    def __post_init__(self) -> None:
        if self.xi < 0:
            raise CalibrationError(f"camera model mei: xi={self.xi!r}; expected 0 (a pinhole) or more")

    def project(self, points_c: np.ndarray) -> np.ndarray:
        X, Y, Z = np.asarray(points_c, float).T
        distance = np.sqrt(X * X + Y * Y + Z * Z)
        with np.errstate(all="ignore"):
            below = Z + self.xi * distance
            x, y = X / below, Y / below
            x_d, y_d = brown_conrady.distort(self._factor, self.p1, self.p2, x, y)[:2]
            cosine = Z / distance
            inside = (cosine > -min(self.xi, 1.0 / self.xi if self.xi else 0.0)) & (x * x + y * y < self._max_radius**2)
        uv = np.stack([self.fx * x_d + self.cx, self.fy * y_d + self.cy], -1)
        return np.where(inside[:, None], uv, np.nan)

    def lift(self, uv_px: np.ndarray) -> np.ndarray:
        u, v = np.asarray(uv_px, float).T
        x_d, y_d = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        x, y = brown_conrady.undistort(self._factor, self.p1, self.p2, x_d, y_d, self._max_radius)
        s = x * x + y * y
        with np.errstate(invalid="ignore"):
            root = np.sqrt(1.0 + (1.0 - self.xi**2) * s)
        eta = (self.xi + root) / (1.0 + s)
        return np.stack([eta * x, eta * y, (root - self.xi * s) / (1.0 + s)], -1)  # eta - xi without its cancellation

    @property
    def _factor(self) -> brown_conrady.RadialFactor:
        return brown_conrady.polynomial(self.k1, self.k2)

    @cached_property
    def _max_radius(self) -> float:
        """On the plane seen from xi behind; beyond 1 / sqrt(xi^2 - 1) no line meets the sphere."""
        mirror = 1.0 / np.sqrt(self.xi**2 - 1.0) if self.xi > 1 else np.inf
        return min(mirror, radial.turning_point((self.k1, self.k2)))
