"""Gauge directions, what is known along them, and what a prior wants of what is held: against definitions."""

from __future__ import annotations

import numpy as np
import pytest

from vins_core.geometry import so3
from vins_core.solver.layout import Variable
from vins_core.solver.problem import retract_poses
from vins_core.solver.spectrum import gauge_directions, jacobian_at, leakage, pull, spectrum

BLOCKS = (Variable("pose", 0), Variable("pose", 1), Variable("speed_bias", 1), Variable("extrinsic", 0))
SIZE = 27


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(4)


def values(rng: np.random.Generator) -> list[np.ndarray]:
    pose = [np.append(rng.normal(size=3), so3.exp(rng.normal(size=3))) for _ in range(3)]
    return [pose[0], pose[1], rng.normal(size=9), pose[2]]


def moved(x: list[np.ndarray], turn_rad: float, shift: np.ndarray) -> list[np.ndarray]:
    """The world turned about the vertical through the mean position, then shifted."""
    turn, centre = so3.exp(np.array([0.0, 0.0, turn_rad])), np.mean([x[0][:3], x[1][:3]], axis=0)
    poses = [
        np.append(centre + so3.rotate(turn, a[:3] - centre) + shift, so3.multiply(turn, a[3:])) for a in (x[0], x[1])
    ]
    return [*poses, np.append(so3.rotate(turn, x[2][:3]), x[2][3:]), x[3]]


def tangent(a: list[np.ndarray], b: list[np.ndarray]) -> np.ndarray:
    """a [-] b."""
    return np.concatenate(
        [
            p - q if len(p) == 9 else np.append(p[:3] - q[:3], so3.log(so3.multiply(so3.inverse(q[3:]), p[3:])))
            for p, q in zip(a, b)
        ]
    )


def test_gauge_directions_are_where_moving_the_world_leads(rng):
    x, h = values(rng), 1e-6
    n = gauge_directions(BLOCKS, x)
    for k, e in enumerate(np.eye(3)):
        np.testing.assert_allclose(tangent(moved(x, 0.0, h * e), x) / h, n[:, k], atol=1e-8)
    np.testing.assert_allclose(tangent(moved(x, h, np.zeros(3)), x) / h, n[:, 3], atol=1e-5)


def test_a_jacobian_moves_with_the_point_at_which_it_is_asked_for(rng):
    x0, x, J = values(rng), values(rng), rng.normal(size=(5, SIZE))
    at_x, h = jacobian_at(J, BLOCKS, x0, x), 1e-6
    for column in range(SIZE):
        d = np.zeros(SIZE)
        d[column] = h
        parts = np.split(d, [6, 12, 21])
        nudged = [retract_poses(a[None], p[None])[0] if len(p) == 6 else a + p for a, p in zip(x, parts)]
        slope = J @ (tangent(nudged, x0) - tangent(x, x0)) / h
        np.testing.assert_allclose(slope, at_x[:, column], atol=1e-4)


def test_leakage_is_the_information_about_moving_everything(rng):
    x, J, r = values(rng), rng.normal(size=(30, SIZE)), rng.normal(size=30)
    n = gauge_directions(BLOCKS, x)
    found = leakage(J, r, BLOCKS, x)
    np.testing.assert_allclose(found.information, [n[:, k] @ J.T @ J @ n[:, k] for k in range(4)])
    np.testing.assert_allclose(found.sigma, found.information**-0.5)
    for k in range(4):
        best = found.wish[k]
        assert np.linalg.norm(r + J @ n[:, k] * best) < min(
            np.linalg.norm(r + J @ n[:, k] * (best + s)) for s in (-1e-3, 1e-3)
        )


def test_a_residual_that_sees_only_differences_leaks_nothing(rng):
    x = values(rng)
    J = np.zeros((3, SIZE))
    J[:, :3], J[:, 6:9] = -np.eye(3), np.eye(3)  # p_1 - p_0
    found = leakage(J, np.ones(3), BLOCKS, x)
    np.testing.assert_array_equal(found.information[:3], 0.0)
    np.testing.assert_array_equal(found.relative[:3], 0.0)
    assert np.isinf(found.sigma[:3]).all() and np.isnan(found.wish[:3]).all()
    assert found.information[3] > 0  # the baseline points somewhere


def test_a_single_block_that_is_known_counts_as_independent(rng):
    J = np.hstack([np.eye(6), np.zeros((6, SIZE - 6))])
    np.testing.assert_allclose(leakage(J, np.zeros(6), BLOCKS, values(rng)).relative, 1.0)


@pytest.mark.parametrize("held", [[0, 1], [5], [0, 3, 7]])
def test_pull_is_what_least_squares_gives_with_and_without_the_held(rng, held):
    J, r = rng.normal(size=(14, 9)), rng.normal(size=14)
    free = np.delete(np.arange(9), held)
    stuck = np.linalg.lstsq(J[:, free], -r, rcond=None)[0]
    found = pull(J, r, np.eye(9)[:, held])
    assert found.floor == pytest.approx(0.5 * np.square(r + J[:, free] @ stuck).sum())
    np.testing.assert_allclose(found.wish, np.linalg.lstsq(J, -r, rcond=None)[0][held])
    np.testing.assert_allclose(found.sigma, np.sqrt(np.linalg.inv(J.T @ J)[held, held]))


def test_what_is_not_known_of_the_held_has_no_sigma():
    J = np.zeros((2, 4))
    J[0, 0], J[1, 1] = 2.0, 3.0
    found = pull(J, np.array([1.0, 0.0]), np.eye(4)[:, [0, 3]])
    assert found.floor == pytest.approx(0.5) and found.wish[0] == pytest.approx(-0.5)
    assert found.sigma[0] == pytest.approx(0.5) and np.isnan(found.sigma[1])


def test_the_spectrum_is_that_of_the_information(rng):
    J = rng.normal(size=(4, 6))
    found = spectrum(J, 1e-8)
    np.testing.assert_allclose(found.vectors * found.eigenvalues @ found.vectors.T, J.T @ J, atol=1e-12)
    assert found.rank == 4 and (np.diff(found.eigenvalues) >= 0).all()
    assert found.condition == pytest.approx(found.eigenvalues[-1] / found.eigenvalues[2])
    assert np.isnan(spectrum(np.zeros((2, 2)), 1e-8).condition)
