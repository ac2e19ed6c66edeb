import numpy as np
import pytest

from vins_core.geometry import se3, so3
from vins_core.geometry.two_view import depths_along_rays, epipolar_angle, estimate_relative_pose

PX = 1.0 / 460.0


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def angle_deg(a, b):
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def two_views(seed, n=80, spread=(3.0, 2.0, 2.0), centre=(0.0, 0.0, 5.0)):
    """Points in front of view a, and rays of both views."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (n, 3)) * spread + centre
    q = so3.exp(rng.normal(0, 0.1, 3))
    T_a_b = se3.from_quaternion_translation(q, unit(rng.normal(size=3)) * 0.4)
    return T_a_b, points, unit(points), unit(se3.transform(se3.inverse(T_a_b), points))


def jitter(rays, sigma_rad, rng):
    return unit(rays + rng.normal(0, sigma_rad, rays.shape))


@pytest.mark.parametrize("seed", range(6))
def test_exact_rays_give_the_exact_pose(seed):
    T_a_b, _, a, b = two_views(seed)
    found = estimate_relative_pose(a, b, 1.0 * PX)
    assert found is not None and found.inlier.all() and found.in_front.all()
    assert np.linalg.norm(found.T_a_b[:3, 3]) == pytest.approx(1.0)
    assert angle_deg(found.T_a_b[:3, 3], T_a_b[:3, 3]) < 1e-3
    assert np.allclose(found.T_a_b[:3, :3], T_a_b[:3, :3], atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_outliers_are_named_and_do_no_harm(seed):
    T_a_b, _, a, b = two_views(seed, n=100)
    rng = np.random.default_rng(seed)
    a, b = jitter(a, 0.3 * PX, rng), jitter(b, 0.3 * PX, rng)
    b[:25] = jitter(b[:25], 60 * PX, rng)
    found = estimate_relative_pose(a, b, 1.0 * PX)
    assert found is not None
    assert found.inlier[25:].mean() > 0.95
    assert found.inlier[:25].mean() < 0.2  # a wrong match may lie on its epipolar line by chance
    assert angle_deg(found.T_a_b[:3, 3], T_a_b[:3, 3]) < 8.0
    assert np.rad2deg(np.linalg.norm(so3.log(so3.from_matrix(found.T_a_b[:3, :3].T @ T_a_b[:3, :3])))) < 0.6


def test_rays_behind_the_image_plane_take_part():
    T_a_b, _, a, b = two_views(0, n=200, spread=(4.0, 4.0, 4.0), centre=(0.0, 0.0, 0.0))
    behind = a[:, 2] < 0
    assert behind.sum() > 50
    found = estimate_relative_pose(a, b, 1.0 * PX)
    assert found is not None and found.in_front[behind].all()
    assert angle_deg(found.T_a_b[:3, 3], T_a_b[:3, 3]) < 1e-3


def test_too_few_rays_give_no_pose():
    _, _, a, b = two_views(0, n=7)
    assert estimate_relative_pose(a, b, 1.0 * PX) is None


def test_the_same_rays_give_the_same_bits():
    _, _, a, b = two_views(3)
    b = jitter(b, 1.0 * PX, np.random.default_rng(0))
    first, second = (estimate_relative_pose(a, b, 1.0 * PX) for _ in range(2))
    assert np.array_equal(first.T_a_b, second.T_a_b) and np.array_equal(first.inlier, second.inlier)


def test_depths_along_rays_lead_to_the_points():
    T_a_b, points, a, b = two_views(1)
    depths = depths_along_rays(T_a_b, a, b)
    assert np.allclose(depths[:, :1] * a, points)
    assert np.allclose(se3.transform(T_a_b, depths[:, 1:] * b), points)


def test_epipolar_angle_is_how_far_a_ray_left_its_epipolar_plane():
    T_a_b, _, a, b = two_views(2)
    assert epipolar_angle(T_a_b, a, b) == pytest.approx(np.zeros(len(a)), abs=1e-12)
    normal = unit(np.cross(T_a_b[:3, 3], b @ T_a_b[:3, :3].T))
    moved = np.cos(0.01) * a + np.sin(0.01) * normal
    error = epipolar_angle(T_a_b, moved, b)
    # the correction is shared between both rays: between 1/2 and all of the angle, near 1/sqrt(2) for equal depths
    assert np.all((error > 0.005) & (error <= 0.01)) and np.median(error) == pytest.approx(0.01 / np.sqrt(2), rel=0.1)
