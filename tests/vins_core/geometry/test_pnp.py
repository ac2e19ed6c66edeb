import numpy as np
import pytest

from vins_core.geometry import se3, so3
from vins_core.geometry.pnp import solve_pnp, tangent_basis

PX = 1.0 / 460.0


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def scene(seed, n=60, surround=False):
    rng = np.random.default_rng(seed)
    T_w_c = se3.from_quaternion_translation(so3.exp(rng.normal(0, 0.5, 3)), rng.normal(0, 1, 3))
    local = rng.uniform([-3, -2, 3], [3, 2, 8], (n, 3)) if not surround else 5 * unit(rng.normal(size=(n, 3)))
    return T_w_c, se3.transform(T_w_c, local), unit(local), rng


def errors(T, T_true):
    rotation = np.linalg.norm(so3.log(so3.from_matrix(T[:3, :3].T @ T_true[:3, :3])))
    return np.rad2deg(rotation), np.linalg.norm(T[:3, 3] - T_true[:3, 3])


@pytest.mark.parametrize("seed", range(5))
def test_exact_rays_give_the_exact_pose_from_a_rough_guess(seed):
    T_w_c, points, rays, rng = scene(seed)
    guess = T_w_c @ se3.from_quaternion_translation(so3.exp(rng.normal(0, 0.15, 3)), rng.normal(0, 0.5, 3))
    found = solve_pnp(points, rays, guess, 3 * PX)
    assert found is not None and found.inlier.all() and found.rms_rad < 1e-8
    assert np.allclose(found.T_w_c, T_w_c, atol=1e-6)


def test_a_guess_that_looks_the_other_way_is_replaced():
    T_w_c, points, rays, _ = scene(1)
    turned = T_w_c @ se3.from_quaternion_translation(so3.exp(np.array([0.0, 3.0, 0.0])), np.array([5.0, 0.0, 0.0]))
    found = solve_pnp(points, rays, turned, 3 * PX)
    assert found is not None and np.allclose(found.T_w_c, T_w_c, atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_outliers_are_named_and_do_no_harm(seed):
    T_w_c, points, rays, rng = scene(seed)
    rays = unit(rays + rng.normal(0, 0.5 * PX, rays.shape))
    rays[:15] = unit(rays[:15] + rng.normal(0, 60 * PX, (15, 3)))
    found = solve_pnp(points, rays, T_w_c, 3 * PX)
    assert found is not None
    assert found.inlier[15:].all() and found.inlier[:15].mean() < 0.4
    rotation_deg, distance = errors(found.T_w_c, T_w_c)
    assert rotation_deg < 0.3 and distance < 0.03


def test_points_all_around_the_camera_place_it():
    T_w_c, points, rays, rng = scene(2, surround=True)
    guess = T_w_c @ se3.from_quaternion_translation(so3.exp(rng.normal(0, 0.1, 3)), rng.normal(0, 0.2, 3))
    found = solve_pnp(points, rays, guess, 3 * PX)
    assert found is not None and np.allclose(found.T_w_c, T_w_c, atol=1e-6)


def test_a_point_opposite_to_its_ray_is_no_inlier():
    T_w_c, points, rays, _ = scene(3)
    rays = rays.copy()
    rays[0] = -rays[0]
    found = solve_pnp(points, rays, T_w_c, 3 * PX)
    assert found is not None and not found.inlier[0] and found.inlier[1:].all()


def test_points_that_fit_no_pose_have_few_inliers():
    _, points, _, rng = scene(4)
    rays = unit(rng.normal(size=points.shape))
    assert solve_pnp(points, rays, np.eye(4), 1 * PX).n_inliers < 10


def test_too_few_points_give_none():
    T_w_c, points, rays, _ = scene(0, n=5)
    assert solve_pnp(points, rays, T_w_c, 3 * PX) is None


def test_tangent_bases_are_orthonormal_everywhere():
    rays = unit(np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(50, 3))]))
    frames = np.concatenate([rays[:, :, None], tangent_basis(rays)], -1)
    assert np.allclose(np.swapaxes(frames, 1, 2) @ frames, np.eye(3), atol=1e-12)
