"""A point seen along a ray, by one number: how the landmarks of a window are held.

    X = b(f) / lambda,      b(f) = f / s(f),      s(f) = f.z where f.z > MIN_RAY_Z, else 1

in the camera that anchors it, f the unit ray of its first observation there.  Where the ray has a place on the
normalised plane, lambda is the inverse depth along z as in VINS; beyond that, towards 90 degrees from the optical axis
and behind, it is the inverse distance.  Either way X is in front of the camera, along its ray, when lambda > 0.
"""

from __future__ import annotations

import numpy as np

MIN_RAY_Z = 0.05
"""Smallest z of a unit ray that has a place on the normalised plane, 87 degrees from the optical axis."""


def stretch(rays: np.ndarray) -> np.ndarray:
    """s(f) of unit rays (n, 3), (n, 1)."""
    z = rays[:, 2:]
    return np.where(z > MIN_RAY_Z, z, 1.0)


def bearing(rays: np.ndarray) -> np.ndarray:
    """b(f) of unit rays (n, 3), (n, 3): what one metre of depth spans."""
    return rays / stretch(rays)


def point(rays: np.ndarray, inv_depth: np.ndarray) -> np.ndarray:
    """X (n, 3) in the anchoring camera, m, of unit rays (n, 3) and lambda (n,)."""
    return rays / (stretch(rays) * inv_depth[:, None])


def depth(rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    """1 / lambda (n,) of points (n, 3) near unit rays (n, 3), both in the anchoring camera; not positive behind it."""
    return np.where(rays[:, 2] > MIN_RAY_Z, points[:, 2], np.sum(rays * points, axis=1))
