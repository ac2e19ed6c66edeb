import numpy as np
import pytest
from factor_laws import assert_jacobian_matches_differences, random_pose, residual

from vins_core.factors.gps import ANTENNA, DRIFT
from vins_core.geometry import heading, so3


def node(p: np.ndarray, yaw: float) -> np.ndarray:
    return np.append(p, heading.about_gravity(yaw))


@pytest.mark.parametrize("seed", range(3))
def test_jacobians_match_differences(seed):
    rng = np.random.default_rng(seed)
    assert_jacobian_matches_differences(ANTENNA, [random_pose(rng)], rng.normal(size=6))
    nearby = random_pose(rng)
    turned = np.append(nearby[:3] + rng.normal(size=3), so3.retract(nearby[3:], 0.2 * rng.normal(size=3)))
    values = [nearby, rng.normal(size=1), turned, rng.normal(size=1)]
    assert_jacobian_matches_differences(DRIFT, values, rng.normal(size=7))


def test_antenna_turns_with_the_body():
    """Heading east in the odometry and north on the earth, an antenna 2 m ahead is 2 m north."""
    here = np.array([5.0, 6.0, 7.0])
    r = residual(ANTENNA, [node(here, np.pi / 2)], np.array([2.0, 0, 0, *here]))
    np.testing.assert_allclose(r, [0, 2, 0], atol=1e-12)


def test_odometry_that_is_too_short_by_its_scale_is_no_error():
    rng = np.random.default_rng(1)
    start, way, yaw, s = rng.normal(size=3), np.array([10.0, 2.0, 1.0]), 0.7, 0.03
    end = start + so3.rotate(heading.about_gravity(yaw), (1 + s) * way)
    data = np.array([*way, *way, 0.9])
    r = residual(DRIFT, [node(start, yaw), np.array([s]), node(end, yaw), np.array([0.9 * s])], data)
    np.testing.assert_allclose(r, 0, atol=1e-12)


def test_drift_does_not_see_where_on_earth_it_happens():
    rng = np.random.default_rng(2)
    i, j, data = random_pose(rng), random_pose(rng), rng.normal(size=7)
    moved = random_pose(rng)

    def elsewhere(x):
        return np.append(so3.rotate(moved[3:], x[:3]) + moved[:3], so3.multiply(moved[3:], x[3:]))

    s_i, s_j = rng.normal(size=1), rng.normal(size=1)
    here = residual(DRIFT, [i, s_i, j, s_j], data)
    np.testing.assert_allclose(residual(DRIFT, [elsewhere(i), s_i, elsewhere(j), s_j], data), here, atol=1e-12)
