import numpy as np
import pytest
from factor_laws import assert_jacobian_matches_differences, random_pose, residual

from vins_core.factors.relative_pose import FOUR_DOF, SIX_DOF, measurement_4dof, measurement_6dof
from vins_core.geometry import heading, poses, so3

ONE = np.ones(1)


def moved(T: np.ndarray, node: np.ndarray) -> np.ndarray:
    """The pose of a 4-DoF node whose odometry is at T."""
    return np.append(node[:3], so3.multiply(heading.about_gravity(node[3]), T[3:]))


def four(T_i: np.ndarray, T_j: np.ndarray, T_i_j: np.ndarray, w_p: float = 1.0, w_r: float = 1.0) -> np.ndarray:
    return measurement_4dof(T_i[None, 3:], T_j[None, 3:], T_i_j[None], w_p * ONE, w_r * ONE)[:, 0]


def six(T_i_j: np.ndarray, w_p: float = 1.0, w_r: float = 1.0) -> np.ndarray:
    return measurement_6dof(T_i_j[None], w_p * ONE, w_r * ONE)[:, 0]


@pytest.mark.parametrize("seed", range(3))
def test_four_dof_jacobian_matches_differences(seed):
    rng = np.random.default_rng(seed)
    T_i, T_j, T_i_j = (random_pose(rng) for _ in range(3))
    assert_jacobian_matches_differences(FOUR_DOF, [rng.normal(size=4), rng.normal(size=4)], four(T_i, T_j, T_i_j, 3, 2))


@pytest.mark.parametrize("seed", range(3))
def test_six_dof_jacobian_matches_differences(seed):
    rng = np.random.default_rng(seed)
    T_i, T_j, noise = random_pose(rng), random_pose(rng), 0.2 * random_pose(rng)
    measured = poses.compose(poses.between(T_i, T_j), np.append(noise[:3], so3.exp(noise[4:])))
    assert_jacobian_matches_differences(SIX_DOF, [T_i, T_j], six(measured, 3, 2))


@pytest.mark.parametrize("pitch_deg", [-90, 0, 30])
def test_both_residuals_vanish_at_the_measured_relative_pose(pitch_deg):
    rng = np.random.default_rng(7)
    mount = so3.exp(np.array([0, np.deg2rad(pitch_deg), 0]))
    T_i, T_j = (np.append(rng.normal(size=3), so3.multiply(so3.exp(rng.normal(size=3)), mount)) for _ in range(2))
    x_i, x_j = rng.normal(size=4), rng.normal(size=4)
    measured = poses.between(moved(T_i, x_i), moved(T_j, x_j))
    r = residual(FOUR_DOF, [x_i, x_j], four(T_i, T_j, measured))
    r[3] = heading.wrap(r[3])
    np.testing.assert_allclose(r, 0, atol=1e-12)
    np.testing.assert_allclose(residual(SIX_DOF, [moved(T_i, x_i), moved(T_j, x_j)], six(measured)), 0, atol=1e-12)


def test_residuals_do_not_see_where_the_pair_stands_nor_how_it_is_turned():
    rng = np.random.default_rng(3)
    T_i, T_j, measured = (random_pose(rng) for _ in range(3))
    x_i, x_j = rng.normal(size=4), rng.normal(size=4)
    turn, shift = 1.1, np.array([3.0, -2, 5])

    def elsewhere(x):
        return np.append(so3.rotate(heading.about_gravity(turn), x[:3]) + shift, x[3] + turn)

    data = four(T_i, T_j, measured)
    np.testing.assert_allclose(
        residual(FOUR_DOF, [elsewhere(x_i), elsewhere(x_j)], data), residual(FOUR_DOF, [x_i, x_j], data), atol=1e-12
    )
    anywhere = random_pose(rng)
    np.testing.assert_allclose(
        residual(SIX_DOF, [poses.compose(anywhere, T_i), poses.compose(anywhere, T_j)], six(measured)),
        residual(SIX_DOF, [T_i, T_j], six(measured)),
        atol=1e-12,
    )


def test_comparing_positions_along_the_axes_of_the_odometry_costs_the_same_as_along_those_of_the_keyframe():
    """Seed 000.4: `q(psi)^-1` or `q_i^o(psi)^-1` makes no difference."""
    rng = np.random.default_rng(4)
    T_i, T_j, measured = (random_pose(rng) for _ in range(3))
    x_i, x_j = rng.normal(size=4), rng.normal(size=4)
    in_odometry = residual(FOUR_DOF, [x_i, x_j], four(T_i, T_j, measured))[:3]
    in_body = poses.between(moved(T_i, x_i), moved(T_j, x_j))[:3] - measured[:3]
    assert np.linalg.norm(in_odometry) == pytest.approx(np.linalg.norm(in_body), rel=1e-12)


def test_weights_multiply_position_and_rotation_apart():
    rng = np.random.default_rng(5)
    T_i, T_j, measured = (random_pose(rng) for _ in range(3))
    plain, weighted = (residual(SIX_DOF, [T_i, T_j], six(measured, *w)) for w in ((1, 1), (3, 0.5)))
    np.testing.assert_allclose(weighted, plain * np.repeat([3, 0.5], 3), atol=1e-12)
