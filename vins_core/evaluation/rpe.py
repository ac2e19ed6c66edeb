"""Relative pose error: drift over a given path length, free of any alignment (Sturm et al., IROS 2012)."""

from __future__ import annotations

import numpy as np

from ..geometry import so3


def pairs_by_path(positions: np.ndarray, delta_m: float, tolerance: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Rows (i, j): for every pose i the pose j after it whose path from i comes closest to `delta_m`, the first when
    several do; left out when it misses `delta_m` by more than the share `tolerance`.  `positions` (n, 3).
    """
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    slack = tolerance * delta_m
    first = np.searchsorted(path, path + delta_m - 2 * slack)
    last = np.searchsorted(path, path + delta_m + 2 * slack, side="right")
    pairs = []
    for i in range(len(path) - 1):
        low = max(first[i], i + 1)
        if low < last[i]:
            miss = np.abs(path[low : last[i]] - path[i] - delta_m)
            best = int(np.argmin(miss))
            if miss[best] <= slack:
                pairs.append((i, low + best))
    rows = np.array(pairs, np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def translation_errors(
    p_estimate: np.ndarray,
    q_estimate: np.ndarray,
    p_truth: np.ndarray,
    q_truth: np.ndarray,
    i: np.ndarray,
    j: np.ndarray,
) -> np.ndarray:
    """(k,) metres |translation of (T_i^-1 T_j)_truth^-1 (T_i^-1 T_j)_estimate| over the pairs (i, j)."""
    moved_estimate = so3.rotate(so3.inverse(so3.normalize(q_estimate[i])), p_estimate[j] - p_estimate[i])
    moved_truth = so3.rotate(so3.inverse(so3.normalize(q_truth[i])), p_truth[j] - p_truth[i])
    return np.linalg.norm(moved_estimate - moved_truth, axis=1)
