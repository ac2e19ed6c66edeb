import numpy as np
import pytest

from vins_core.geometry import inverse_depth, se3, so3
from vins_core.geometry.triangulation import triangulate_pair, triangulate_tracks


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def window(rng, k=11, m=60, direction=(0.0, 0.0, 1.0)):
    """k cameras around the origin and m points 2-10 m away along `direction`."""
    T_w_c = se3.from_quaternion_translation(so3.exp(rng.normal(0, 0.1, (k, 3))), rng.normal(0, 0.3, (k, 3)))
    side = np.array(direction) * rng.uniform(2, 10, (m, 1))
    return T_w_c, side + rng.normal(0, 1.0, (m, 3))


def rays_of(T_w_c, points_w):
    return unit(se3.transform(se3.inverse(T_w_c), points_w))


def observe(rng, T_w_c, points_w, share=0.6):
    """Random visibility with at least the first two slots of each track; anchored in its first slot."""
    seen = rng.random((len(points_w), len(T_w_c))) < share
    first = rng.integers(0, len(T_w_c) - 2, len(points_w))
    rows = np.arange(len(points_w))
    seen &= np.arange(len(T_w_c)) >= first[:, None]
    seen[rows, first] = seen[rows, first + 1] = True
    track, slot = np.nonzero(seen)
    return track, slot, rays_of(T_w_c[slot], points_w[track]), first


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 0, 0.05), (0, -1, -0.4)], ids=["ahead", "sideways", "behind"])
def test_exact_rays_give_the_exact_depth_whatever_their_direction(direction):
    rng = np.random.default_rng(1)
    T_w_c, points_w = window(rng, direction=direction)
    track, slot, rays, anchor = observe(rng, T_w_c, points_w)
    points_c = se3.transform(se3.inverse(T_w_c[anchor]), points_w)
    truth = inverse_depth.depth(unit(points_c), points_c)
    depth = triangulate_tracks(T_w_c, track, slot, rays, anchor)
    np.testing.assert_allclose(depth, truth, atol=1e-8)


def test_depth_does_not_depend_on_the_order_of_observations_nor_on_where_the_world_begins():
    rng = np.random.default_rng(2)
    T_w_c, points_w = window(rng)
    track, slot, rays, anchor = observe(rng, T_w_c, points_w)
    depth = triangulate_tracks(T_w_c, track, slot, rays, anchor)
    order = rng.permutation(len(track))
    np.testing.assert_array_equal(triangulate_tracks(T_w_c, track[order], slot[order], rays[order], anchor), depth)
    T_far = se3.from_quaternion_translation(so3.exp(np.array([0.3, -2.0, 1.0])), np.array([900.0, -500.0, 40.0]))
    np.testing.assert_allclose(triangulate_tracks(T_far @ T_w_c, track, slot, rays, anchor), depth, rtol=1e-6)


def test_noise_spreads_depth_as_parallax_predicts():
    """sigma_z ~ z^2 sigma / baseline for two views; many views do better."""
    rng = np.random.default_rng(3)
    n, z, baseline, sigma = 2000, 5.0, 0.5, 1e-3
    T_w_c = np.tile(np.eye(4), (2, 1, 1))
    T_w_c[1, 0, 3] = baseline
    points = np.column_stack([rng.uniform(-2, 2, (n, 2)), np.full(n, z)])
    rays = unit(np.stack([rays_of(T, points) for T in T_w_c], 1) + rng.normal(0, sigma, (n, 2, 3)))
    track, slot = np.repeat(np.arange(n), 2), np.tile([0, 1], n)
    depth = triangulate_tracks(T_w_c, track, slot, rays.reshape(-1, 3), np.zeros(n, int))
    predicted = np.sqrt(2) * z**2 * sigma / baseline
    assert 0.8 < np.std(depth) / predicted < 1.3
    assert abs(np.mean(depth) - z) < predicted / 5


def test_a_single_observation_has_no_depth():
    rng = np.random.default_rng(4)
    T_w_c, points_w = window(rng, m=3)
    rays = rays_of(T_w_c[[0, 1, 4]], points_w[[0, 0, 2]])
    depth = triangulate_tracks(T_w_c, np.array([0, 0, 2]), np.array([0, 1, 4]), rays, np.array([0, 0, 4]))
    assert np.isfinite(depth[0]) and np.isnan(depth[1]) and np.isnan(depth[2])
    assert len(triangulate_tracks(T_w_c, np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)), np.zeros(0, int))) == 0


def test_a_point_behind_both_cameras_has_negative_depth():
    T_w_c = np.tile(np.eye(4), (2, 1, 1))
    T_w_c[1, 0, 3] = 0.5
    backwards = -rays_of(T_w_c, np.array([[1.0, 1.0, -4.0], [1.0, 1.0, -4.0]]))  # rays meet behind the cameras
    depth = triangulate_tracks(T_w_c, np.array([0, 0]), np.array([0, 1]), backwards, np.array([0]))
    np.testing.assert_allclose(depth, -4.0)


def test_a_pair_agrees_with_the_truth_and_with_tracks():
    rng = np.random.default_rng(5)
    T_w_c, points_w = window(rng, k=2)
    rays_a, rays_b = rays_of(T_w_c[0], points_w), rays_of(T_w_c[1], points_w)
    T_c_w = se3.inverse(T_w_c)
    np.testing.assert_allclose(triangulate_pair(T_c_w[0], T_c_w[1], rays_a, rays_b), points_w, atol=1e-8)
    each = [np.tile(T, (len(points_w), 1, 1)) for T in T_c_w]
    np.testing.assert_allclose(triangulate_pair(each[0], each[1], rays_a, rays_b), points_w, atol=1e-8)

    rays_a, rays_b = (unit(r + rng.normal(0, 1e-3, r.shape)) for r in (rays_a, rays_b))
    m = len(points_w)
    depth = triangulate_tracks(
        T_w_c, np.tile(np.arange(m), 2), np.repeat([0, 1], m), np.concatenate([rays_a, rays_b]), np.zeros(m, int)
    )
    pair = triangulate_pair(T_c_w[0], T_c_w[1], rays_a, rays_b)
    np.testing.assert_allclose(se3.transform(T_c_w[0], pair)[:, 2], depth, rtol=1e-9)
