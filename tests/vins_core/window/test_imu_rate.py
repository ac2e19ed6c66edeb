import numpy as np
import pytest
import synthetic_flight as flight

from vins_core.factors.preintegration import preintegrate
from vins_core.geometry import so3
from vins_core.report import PoseEstimate
from vins_core.sensors import ImuSamples
from vins_core.window.imu_rate import carry_on, moved, moved_estimate
from vins_core.window.propagate import predict
from vins_core.window.state import Observations, WindowFrame

FALL = np.array([0.0, 0.0, -flight.G])
B_A = np.array([0.05, -0.1, 0.02])


def moving(seed=0, duration_s=0.5, rate_hz=200):
    """An estimate that is exact, and exact samples after it."""
    motion = flight.lively(seed)
    t = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    gyro = np.array([motion.rate(s) + flight.B_G for s in t])
    accel = np.array([so3.rotate(so3.inverse(motion.q(s)), motion.acceleration(s) - FALL) + B_A for s in t])
    newest = PoseEstimate(motion.position(0.0), motion.q(0.0), motion.velocity(0.0), B_A, flight.B_G)
    return motion, newest, ImuSamples((t * 1e9).round().astype(np.int64), gyro, accel)


@pytest.mark.parametrize("seed", range(3))
def test_an_exact_start_and_exact_samples_stay_on_the_path(seed):
    motion, newest, imu = moving(seed)
    states = carry_on(newest, imu, FALL)
    t = imu.t_ns * 1e-9
    assert np.array_equal(states.t_ns, imu.t_ns)
    assert np.abs(states.p_w_b - [motion.position(s) for s in t]).max() < 1e-4
    assert np.abs(so3.difference(states.q_w_b, np.array([motion.q(s) for s in t]))).max() < 1e-4
    assert np.abs(states.v_w_b - [motion.velocity(s) for s in t]).max() < 5e-4


def test_it_starts_at_the_estimate_and_ends_where_the_window_predicts_the_next_frame():
    _, newest, imu = moving()
    states = carry_on(newest, imu, FALL)
    assert np.allclose(states.p_w_b[0], newest.p_w_b, atol=0) and np.allclose(states.v_w_b[0], newest.v_w_b, atol=0)
    nothing = Observations(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 2), np.float32), np.zeros((0, 2)))
    frame = WindowFrame(0, 0, True, nothing, None, newest.p_w_b, newest.q_w_b, newest.v_w_b, newest.b_a, newest.b_g)
    p, q, v = predict(frame, preintegrate(imu, newest.b_a, newest.b_g, flight.NOISE), flight.G)
    assert np.allclose(states.p_w_b[-1], p, atol=1e-12) and np.allclose(states.v_w_b[-1], v, atol=1e-12)
    assert np.allclose(states.q_w_b[-1], q, atol=1e-12)


@pytest.mark.parametrize("tilted", [False, True])
def test_integrating_then_transforming_is_transforming_then_integrating(tilted):
    """Of the four degrees that loops correct, gravity knows nothing; with six it has to turn as well."""
    _, newest, imu = moving(1)
    turn = so3.exp(np.array([0.02, -0.03, 0.0]) * tilted + [0.0, 0.0, 1.2])
    T_g_w = np.concatenate([[3.0, -2.0, 0.5], turn])
    fall = so3.rotate(turn, FALL)
    after = moved(carry_on(newest, imu, FALL), T_g_w)
    before = carry_on(moved_estimate(newest, T_g_w), imu, fall)
    for name in ("p_w_b", "q_w_b", "v_w_b"):
        assert np.allclose(getattr(after, name), getattr(before, name), atol=1e-12)
    assert tilted or np.allclose(fall, FALL, atol=1e-12)


def test_a_frame_without_samples_stays_where_it_is():
    _, newest, imu = moving()
    states = carry_on(newest, imu[:1], FALL)
    assert len(states.t_ns) == 1 and np.array_equal(states.p_w_b[0], newest.p_w_b)
