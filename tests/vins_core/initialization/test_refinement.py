import numpy as np
import pytest
import synthetic_flight as flight

from vins_core.factors.preintegration import repropagate
from vins_core.geometry import se3, so3
from vins_core.initialization.bundle import Structure
from vins_core.initialization.refinement import Motion, bias_prior, refine
from vins_core.initialization.tracks import TrackTable

SIGMA = 1.5 / 460.0
BIAS_SIGMA = 0.2


def true_motion(f, b_a):
    """The window in the world of the truth, moved so that the oldest body is at the origin with yaw 0."""
    times = f.window_times()
    p = np.array([f.motion.position(t) for t in times])
    R = so3.to_matrix(np.array([f.motion.q(t) for t in times]))
    v = np.array([f.motion.velocity(t) for t in times])
    tracks = TrackTable.of(f.window.frames)
    return Motion(Structure(p, R, f.points[tracks.ids]), v, b_a, flight.B_G).anchored(), tracks


def solve(f, start, tracks, **changes):
    imu = [repropagate(w.imu, np.zeros(3), start.b_g, flight.NOISE) for w in f.window.frames[1:]]
    rays = tracks.observations(np.arange(len(tracks.ids)))
    return refine(start, flight.T_B_C, rays, imu, flight.G, SIGMA, **{"acc_bias_sigma": BIAS_SIGMA, **changes})


def scaled(m, s):
    structure = Structure(s * m.structure.p, m.structure.R, s * m.structure.points)
    return Motion(structure, s * m.v, m.b_a, m.b_g)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("wrong", [0.7, 1.4])
def test_a_wrong_scale_is_corrected(seed, wrong):
    f = flight.fly(flight.lively(seed), seed)
    truth, tracks = true_motion(f, np.zeros(3))
    refined = solve(f, scaled(truth, wrong), tracks)
    assert refined.converged
    assert refined.motion.extent_m == pytest.approx(truth.extent_m, rel=0.01)
    assert np.allclose(refined.motion.anchored().structure.p, truth.structure.p, atol=0.01)
    assert np.allclose(refined.motion.b_g, flight.B_G, atol=1e-3)


def test_truth_stays_where_it_is():
    f = flight.fly(flight.lively(4), 4)
    truth, tracks = true_motion(f, np.zeros(3))
    refined = solve(f, truth, tracks)
    assert refined.rms_rad < 1e-4 and refined.imu_rms < 0.1
    assert np.allclose(refined.motion.structure.p, truth.structure.p, atol=2e-3)


def test_position_and_yaw_of_the_oldest_body_stay():
    f = flight.fly(flight.lively(2), 2, pixel_sigma=0.5, imu_noise=True)
    truth, tracks = true_motion(f, np.zeros(3))
    refined = solve(f, scaled(truth, 1.2), tracks)
    s = refined.motion.structure
    assert np.allclose(s.p[0], truth.structure.p[0], atol=1e-4)
    assert so3.heading(so3.from_matrix(s.R[0])) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_scale_sigma_bounds_the_error_of_the_scale(seed):
    b_a = np.random.default_rng(seed).normal(0, 0.1, 3)
    f = flight.fly(flight.lively(seed), seed, pixel_sigma=1.0, imu_noise=True, b_a=b_a)
    truth, tracks = true_motion(f, b_a)
    refined = solve(f, scaled(truth, 1.2), tracks)
    error = abs(refined.motion.extent_m / truth.extent_m - 1)
    assert error < 3 * refined.scale_sigma < 0.3


def test_scale_is_unobservable_at_constant_velocity():
    for turning in (False, True):
        f = flight.fly(flight.constant_velocity(turning), 0, pixel_sigma=0.5, imu_noise=True)
        truth, tracks = true_motion(f, np.zeros(3))
        assert solve(f, truth, tracks).scale_sigma > 0.15
    f = flight.fly(flight.lively(0), 0, pixel_sigma=0.5, imu_noise=True)
    truth, tracks = true_motion(f, np.zeros(3))
    assert solve(f, truth, tracks).scale_sigma < 0.05


def test_a_tight_bias_prior_holds_the_bias_and_sharpens_gravity():
    f = flight.fly(flight.lively(1), 1, pixel_sigma=0.5, imu_noise=True)
    truth, tracks = true_motion(f, np.zeros(3))
    tight, loose = (solve(f, truth, tracks, acc_bias_sigma=s) for s in (0.01, 0.5))
    assert np.linalg.norm(tight.motion.b_a) < 0.02
    assert tight.gravity_sigma_deg < 0.2 * loose.gravity_sigma_deg


def test_bias_prior_is_the_cost_the_refinement_assumed():
    f = flight.fly(flight.lively(1), 1)
    truth, _ = true_motion(f, np.zeros(3))
    prior = bias_prior(17, truth, BIAS_SIGMA)
    (block,), (x0,) = prior.blocks, prior.x0
    assert (block.kind, block.id) == ("speed_bias", 17)
    b_a = np.array([0.1, -0.3, 0.2])
    r = prior.r + prior.J @ (np.concatenate([truth.v[0] + 1.0, b_a, truth.b_g + 1.0]) - x0)
    assert r @ r == pytest.approx(b_a @ b_a / BIAS_SIGMA**2)


def test_anchoring_keeps_every_relative_pose_and_gravity():
    f = flight.fly(flight.lively(3), 3)
    m, _ = true_motion(f, np.zeros(3))
    moved = m.rotated(so3.to_matrix(so3.exp(np.array([0.0, 0.0, 1.0])))).anchored()
    assert np.allclose(moved.structure.p, m.structure.p) and np.allclose(moved.structure.R, m.structure.R)
    assert np.allclose(moved.structure.points, m.structure.points) and np.allclose(moved.v, m.v)
    Ts = se3.from_rotation_translation(m.structure.R, m.structure.p)
    assert np.allclose(Ts[0, :3, 3], 0) and so3.heading(so3.from_matrix(Ts[0, :3, :3])) == pytest.approx(0, abs=1e-12)
