"""The depth residual: its derivative, its unit, and what it touches."""

from __future__ import annotations

import numpy as np
import pytest
from factor_laws import assert_jacobian_matches_differences, residual

from vins_core.factors.depth import DEPTH, measurement


@pytest.mark.parametrize("inv_depth", [0.1, 0.7, 3.0])
def test_its_jacobian_is_that_of_its_residual(inv_depth: float) -> None:
    data = measurement(np.array([1.7]), 0.02)[:, 0]
    assert_jacobian_matches_differences(DEPTH, [np.array([inv_depth])], data)


@pytest.mark.parametrize("depth_m", [0.4, 2.0, 9.0])
@pytest.mark.parametrize("n", [-2.5, 0.0, 1.0])
def test_a_depth_n_sigma_off_has_a_residual_of_n_at_any_distance(depth_m: float, n: float) -> None:
    data = measurement(np.array([depth_m * (1 + 0.02 * n)]), 0.02)[:, 0]
    np.testing.assert_allclose(residual(DEPTH, [np.array([1 / depth_m])], data), n, atol=1e-9)
