"""Is a loop right?  What ground truth says of pairs of keyframes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ..evaluation.associate import nearest
from ..geometry import so3
from ..sensors import Trajectory

MAX_DT_S = 0.006
"""A keyframe and its truth are at most this far apart."""
SAME_M, SAME_DEG = 1.0, 30.0
ELSEWHERE_M, ELSEWHERE_DEG = 2.0, 60.0


class Place(StrEnum):
    SAME = "same place"
    BETWEEN = "between"
    ELSEWHERE = "elsewhere"


@dataclass(frozen=True)
class Truth:
    """How two keyframes truly lie to each other."""

    distance_m: float
    angle_deg: float

    @property
    def place(self) -> Place:
        """The same within 1 m and 30 degrees, elsewhere beyond 2 m or 60 degrees."""
        if self.distance_m <= SAME_M and self.angle_deg <= SAME_DEG:
            return Place.SAME
        apart = self.distance_m > ELSEWHERE_M or self.angle_deg > ELSEWHERE_DEG
        return Place.ELSEWHERE if apart else Place.BETWEEN


def true_poses(truth: Trajectory | None, t_ns: np.ndarray) -> np.ndarray:
    """(n, 7) p and q wxyz at each stamp; NaN where truth says nothing."""
    T = np.full((len(t_ns), 7), np.nan)
    if truth is not None:
        rows, there = nearest(t_ns, truth.t_ns, MAX_DT_S)
        T[rows, :3], T[rows, 3:] = truth.p_w_b[there], truth.q_w_b[there]
    return T


def truth_of(T: np.ndarray, query: int, match: int) -> Truth | None:
    """Of two rows of `true_poses`; None where either is unknown."""
    distance_m, angle_deg = apart(T[query], T[match])
    return Truth(float(distance_m), float(angle_deg)) if np.isfinite(distance_m) else None


def apart(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance in m and angle in degrees between poses (..., 7) and (..., 7); NaN where one of them is."""
    angle = np.linalg.norm(so3.log(so3.multiply(so3.inverse(a[..., 3:]), b[..., 3:])), axis=-1)
    return np.linalg.norm(a[..., :3] - b[..., :3], axis=-1), np.degrees(angle)


def revisited(T: np.ndarray, k: int, min_gap: int) -> bool:
    """Is keyframe k truly at the place of an earlier one, with at least `min_gap` keyframes between?"""
    distance_m, angle_deg = apart(T[: max(k - min_gap, 0)], T[k])
    return bool(np.any((distance_m <= SAME_M) & (angle_deg <= SAME_DEG)))
