"""Absolute trajectory error: how far the estimate is from the truth once both share a frame."""

from __future__ import annotations

import numpy as np

from ..geometry import so3
from .align import Similarity


def position_errors(estimate: np.ndarray, truth: np.ndarray, alignment: Similarity) -> np.ndarray:
    """(n,) metres |truth - aligned estimate| of associated positions (n, 3)."""
    return np.linalg.norm(truth - alignment.apply(estimate), axis=1)


def rotation_errors(q_estimate: np.ndarray, q_truth: np.ndarray, alignment: Similarity) -> np.ndarray:
    """(n,) radians between associated orientations (n, 4), the estimate turned by the alignment of the positions."""
    aligned = so3.multiply(so3.from_matrix(alignment.R), so3.normalize(q_estimate))
    return np.linalg.norm(so3.difference(aligned, so3.normalize(q_truth)), axis=1)


def rmse(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))
