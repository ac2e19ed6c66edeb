"""Turns about gravity, the one angle of a rotation that camera and IMU cannot observe.

The turn of a rotation R that acts in a gravity-aligned world is the angle of the rotation about z nearest to it,

    turn(R) = argmax_a tr(Rz(a)' R) = atan2(R_10 - R_01, R_00 + R_11) = 2 atan2(q_z, q_w)

It is asked of *differences* of attitude, R_w_b2 R_w_b1', never of an attitude: so it has no singular mounting, where
the Euler yaw of a body means nothing near a pitch of +-90 degrees (REFERENCE 23.1).  It is undefined only for a
difference of 180 degrees about a horizontal axis.
"""

import numpy as np

from . import so3


def wrap(angle: np.ndarray) -> np.ndarray:
    """The same angle in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def turn(q: np.ndarray) -> np.ndarray:
    """Rotation (..., 4) acting in the world -> its angle about z in radians, (...)."""
    return wrap(2.0 * np.arctan2(q[..., 3], q[..., 0]))


def difference(q_w_b: np.ndarray, q_w_b0: np.ndarray) -> np.ndarray:
    """By how much a body at `q_w_b` is turned about gravity from `q_w_b0`, in radians."""
    return turn(so3.multiply(q_w_b, so3.inverse(q_w_b0)))


def about_gravity(angle: np.ndarray | float) -> np.ndarray:
    """Angle (...) -> the rotation about z as a quaternion, (..., 4)."""
    half = 0.5 * np.asarray(angle, float)
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], -1)
