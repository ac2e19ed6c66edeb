import numpy as np
import pytest

from vins_core.geometry import se3, so3
from vins_core.initialization.bundle import Rays, Structure, adjust, linearize, reproject, retract

SIGMA = 1.5 / 460.0


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def world(seed=0, n_frames=5, n_points=30, T_b_c=None):
    """Bodies along a short path that see points in front of their camera, and the exact rays."""
    rng = np.random.default_rng(seed)
    T_b_c = np.eye(4) if T_b_c is None else T_b_c
    p = np.cumsum(rng.uniform(-0.2, 0.4, (n_frames, 3)), 0)
    R = so3.to_matrix(so3.exp(rng.normal(0, 0.1, (n_frames, 3))))
    in_camera = rng.uniform([-2, -2, 3], [2, 2, 7], (n_points, 3))
    points = se3.transform(se3.from_rotation_translation(R[0], p[0]) @ T_b_c, in_camera)
    structure = Structure(p, R, points)
    frame, point = np.divmod(np.arange(n_frames * n_points), n_points)
    keep = rng.random(len(frame)) < 0.8
    frame, point = frame[keep], point[keep]
    Ts_w_c = se3.from_rotation_translation(R, p) @ T_b_c
    rays = unit(se3.transform(se3.inverse(Ts_w_c)[frame], points[point]))
    return structure, Rays(frame, point, rays), T_b_c


def disturbed(structure, rng, amount=0.05):
    k, m = len(structure.p), len(structure.points)
    return retract(structure, rng.normal(0, amount, 6 * k), rng.normal(0, amount, (m, 3)))


LEVER = se3.from_quaternion_translation(so3.exp(np.array([1.2, -1.2, 1.2])), np.array([0.1, -0.05, 0.02]))


@pytest.mark.parametrize("T_b_c", [np.eye(4), LEVER])
def test_gradient_is_the_slope_of_the_robust_cost(T_b_c):
    structure, rays, T_b_c = world(1, T_b_c=T_b_c)
    structure = disturbed(structure, np.random.default_rng(0), 0.02)
    n = 6 * len(structure.p)
    equations = linearize(structure, T_b_c, rays, SIGMA, n)

    def cost(d, d_points):
        return linearize(retract(structure, d, d_points), T_b_c, rays, SIGMA, n).cost

    h, nothing = 1e-6, np.zeros((len(structure.points), 3))
    for column in range(n):
        d = h * (np.arange(n) == column)
        assert (cost(d, nothing) - cost(-d, nothing)) / (2 * h) == pytest.approx(
            equations.g[column], rel=1e-4, abs=1e-2
        )
    for k, axis in ((0, 0), (7, 1), (29, 2)):
        d = nothing.copy()
        d[k, axis] = h
        slope = (cost(np.zeros(n), d) - cost(np.zeros(n), -d)) / (2 * h)
        assert slope == pytest.approx(equations.h[k, axis], rel=1e-4, abs=1e-2)


def test_schur_complement_gives_the_step_of_the_full_system():
    structure, rays, T_b_c = world(2)
    structure = disturbed(structure, np.random.default_rng(1), 0.02)
    n, m = 6 * len(structure.p), len(structure.points)
    e = linearize(structure, T_b_c, rays, SIGMA, n)
    H = np.zeros((n + 3 * m, n + 3 * m))
    H[:n, :n], H[n:, :n] = e.H, e.W.reshape(-1, n)
    H[:n, n:] = H[n:, :n].T
    for k in range(m):
        H[n + 3 * k : n + 3 * k + 3, n + 3 * k : n + 3 * k + 3] = e.V[k]
    damping = 0.1
    full = np.linalg.solve(H + damping * np.diag(np.diag(H)), -np.concatenate([e.g, e.h.ravel()]))
    d, d_points = e.solve(damping)
    assert np.allclose(np.concatenate([d, d_points.ravel()]), full, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_exact_rays_bring_the_structure_back_up_to_scale(seed):
    truth, rays, _ = world(seed)
    start = disturbed(truth, np.random.default_rng(seed), 0.03)
    start.p[0], start.R[0] = truth.p[0], truth.R[0]
    result = adjust(start, rays, fixed_frame=0, scale_frame=4, sigma_rad=SIGMA)
    assert result.converged and result.rms_rad < 1e-7
    s = result.structure
    scale = np.linalg.norm(s.p[4] - s.p[0]) / np.linalg.norm(truth.p[4] - truth.p[0])
    assert np.allclose((s.p - s.p[0]) / scale, truth.p - truth.p[0], atol=1e-5)
    assert np.allclose(s.R, truth.R, atol=1e-5)


def test_the_gauge_is_held():
    truth, rays, _ = world(3)
    start = disturbed(truth, np.random.default_rng(3), 0.03)
    s = adjust(start, rays, fixed_frame=1, scale_frame=4, sigma_rad=SIGMA).structure
    axis = np.argmax(np.abs(start.p[4] - start.p[1]))
    assert np.array_equal(s.p[1], start.p[1]) and np.allclose(s.R[1], start.R[1], atol=1e-15)
    assert s.p[4, axis] == start.p[4, axis]


def test_a_few_wild_rays_do_not_bend_the_structure():
    truth, rays, _ = world(4, n_points=60)
    rng = np.random.default_rng(4)
    wild = rng.choice(len(rays), 8, replace=False)
    bent = rays.ray.copy()
    bent[wild] = unit(bent[wild] + rng.normal(0, 0.1, (8, 3)))
    result = adjust(truth, Rays(rays.frame, rays.point, bent), fixed_frame=0, scale_frame=4, sigma_rad=SIGMA)
    assert np.allclose(result.structure.p, truth.p, atol=2e-3)
    calm = np.setdiff1d(np.arange(len(rays)), wild)
    assert np.median(result.error_rad[calm]) < 1e-4 < result.error_rad[wild].min()


def test_residual_is_the_sine_of_the_angle_to_the_ray():
    structure, rays, T_b_c = world(5)
    moved = Rays(rays.frame, rays.point, unit(rays.ray + np.random.default_rng(0).normal(0, 0.05, rays.ray.shape)))
    r = reproject(structure, T_b_c, moved)[2]
    sine = np.linalg.norm(np.cross(moved.ray, rays.ray), axis=1)
    assert np.allclose(np.linalg.norm(r, axis=1), sine)
