"""The simulated motion is exact: its derivatives belong together and an ideal IMU leads back to it."""

import numpy as np
import pytest

from vins_core.geometry import so3
from vins_core.simulation.scenarios import SCENARIOS
from vins_core.simulation.simulate import build
from vins_core.simulation.trajectory import Motion

DURATION_S = 3.0
GRAVITY = 9.81


def motion_of(name: str) -> Motion:
    scenario = SCENARIOS[name]
    return Motion.from_channels(scenario.motion(scenario.rig), DURATION_S, scenario.rig.q_f_b)


@pytest.mark.parametrize("name", ["room_loop", "pure_rotation", "constant_velocity", "fisheye"])
def test_integrating_an_ideal_imu_reproduces_the_motion(name):
    step_s = 1e-3
    t_s = np.arange(0.0, DURATION_S, step_s)
    exact = motion_of(name).at(t_s)
    force = exact.specific_force_m_s2(GRAVITY)
    p, v, q = exact.p_w_b[0], exact.v_w_b[0], exact.q_w_b[0]
    for k in range(len(t_s) - 1):
        turned = so3.retract(q, 0.5 * (exact.omega_b_rad_s[k] + exact.omega_b_rad_s[k + 1]) * step_s)
        a = 0.5 * (so3.rotate(q, force[k]) + so3.rotate(turned, force[k + 1])) - [0.0, 0.0, GRAVITY]
        p, v, q = p + v * step_s + 0.5 * a * step_s**2, v + a * step_s, turned
    assert np.linalg.norm(p - exact.p_w_b[-1]) < 5e-6
    assert np.linalg.norm(v - exact.v_w_b[-1]) < 5e-6
    assert np.linalg.norm(so3.difference(q, exact.q_w_b[-1])) < 2e-6


def test_velocity_acceleration_and_angular_velocity_are_the_derivatives():
    motion, t_s, h = motion_of("room_loop"), np.linspace(0.5, 2.5, 101), 1e-4
    now, before, after = motion.at(t_s), motion.at(t_s - h), motion.at(t_s + h)
    np.testing.assert_allclose((after.p_w_b - before.p_w_b) / (2 * h), now.v_w_b, atol=1e-5)
    np.testing.assert_allclose((after.v_w_b - before.v_w_b) / (2 * h), now.a_w_b, atol=1e-4)
    np.testing.assert_allclose(so3.difference(after.q_w_b, before.q_w_b) / (2 * h), now.omega_b_rad_s, atol=1e-5)


def test_at_rest_the_accelerometer_measures_gravity_upwards():
    still = build("standstill", SCENARIOS["standstill"], duration_s=1.0)
    body = still.motion.at(np.linspace(0.0, 1.0, 11))
    up = so3.rotate(body.q_w_b, body.specific_force_m_s2(GRAVITY))
    np.testing.assert_allclose(up, np.tile([0.0, 0.0, GRAVITY], (11, 1)), atol=1e-6)
    np.testing.assert_allclose(body.omega_b_rad_s, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["room_loop", "pure_rotation"])
def test_it_starts_at_rest(name):
    start = motion_of(name).at(np.linspace(0.0, 0.45, 10))
    assert np.abs(start.v_w_b).max() < 1e-4
    assert np.abs(start.a_w_b).max() < 1e-3
    assert np.abs(start.omega_b_rad_s).max() < 1e-4


def test_the_loop_initialises_on_lively_motion_and_returns_to_its_start():
    scenario = SCENARIOS["room_loop"]
    motion = Motion.from_channels(scenario.motion(scenario.rig), scenario.duration_s, scenario.rig.q_f_b)
    early = motion.at(np.linspace(0.5, 2.0, 100))
    assert 1.0 < np.linalg.norm(early.a_w_b, axis=1).mean() < 3.0
    t_s = np.arange(0.0, scenario.duration_s, 0.1)
    away = np.linalg.norm(motion.at(t_s).p_w_b - motion.at(np.array([0.0])).p_w_b, axis=1)
    assert away[(t_s > 8) & (t_s < 14)].min() > 3.0
    assert away[t_s > 18].min() < 0.3


def test_pure_rotation_leaves_the_camera_in_its_place():
    scenario = SCENARIOS["pure_rotation"]
    body = motion_of("pure_rotation").at(np.linspace(0.0, DURATION_S, 200))
    centre = body.p_w_b + so3.rotate(body.q_w_b, scenario.rig.T_b_c[:3, 3])
    assert np.ptp(centre, axis=0).max() < 1e-6
    assert np.abs(body.omega_b_rad_s).max() > 0.3


def test_constant_velocity_has_no_acceleration_and_no_rotation_at_first():
    body = motion_of("constant_velocity").at(np.linspace(0.0, DURATION_S, 200))
    assert np.linalg.norm(body.v_w_b[0]) > 0.3
    assert np.abs(body.a_w_b).max() < 1e-6
    assert np.abs(body.omega_b_rad_s).max() < 1e-6
