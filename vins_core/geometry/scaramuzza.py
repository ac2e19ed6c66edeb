"""Omnidirectional camera described by a polynomial (Scaramuzza; OCamCalib, VINS `SCARAMUZZA`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.polynomial import Polynomial

from ..errors import CalibrationError
from . import radial


@dataclass(frozen=True)
class Scaramuzza:
    """With (x, y) the pixel taken back to a sensor that is square and centred, and rho = |xy| (REFERENCE C4):

        (u, v) = [[ac, ad], [ae, 1]] (x, y) + (cx, cy)
        ray    = (x, y, h(rho)) normalised,   h(rho) = -(p0 + p1 rho + p2 rho^2 + p3 rho^3 + p4 rho^4),   p0 < 0

    To project, rho is solved for; the file's inverse polynomial, which camodocal evaluates, only approximates it.
    The domain ends where the angle to the optical axis stops growing with rho, at the latest in the corners of the
    image: the polynomial was never fitted beyond.
    Source: Scaramuzza, Martinelli and Siegwart, A flexible technique for accurate omnidirectional camera calibration
    and structure from motion, ICVS 2006.
    """

    name: ClassVar[str] = "scaramuzza"

    width: int
    height: int
    p0: float
    p1: float
    p2: float
    p3: float
    p4: float
    ac: float
    ad: float
    ae: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.p0 >= 0:
            raise CalibrationError(f"camera model scaramuzza: p0={self.p0!r}; expected less than 0, as OCamCalib gives")
        if self._determinant <= 0:
            raise CalibrationError(
                f"camera model scaramuzza: ac={self.ac!r}, ad={self.ad!r}, ae={self.ae!r}; "
                "expected ac - ad ae greater than 0, about 1"
            )

    def project(self, points_c: np.ndarray) -> np.ndarray:
        X, Y, Z = np.asarray(points_c, float).T
        radius = np.hypot(X, Y)
        rho = radial.invert(self._angle, np.arctan2(radius, Z), self._max_rho)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(radius == 0, 0.0, rho / radius)
        x, y = scale * X, scale * Y
        uv = np.stack([self.ac * x + self.ad * y + self.cx, self.ae * x + y + self.cy], -1)
        inside = np.isfinite(rho) & (np.maximum(radius, np.abs(Z)) > 0)
        return np.where(inside[:, None], uv, np.nan)

    def lift(self, uv_px: np.ndarray) -> np.ndarray:
        u, v = np.asarray(uv_px, float).T
        du, dv = u - self.cx, v - self.cy
        x = (du - self.ad * dv) / self._determinant
        y = (self.ac * dv - self.ae * du) / self._determinant
        rho = np.hypot(x, y)
        rays = np.stack([x, y, self._height(rho)], -1)
        with np.errstate(invalid="ignore"):
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
            inside = rho <= self._max_rho
        return np.where(inside[:, None], rays, np.nan)

    @property
    def _determinant(self) -> float:
        return self.ac - self.ad * self.ae

    @cached_property
    def _height(self) -> Polynomial:
        return -Polynomial([self.p0, self.p1, self.p2, self.p3, self.p4])

    def _angle(self, rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle to the optical axis in rad, and its derivative (h - rho h') / (rho^2 + h^2)."""
        h, slope = self._height(rho), self._height_slope(rho)
        return np.arctan2(rho, h), (h - rho * slope) / (rho * rho + h * h)

    @cached_property
    def _height_slope(self) -> Polynomial:
        return self._height.deriv()

    @cached_property
    def _max_rho(self) -> float:
        corners = np.array([[u, v] for u in (-0.5, self.width + 0.5) for v in (-0.5, self.height + 0.5)])
        offset = corners - [self.cx, self.cy]
        to_sensor = np.array([[1.0, -self.ad], [-self.ae, self.ac]]) / self._determinant
        farthest = float(np.linalg.norm(offset @ to_sensor.T, axis=1).max())
        rho = Polynomial([0.0, 1.0])
        return min(farthest, radial.first_root(self._height - rho * self._height_slope))
