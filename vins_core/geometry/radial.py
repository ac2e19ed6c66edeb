"""Functions of the radius that grow from 0, above all polynomials f(r) = r (1 + c1 r^2 + c2 r^4 + ...).

A lens is described by f only while f grows: beyond its first maximum the polynomial folds back and gives pixels that
the lens never made.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial import Polynomial


def turning_point(c: Sequence[float]) -> float:
    """The smallest r > 0 at which f stops growing, infinity if it never does."""
    slope = [1.0, *((2 * i + 3) * ci for i, ci in enumerate(c))]  # in r^2, ascending
    return float(np.sqrt(first_root(Polynomial(slope))))


def first_root(polynomial: Polynomial) -> float:
    """The smallest positive real root, infinity if there is none."""
    roots = polynomial.trim().roots()
    real = roots.real[(abs(roots.imag) < 1e-9 * abs(roots)) & (roots.real > 0)]
    return float(real.min()) if len(real) else np.inf


def value_and_slope(c: Sequence[float], r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f(r) and f'(r)."""
    s = r * r
    f, slope = np.zeros_like(r), np.zeros_like(r)
    for i in range(len(c) - 1, -1, -1):
        f = (f + c[i]) * s
        slope = (slope + (2 * i + 3) * c[i]) * s
    return r * (1.0 + f), 1.0 + slope


def invert(
    value_and_slope: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], y: np.ndarray, r_max: float
) -> np.ndarray:
    """r in [0, r_max] with f(r) = y, where f grows up to r_max; NaN where there is none.

    `value_and_slope` gives f(r) and f'(r).  Newton's method inside a shrinking bracket: quadratic, and it cannot leave
    the interval.
    """
    low, high = np.zeros_like(y), np.full_like(y, r_max)
    r = np.minimum(y, r_max)
    for _ in range(60):
        f, slope = value_and_slope(r)
        error = f - y
        low, high = np.where(error < 0, r, low), np.where(error > 0, r, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = r - error / slope
        step = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        moved = np.abs(step - r)
        r = step
        if not np.any(moved > 1e-15 * (1.0 + r)):
            break
    reachable = y <= value_and_slope(np.asarray(r_max))[0]
    return np.where(reachable, r, np.nan)
