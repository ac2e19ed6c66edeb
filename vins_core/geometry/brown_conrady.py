"""Brown-Conrady distortion of a plane: along the radius, and the tangential share of a lens that sits askew.

    x_d = x f(s) + 2 p1 x y + p2 (s + 2 x^2)
    y_d = y f(s) + p1 (s + 2 y^2) + 2 p2 x y,        s = x^2 + y^2

What f is, and which plane this is, differs from camera model to camera model.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

RadialFactor = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""s -> f(s) and 2 f'(s)."""


def polynomial(k1: float, k2: float) -> RadialFactor:
    """f(s) = 1 + k1 s + k2 s^2."""
    return lambda s: (1.0 + s * (k1 + k2 * s), 2.0 * (k1 + 2.0 * k2 * s))


def distort(
    factor: RadialFactor, p1: float, p2: float, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """x_d, y_d and the symmetric Jacobian [[a, b], [b, c]]."""
    s, xy = x * x + y * y, x * y
    f, slope = factor(s)
    twice_p1, twice_p2 = 2.0 * p1, 2.0 * p2
    x_d = x * f + twice_p1 * xy + p2 * (s + 2.0 * x * x)
    y_d = y * f + p1 * (s + 2.0 * y * y) + twice_p2 * xy
    a = f + slope * x * x + twice_p1 * y + 3.0 * twice_p2 * x
    b = slope * xy + twice_p1 * x + twice_p2 * y
    c = f + slope * y * y + 3.0 * twice_p1 * y + twice_p2 * x
    return x_d, y_d, a, b, c


def undistort(
    factor: RadialFactor,
    p1: float,
    p2: float,
    x_d: np.ndarray,
    y_d: np.ndarray,
    max_radius: float,
    start: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The (x, y) within `max_radius` that is distorted to (x_d, y_d), to 1e-12; NaN where there is none.

    Newton's method with the analytic Jacobian, from (x_d, y_d) unless there is a better `start`.
    """
    x, y = (x_d, y_d) if start is None else start
    with np.errstate(all="ignore"):
        for _ in range(30):
            fx, fy, a, b, c = distort(factor, p1, p2, x, y)
            ex, ey = fx - x_d, fy - y_d
            det = a * c - b * b
            dx, dy = (c * ex - b * ey) / det, (a * ey - b * ex) / det
            x, y = x - dx, y - dy
            if not np.any(np.abs(dx) + np.abs(dy) > 1e-7):  # the next step would be its square
                break
        fx, fy = distort(factor, p1, p2, x, y)[:2]
        solved = (np.abs(fx - x_d) + np.abs(fy - y_d) < 1e-12) & (x * x + y * y < max_radius**2)
    return np.where(solved, x, np.nan), np.where(solved, y, np.nan)
