"""How the odometry's world lies on the earth: heading and position from fixes along the way, whatever some of them say.

    z_k = Rz(psi) a_k + t,    a_k the antenna's way in the odometry

Every pair of fixes far enough apart proposes a heading, the bearing between the fixes less that between their a_k;
with it every fix proposes a t, of which the median is taken.  The proposal that costs least, each fix costing no more
than an outlier does, is refined on the fixes that agree.  All pairs are tried, so nothing is drawn at random.
(VINS-Fusion starts from psi = 0 and lets the graph turn, REFERENCE H6 and 23.17.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import heading

CUTOFF = 4.0
"""A fix costs at most that many standard deviations."""
DRIFT = 0.02
"""Share of the distance by which odometry may be off."""
MIN_BASELINE = 2.0
"""Standard deviations between two fixes that propose a heading."""
_REFINEMENTS = 3


@dataclass(frozen=True)
class Alignment:
    yaw_rad: float
    sigma_rad: float  # of the yaw, from the fixes' noise alone
    shift_e: np.ndarray  # (2,) t, east and north
    inlier: np.ndarray  # (m,) bool


def align(a_o: np.ndarray, z_e: np.ndarray, covariance: np.ndarray) -> Alignment | None:
    """Antenna positions (m, 3) in the odometry and as fixes, with their covariances (m, 3, 3).

    None when no two fixes are far enough apart: the odometry did not move.
    """
    if len(a_o) < 2:
        return None
    a, z = a_o[:, :2], z_e[:, :2]
    variance = 0.5 * np.trace(covariance[:, :2, :2], axis1=1, axis2=2)
    variance = variance + (DRIFT * np.linalg.norm(a - np.median(a, 0), axis=1)) ** 2
    i, j = np.triu_indices(len(a), 1)
    way_o, way_e = a[j] - a[i], z[j] - z[i]
    apart = np.sum(way_o**2, 1) > MIN_BASELINE**2 * (variance[i] + variance[j])
    if not apart.any():
        return None
    yaws = _bearing(way_e[apart]) - _bearing(way_o[apart])
    yaw, shift = _cheapest(yaws, a, z, variance)
    for _ in range(_REFINEMENTS):
        inlier = _squared(yaw, shift, a, z) < CUTOFF**2 * variance
        if inlier.sum() < 2:
            return None
        yaw, sigma, shift = _fit(a[inlier], z[inlier], 1.0 / variance[inlier])
    return Alignment(float(heading.wrap(yaw)), float(sigma), shift, inlier)


def _cheapest(yaws: np.ndarray, a: np.ndarray, z: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rest = z - np.einsum("hab,mb->hma", _rotation(yaws), a)
    shifts = np.median(rest, 1)
    squared = np.sum((rest - shifts[:, None]) ** 2, -1) / variance
    best = np.argmin(np.sum(np.minimum(squared, CUTOFF**2), 1))
    return yaws[best], shifts[best]


def _fit(a: np.ndarray, z: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted least squares: the yaw, its standard deviation and t."""
    a_mean, z_mean = np.average(a, 0, w), np.average(z, 0, w)
    da, dz = a - a_mean, z - z_mean
    yaw = np.arctan2(np.sum(w * (da[:, 0] * dz[:, 1] - da[:, 1] * dz[:, 0])), np.sum(w * np.sum(da * dz, 1)))
    sigma = 1.0 / np.sqrt(max(np.sum(w * np.sum(da**2, 1)), 1e-300))
    return yaw, sigma, z_mean - _rotation(yaw) @ a_mean


def _squared(yaw: np.ndarray, shift: np.ndarray, a: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.sum((z - a @ _rotation(yaw).T - shift) ** 2, 1)


def _rotation(yaw: np.ndarray) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def _bearing(way: np.ndarray) -> np.ndarray:
    return np.arctan2(way[:, 1], way[:, 0])
