"""Binary descriptors as machine words, and their distances."""

from __future__ import annotations

import numpy as np

WORDS = 4
"""64-bit words of a 256-bit descriptor."""


def packed(descriptors: np.ndarray) -> np.ndarray:
    """(n, 32) uint8 -> (n, 4) uint64, the same bits."""
    return np.ascontiguousarray(descriptors, np.uint8).reshape(-1, 8 * WORDS).view(np.uint64)


def distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamming distances of packed descriptors that broadcast, (..., 4) and (..., 4) -> (...) uint16."""
    total = np.bitwise_count(a[..., 0] ^ b[..., 0]).astype(np.uint16)
    for word in range(1, WORDS):
        total += np.bitwise_count(a[..., word] ^ b[..., word])
    return total
