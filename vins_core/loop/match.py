"""Which point of another keyframe looks most like this one, and how sure that is (REFERENCE 16.12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..params import Loop
from .hamming import distances, packed

SAME_PX = 8.0
"""Points this near to each other look alike because they are nearly the same: neither is the other's rival."""


@dataclass(frozen=True)
class Matches:
    """The most similar point of another keyframe for each of n points, and what speaks for it."""

    row: np.ndarray  # (n,) int32 of the other keyframe's points
    hamming: np.ndarray  # (n,) uint16
    ratio: np.ndarray  # (n,) float32, hamming over that of the most similar point elsewhere in the image
    mutual: np.ndarray  # (n,) bool, that point's most similar point is this one, or near it

    def near(self, params: Loop) -> np.ndarray:
        """(n,) bool, near enough."""
        return self.hamming <= params.max_hamming

    def distinct(self, params: Loop) -> np.ndarray:
        """(n,) bool, clearly nearer than anything else."""
        return self.ratio <= params.max_ratio

    def agreed(self, params: Loop) -> np.ndarray:
        """(n,) bool, the same from the other side."""
        return self.mutual | (not params.cross_check)


def match(
    descriptors: np.ndarray, uv_px: np.ndarray, n: int, others: np.ndarray, others_uv_px: np.ndarray
) -> Matches | None:
    """The first n of a keyframe's points against all points of another; None when either has none.

    descriptors (m, 32) uint8 with uv_px (m, 2), others (k, 32) with others_uv_px (k, 2).
    """
    if not n or not len(others):
        return None
    mine, theirs = packed(descriptors), packed(others)
    apart = distances(mine[:n, None], theirs)
    row = np.argmin(apart, axis=1)
    nearest = apart[np.arange(n), row]
    rival = np.where(_within(others_uv_px[row], others_uv_px), np.uint16(8 * 32), apart).min(1)
    back = np.argmin(distances(theirs[row, None], mine), axis=1)
    mutual = np.sum(np.square(uv_px[back] - uv_px[:n]), axis=1) <= SAME_PX**2
    ratio = np.where(rival, nearest / np.maximum(rival, 1), 1.0).astype(np.float32)
    return Matches(row.astype(np.int32), nearest, ratio, mutual)


def search(
    descriptors: np.ndarray, others: np.ndarray, near: np.ndarray, max_hamming: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The most similar point among those `near` (n, k) bool for each of n points, no two taking the same.

    descriptors (n, 32), others (k, 32).  Returns which of the n points found one, its row and its distance.
    """
    apart = np.where(near, distances(packed(descriptors)[:, None], packed(others)), np.uint16(8 * 32 + 1))
    row = np.argmin(apart, axis=1)
    hamming = apart[np.arange(len(row)), row]
    found = np.flatnonzero(hamming <= max_hamming)
    found = found[np.argsort(hamming[found], kind="stable")]
    found = np.sort(found[np.unique(row[found], return_index=True)[1]])  # of rivals the most similar
    return found, row[found].astype(np.int32), hamming[found]


def _within(a_px: np.ndarray, b_px: np.ndarray) -> np.ndarray:
    """(a, b) bool, points within SAME_PX of each other."""
    du, dv = a_px[:, None, 0] - b_px[:, 0], a_px[:, None, 1] - b_px[:, 1]
    return du * du + dv * dv <= SAME_PX**2
