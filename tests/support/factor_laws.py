"""One check for the Jacobian of any factor (after GTSAM's factorTesting)."""

from __future__ import annotations

import numpy as np

from vins_core.factors.factor import Block, Factor
from vins_core.geometry import so3


def retract(block: Block, x: np.ndarray, d: np.ndarray) -> np.ndarray:
    """x [+] d for one row."""
    if not block.is_pose:
        return x + d
    return np.concatenate([x[:3] + d[:3], so3.retract(x[3:], d[3:])])


def residual(factor: Factor, values: list[np.ndarray], data: np.ndarray) -> np.ndarray:
    return np.array(factor.function(())(*values, data)).ravel()


def numeric_jacobian(factor: Factor, values: list[np.ndarray], data: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """Fourth-order central differences through the retraction, all blocks active."""
    columns = []
    for k, block in enumerate(factor.blocks):
        for axis in np.eye(block.tangent):

            def moved(step: float, k=k, block=block, axis=axis) -> np.ndarray:
                at = [retract(block, x, step * axis) if j == k else x for j, x in enumerate(values)]
                return residual(factor, at, data)

            columns.append((8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h))
    return np.stack(columns, 1)


def assert_jacobian_matches_differences(factor: Factor, values: list[np.ndarray], data: np.ndarray, h: float = 1e-4):
    everything = tuple(b.name for b in factor.blocks)
    system = np.array(factor.function(everything)(*values, data))
    numeric = numeric_jacobian(factor, values, data, h)
    scale = 1.0 + np.abs(numeric).max(axis=1, keepdims=True)
    np.testing.assert_allclose(system[:, :-1] / scale, numeric / scale, atol=1e-7)
    np.testing.assert_allclose(system[:, -1], residual(factor, values, data))


def random_pose(rng: np.random.Generator, spread: float = 1.0) -> np.ndarray:
    return np.concatenate([spread * rng.normal(size=3), so3.exp(rng.normal(size=3))])
