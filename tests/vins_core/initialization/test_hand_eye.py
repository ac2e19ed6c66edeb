from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import synthetic_flight as flight

from vins_core import params as parameters
from vins_core.factors.preintegration import preintegrate
from vins_core.geometry import se3, so3
from vins_core.initialization.hand_eye import MAX_PAIRS, HandEye, calibrate, mount, stage
from vins_core.initialization.rotation_pairs import camera_rotation, measure
from vins_core.params import Params

ZERO = np.zeros(3)


def mounted(seed):
    """A camera turned at random, that of the other tests, and one upside down."""
    T = flight.T_B_C.copy()
    turn = [np.zeros(3), np.array([0.0, 0.0, np.pi]), *np.random.default_rng(seed).normal(0, 1.5, (3, 3))][seed % 5]
    T[:3, :3] = so3.to_matrix(so3.exp(turn)) @ T[:3, :3]
    return T


def turned(motion, T_b_c):
    """The same motion of the camera, on a body to which it is fixed by `T_b_c`."""
    q = so3.from_matrix(T_b_c[:3, :3] @ flight.R_B_C.T)
    return flight.Motion(motion.position, lambda t: so3.log(so3.multiply(so3.exp(motion.rotation(t)), so3.inverse(q))))


def fly(motion, seed=0, T_b_c=flight.T_B_C, n=60, **others):
    others = {"pixel_sigma": 0.3, "imu_noise": True, **others}
    return flight.fly(turned(motion, T_b_c), seed, T_b_c=T_b_c, n_window=n, **others)


def run(frames, every=6, **changes):
    """Attempts after every so many frames and after the last, and the state then."""
    params = parameters.replace(Params(), {f"init.hand_eye_{k}": v for k, v in changes.items()}).init
    state, reports = HandEye(), []
    for k, (a, b) in enumerate(pairwise(frames), 2):
        if k % every and k < len(frames):
            pair = measure(params, a.observations, b.observations, b.imu, b.t_ns)
            state = HandEye(state.pairs + pair, state.R_b_c)
        else:
            state, report = calibrate(params, state, a, b)
            reports.append(report)
    return state, reports


def error_deg(R, T_b_c):
    return float(np.rad2deg(np.linalg.norm(so3.log(so3.from_matrix(R.T @ T_b_c[:3, :3])))))


def failed(report):
    return {g.name for g in report.gates if g.decides and not g.passed}


@pytest.mark.parametrize("seed", range(5))
def test_the_rotation_is_found_within_half_a_degree_however_the_camera_is_mounted(seed):
    T_b_c = mounted(seed)
    state, reports = run(fly(flight.lively(seed), seed, T_b_c).history)
    assert reports[-1].found and error_deg(state.R_b_c, T_b_c) < 0.5
    wrong = [error_deg(so3.to_matrix(r.q_b_c), T_b_c) for r in reports if r.accepted]
    assert wrong and max(wrong) < 0.5  # none on the way was
    assert stage(reports[-1]).passed


def test_the_claimed_sigma_is_true():
    worst = []
    for seed in range(3):
        _, reports = run(fly(flight.lively(seed), seed).history, every=60)
        d = so3.log(so3.from_matrix(flight.R_B_C.T @ so3.to_matrix(reports[-1].q_b_c)))
        worst.append(np.rad2deg(d) / reports[-1].sigma_deg)
    rms = np.sqrt(np.mean(np.square(worst)))
    assert 0.1 < rms < 1.5  # the floor of a pair's sigma leaves room for what synthetic rays do not have


def test_a_large_gyroscope_bias_is_found_with_it():
    b_g = np.array([0.2, -0.15, 0.3])
    state, reports = run(fly(flight.lively(0), b_g=b_g).history, every=60)
    assert error_deg(state.R_b_c, flight.T_B_C) < 0.5
    assert np.abs(reports[-1].b_g - b_g).max() < 5e-3


@pytest.mark.parametrize("td_s", [-0.03, 0.03])
def test_images_stamped_wrongly_do_not_pass_for_a_rotation(td_s):
    state, reports = run(fly(flight.lively(1), 1, td_s=td_s).history, every=60)
    assert error_deg(state.R_b_c, flight.T_B_C) < 0.5
    assert abs(reports[-1].td_s - td_s) < 3e-3
    assert "time_offset" in {g.name for g in reports[-1].gates if not g.passed}  # told, though it decides nothing


def test_a_camera_that_only_turns_is_enough():
    state, reports = run(fly(flight.pure_rotation()).history)
    assert reports[-1].found and error_deg(state.R_b_c, flight.T_B_C) < 0.5


@pytest.mark.parametrize("motion", [flight.standstill(), flight.constant_velocity()])
def test_without_turning_it_waits_and_asks_for_it(motion):
    state, reports = run(fly(motion).history)
    assert state.R_b_c is None and not any(r.accepted for r in reports)
    assert {"second_axis", "rotation_sigma"} <= failed(reports[-1])
    assert "rotate the device about two axes" in stage(reports[-1]).outcome


def test_turning_about_one_axis_is_not_enough():
    yaw = flight.Motion(flight.lively(0).position, lambda t: np.array([0.0, 0.0, 0.3]) * np.sin(2.0 * t))
    state, reports = run(fly(yaw).history)
    assert state.R_b_c is None and {"second_axis", "rotation_sigma"} <= failed(reports[-1])


def test_a_gyroscope_with_mirrored_axes_is_refused():
    frames = fly(flight.lively(2), 2).history

    def mirror(frame):
        imu = replace(frame.imu.imu, gyro_rad_s=frame.imu.imu.gyro_rad_s * [1.0, 1.0, -1.0])
        return replace(frame, imu=preintegrate(imu, ZERO, ZERO, flight.NOISE))

    state, reports = run((frames[0], *map(mirror, frames[1:])))
    assert state.R_b_c is None and failed(reports[-1]) & {"rotation_misfit", "rotation_agreement"}
    assert "check the axes" in stage(reports[-1]).outcome


def test_tracks_that_move_on_their_own_are_refused():
    rng = np.random.default_rng(0)

    def scramble(frame):
        rays = rng.normal(0, 0.2, frame.observations.rays.shape) + np.array([0.0, 0.0, 1.0])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return replace(frame, observations=replace(frame.observations, rays=rays))

    state, _ = run([scramble(f) for f in fly(flight.lively(2), 2).history])
    assert state.R_b_c is None


def test_some_frames_with_wrong_rotations_do_no_harm():
    rng = np.random.default_rng(1)
    frames = list(fly(flight.lively(3), 3).history)
    for k in rng.choice(len(frames), 4, replace=False):
        turn = so3.to_matrix(so3.exp(np.radians([3.0, -2.0, 4.0])))
        seen = frames[k].observations
        frames[k] = replace(frames[k], observations=replace(seen, rays=seen.rays @ turn.T))
    state, _ = run(frames)
    assert state.R_b_c is not None and error_deg(state.R_b_c, flight.T_B_C) < 0.5


def test_what_has_been_found_stays_when_the_device_rests():
    moving = fly(flight.lively(0), 0).history
    state, _ = run(moving, every=60)
    found = state.R_b_c
    a, b = fly(flight.standstill(), 0, n=2).history
    still = measure(Params().init, a.observations, b.observations, b.imu, b.t_ns)
    for _ in range(MAX_PAIRS):
        state = HandEye(state.pairs + still, found)
    state, report = calibrate(Params().init, state, a, b)
    assert not report.accepted and report.found and stage(report).passed
    assert np.array_equal(state.R_b_c, found) and len(state.pairs) == MAX_PAIRS


def test_the_same_frames_give_the_same_bits():
    frames = fly(flight.lively(4), 4, n=30).history
    (_, first), (_, second) = run(frames), run(frames)
    assert all(np.array_equal(x.q_b_c, y.q_b_c) and x.gates == y.gates for x, y in zip(first, second) if x.n_pairs > 3)


def test_the_gates_of_vins_alone_accept_what_ours_refuse():
    off = {"max_sigma_deg": 180, "max_misfit": 1000, "min_agreement": 0, "max_halves_deg": 180, "min_turn_deg_s": 0}
    wrong_deg = []
    for seed in range(4):
        frames = fly(flight.lively(seed), seed, n=11).history
        vins, _ = run(frames, every=60, min_singular=0, **off)
        wrong_deg.append(error_deg(vins.R_b_c, flight.T_B_C))
        ours, reports = run(frames, every=60)
        assert ours.R_b_c is None and "rotation_sigma" in failed(reports[-1])
    assert max(wrong_deg) > 0.5


def test_every_limit_has_an_existing_knob():
    _, reports = run(fly(flight.lively(0), 0, n=8).history)
    for gate in reports[-1].gates:
        assert parameters.get(Params(), gate.knob) == gate.limit


def test_cameras_are_turned_together():
    given = np.array([np.eye(4), se3.from_rotation_translation(so3.to_matrix(so3.exp([0.01, 0.02, 0.0])), [0.1, 0, 0])])
    R = flight.R_B_C
    first, second = mount(given, R)
    assert np.allclose(first[:3, :3], R) and np.allclose(first[:3, 3], 0)
    assert np.allclose(se3.inverse(first) @ second, se3.inverse(given[0]) @ given[1])
    assert mount(given, None) is given


@pytest.mark.parametrize("moving", [False, True])
def test_the_covariance_of_a_camera_rotation_is_that_of_its_errors(moving):
    rng = np.random.default_rng(5)
    points = rng.uniform([-3, -2, 2], [3, 2, 6], (120, 3))
    R, t = so3.to_matrix(so3.exp(np.array([0.03, -0.05, 0.02]))), np.array([0.1, 0.05, 0.02]) * moving
    errors, claimed = [], []
    for _ in range(60):
        a, b = points, (points - t) @ R
        rays = [x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, b)]
        rays = [r + rng.normal(0, 0.4 / 460, r.shape) for r in rays]
        rays = [r / np.linalg.norm(r, axis=1, keepdims=True) for r in rays]
        found, covariance = camera_rotation(*rays, 1.0 / 460)
        errors.append(so3.log(so3.from_matrix(found @ R.T)))
        claimed.append(np.diag(covariance))
    rms, sigma = np.sqrt(np.mean(np.square(errors))), np.sqrt(np.mean(claimed))
    assert np.rad2deg(rms) < 0.1
    assert 0.5 * rms < sigma < (1.6 * rms if moving else 20.0 * rms)
