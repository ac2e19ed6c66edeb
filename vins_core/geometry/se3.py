"""Rigid transforms as 4x4 matrices: `T_a_b` maps points from b to a."""

import numpy as np

from . import so3


def from_rotation_translation(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(..., 3, 3) and (..., 3) -> (..., 4, 4)."""
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def from_quaternion_translation(q: np.ndarray, t: np.ndarray) -> np.ndarray:
    return from_rotation_translation(so3.to_matrix(q), t)


def inverse(T: np.ndarray) -> np.ndarray:
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    return from_rotation_translation(R_t, -np.einsum("...ij,...j->...i", R_t, T[..., :3, 3]))


def transform(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(..., 4, 4) applied to (..., 3)."""
    return np.einsum("...ij,...j->...i", T[..., :3, :3], points) + T[..., :3, 3]
