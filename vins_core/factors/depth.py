"""The depth residual: what a depth camera measured along z at the anchor of a landmark (docs/depth.md).

    r = (lambda z - 1) / sigma

with lambda the landmark's inverse depth, z the measured depth, and sigma its standard deviation as a share of it: with
z = (1 + sigma n) / lambda the residual is n.  It is linear in lambda, touches nothing else, and so acts on the
diagonal of the landmarks alone: J'J = (z / sigma)^2.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from .factor import Factor, vector


def _residual(values: list, data: ca.SX) -> ca.SX:
    (inv_depth,) = values
    depth_m, sqrt_info = ca.vertsplit(data)
    return sqrt_info * (depth_m * inv_depth - 1)


DEPTH = Factor("depth", (vector("inv_depth", 1),), 2, _residual)


def measurement(depth_m: np.ndarray, sigma: float) -> np.ndarray:
    """The data of the factor, one column per depth (n,), (2, n)."""
    return np.stack([depth_m, np.full(len(depth_m), 1.0 / sigma)])
