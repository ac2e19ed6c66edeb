"""The rigid or similarity transform that brings one set of points closest to another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Similarity:
    """target ~ scale * R @ source + t."""

    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,)
    scale: float = 1.0

    def apply(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) source points in the target's frame."""
        return self.scale * points @ self.R.T + self.t


def align(source: np.ndarray, target: np.ndarray, with_scale: bool = False) -> Similarity:
    """Minimises sum |target - (scale R source + t)|^2 over (n, 3) points (Umeyama, PAMI 1991, eq. 40-43).

    With C = U D V' the covariance of target and source, R = U S V' and scale = tr(D S) / var(source), where S is the
    identity except for a last entry of -1 when det(U V') < 0.  The scale is NaN when all source points coincide.
    Points on a line leave R free to turn about it: see `spans_a_plane`.
    """
    mean_s, mean_t = source.mean(0), target.mean(0)
    U, D, Vt = np.linalg.svd((target - mean_t).T @ (source - mean_s) / len(source))
    S = np.array([1.0, 1.0, -1.0 if np.linalg.det(U) * np.linalg.det(Vt) < 0 else 1.0])
    R = (U * S) @ Vt
    scale = 1.0
    if with_scale:
        variance = float(np.sum((source - mean_s) ** 2) / len(source))
        scale = float(D @ S / variance) if variance > 0 else float("nan")
    return Similarity(R, mean_t - scale * R @ mean_s, scale)


def spans_a_plane(source: np.ndarray, target: np.ndarray) -> bool:
    """Whether the points determine the rotation between them: neither set lies on one line."""
    return all(np.linalg.matrix_rank(points - points.mean(0), tol=1e-6) >= 2 for points in (source, target))
