"""The prior of marginalised frames as a factor: r(x) = r_0 + J (x [-] x_0)  (seed 000.3.3.1).

x [-] x_0 is (p - p_0, Log(q_0^-1 q)) for poses and extrinsics, a plain difference for speed-biases and td.  J stays
what it was when the frames were marginalised (REFERENCE G4); its derivative with respect to the tangent at the
*current* x is J times that of Log, for a rotation difference phi the inverse right Jacobian of SO(3):

    d Log(Exp(phi) Exp(d)) / d d = I + [phi]x / 2 + c [phi]x^2,   c = 1/|phi|^2 - (1 + cos|phi|) / (2 |phi| sin|phi|)
"""

from __future__ import annotations

import numpy as np

from ..geometry import so3


def difference_poses(x: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """x [-] x0 of poses (k, 7) -> (k, 6)."""
    return np.concatenate([x[:, :3] - x0[:, :3], so3.difference(x[:, 3:], x0[:, 3:])], 1)


def inverse_right_jacobian(phi: np.ndarray) -> np.ndarray:
    """(k, 3) -> (k, 3, 3), for |phi| < pi."""
    angle2 = np.sum(phi * phi, 1)[:, None, None]
    series = angle2 < 1e-4
    angle = np.sqrt(np.where(series, 1.0, angle2))
    closed = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
    c = np.where(series, 1.0 / 12.0 + angle2 / 720.0, closed)
    K = so3.skew(phi)
    return np.eye(3) + 0.5 * K + c * (K @ K)
