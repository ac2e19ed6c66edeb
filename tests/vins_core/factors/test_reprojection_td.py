"""The visual residual with the time offset as a variable."""

from __future__ import annotations

import numpy as np
import pytest
from factor_laws import assert_jacobian_matches_differences, random_pose, residual

from vins_core.factors.reprojection import KINDS, TIMED, measurement, motion
from vins_core.geometry import so3

FORMS, SQRT_INFO, TD_0 = ("plane", "sphere"), 460 / 1.5, 0.004


def values(kind: str, rng: np.random.Generator) -> list[np.ndarray]:
    pose = random_pose(rng)
    near = np.concatenate([pose[:3] + rng.normal(0, 0.2, 3), so3.retract(pose[3:], rng.normal(0, 0.1, 3))])
    extrinsic, other = random_pose(rng, 0.1), random_pose(rng, 0.1)
    cameras = {"mono": [pose, near, extrinsic], "cross": [pose, near, extrinsic, other], "same": [extrinsic, other]}
    return [*cameras[kind], np.array([0.011]), np.array([0.3])]


def seen(rng: np.random.Generator, z: float = 1.0) -> tuple[np.ndarray, ...]:
    """Unit rays (1, 3) and velocities (1, 2) in both cameras; the anchor's ray has a z of the sign given."""
    rays_i, rays_j = (np.array([[*rng.uniform(-0.4, 0.4, 2), side]]) for side in (z, 1.0))
    unit = [rays / np.linalg.norm(rays) for rays in (rays_i, rays_j)]
    return (*unit, rng.normal(size=(1, 2)), rng.normal(size=(1, 2)))


def data(form: str, rays_i, rays_j, velocity_i, velocity_j) -> np.ndarray:
    held = measurement(form, rays_i, rays_j, SQRT_INFO)
    return np.concatenate([held, motion(form, rays_i, rays_j, velocity_i, velocity_j, TD_0, SQRT_INFO)])[:, 0]


@pytest.mark.parametrize("z", [1.0, -0.3])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", list(TIMED))
def test_jacobian_matches_differences(kind: str, form: str, z: float) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        x = values(kind, rng)
        assert_jacobian_matches_differences(TIMED[kind][form], x, data(form, *seen(rng, z)))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", list(TIMED))
def test_at_the_offset_of_its_rays_it_is_the_residual_without_td(kind: str, form: str) -> None:
    rng = np.random.default_rng(4)
    x, measured = values(kind, rng), seen(rng)
    x[-2] = np.array([TD_0])
    held = residual(KINDS[kind][form], [*x[:-2], x[-1]], measurement(form, *measured[:2], SQRT_INFO)[:, 0])
    np.testing.assert_allclose(residual(TIMED[kind][form], x, data(form, *measured)), held, rtol=1e-12)


def moved(rays: np.ndarray, velocity: np.ndarray, late_s: float) -> np.ndarray:
    """Where the rays were `late_s` earlier, point by point on the plane."""
    xy = rays[:, :2] / rays[:, 2:] - late_s * velocity
    back = np.column_stack([xy, np.ones(len(xy))]) * np.sign(rays[:, 2:])
    return back / np.linalg.norm(back, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", list(TIMED))
def test_it_sees_the_rays_as_they_were_at_the_time_of_the_poses(kind: str) -> None:
    rng = np.random.default_rng(5)
    x, (rays_i, rays_j, velocity_i, velocity_j) = values(kind, rng), seen(rng)
    x[-2] = np.array([TD_0 + 0.02])
    timed = residual(TIMED[kind]["plane"], x, data("plane", rays_i, rays_j, velocity_i, velocity_j))
    then = measurement("plane", moved(rays_i, velocity_i, 0.02), moved(rays_j, velocity_j, 0.02), SQRT_INFO)[:, 0]
    np.testing.assert_allclose(timed, residual(KINDS[kind]["plane"], [*x[:-2], x[-1]], then), rtol=1e-9)


@pytest.mark.parametrize("z", [1.0, -0.3])
def test_on_the_sphere_it_does_so_of_first_order_in_the_time(z: float) -> None:
    """A camera that stands still sees a point where its ray was: half the time leaves a quarter of the residual."""
    (ray, _, velocity, _), pose = seen(np.random.default_rng(6), z), random_pose(np.random.default_rng(7))
    x = [pose, pose, random_pose(np.random.default_rng(8)), np.array([0.0]), np.array([0.4])]
    errors = []
    for late_s in (0.01, 0.02):
        x[-2] = np.array([TD_0 + late_s])
        gone = data("sphere", ray, moved(ray, velocity, late_s), velocity, np.zeros((1, 2)))
        errors.append(np.abs(residual(TIMED["mono"]["sphere"], x, gone)).max())
    assert errors[1] < 0.1 * 0.02 * np.abs(velocity).max() * SQRT_INFO
    assert errors[0] < 0.3 * errors[1] + 1e-9
