"""Rigid transforms as rows (p, q wxyz) of seven numbers: `T_a_b` maps points from b to a.  Batch over leading axes."""

import numpy as np

from . import so3

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
IDENTITY.setflags(write=False)


def compose(T_a_b: np.ndarray, T_b_c: np.ndarray) -> np.ndarray:
    """T_a_c, (..., 7)."""
    p = T_a_b[..., :3] + so3.rotate(T_a_b[..., 3:], T_b_c[..., :3])
    return np.concatenate([p, so3.normalize(so3.multiply(T_a_b[..., 3:], T_b_c[..., 3:]))], -1)


def inverse(T_a_b: np.ndarray) -> np.ndarray:
    """T_b_a, (..., 7)."""
    q = so3.inverse(T_a_b[..., 3:])
    return np.concatenate([-so3.rotate(q, T_a_b[..., :3]), q], -1)


def between(T_w_a: np.ndarray, T_w_b: np.ndarray) -> np.ndarray:
    """T_a_b, (..., 7)."""
    return compose(inverse(T_w_a), T_w_b)


def correction(T_u_b: np.ndarray, T_v_b: np.ndarray) -> np.ndarray:
    """T_u_v, by which frame v must be moved for a body at `T_v_b` to come to `T_u_b`, (..., 7)."""
    return compose(T_u_b, inverse(T_v_b))
