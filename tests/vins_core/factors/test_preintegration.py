from dataclasses import replace

import numpy as np
import pytest
import synthetic_window as sw
from scipy.integrate import solve_ivp

from vins_core.factors.preintegration import merge, preintegrate, repropagate
from vins_core.geometry import so3
from vins_core.sensors import ImuNoise, ImuSamples

ZERO = np.zeros(3)
QUIET = ImuNoise("continuous", 2e-3, 1.7e-4, 3e-3, 2e-5)


def gyro(t):
    return np.stack([0.8 * np.sin(3 * t), 0.6 * np.cos(2 * t), 0.5 + 0 * t], -1)


def accel(t):
    return np.stack([1.5 * np.cos(4 * t), np.sin(5 * t), 9.81 + 0.5 * np.sin(2 * t)], -1)


def samples(hz: float, duration_s: float = 0.4) -> ImuSamples:
    t = np.linspace(0, duration_s, round(hz * duration_s) + 1)
    return ImuSamples(np.round(t * 1e9).astype(np.int64), gyro(t), accel(t))


def difference(a, b) -> np.ndarray:
    """(p, theta, v) of a minus b."""
    return np.concatenate([a.delta_p - b.delta_p, so3.difference(a.delta_q, b.delta_q), a.delta_v - b.delta_v])


def test_motion_converges_to_fine_numerical_integration_with_second_order():
    def motion(t, x):
        q = x[3:7] / np.linalg.norm(x[3:7])
        q_dot = 0.5 * so3.multiply(q, np.append(0.0, gyro(t)))
        return np.concatenate([x[7:], q_dot, so3.rotate(q, accel(t))])

    start = np.concatenate([ZERO, [1, 0, 0, 0], ZERO])
    fine = solve_ivp(motion, (0, 0.4), start, rtol=1e-11, atol=1e-12).y[:, -1]

    def error(hz):
        m = preintegrate(samples(hz), ZERO, ZERO, QUIET)
        turn = so3.difference(m.delta_q, so3.normalize(fine[3:7]))
        return np.linalg.norm(np.concatenate([m.delta_p - fine[:3], turn, m.delta_v - fine[7:]]))

    assert error(200) < 2e-4
    assert error(400) == pytest.approx(error(200) / 4, rel=0.05)
    assert error(800) == pytest.approx(error(400) / 4, rel=0.05)


def test_rest_measures_gravity_and_nothing_else():
    t = np.arange(41) * 5_000_000
    imu = ImuSamples(t, np.zeros((41, 3)), np.tile([0, 0, 9.81], (41, 1)))
    m = preintegrate(imu, ZERO, ZERO, QUIET)
    assert m.dt_s == pytest.approx(0.2)
    np.testing.assert_allclose(m.delta_v, [0, 0, 9.81 * 0.2], atol=1e-12)
    np.testing.assert_allclose(m.delta_p, [0, 0, 9.81 * 0.02], atol=1e-12)
    np.testing.assert_array_equal(m.delta_q, [1, 0, 0, 0])


@pytest.mark.parametrize("column", range(6))
def test_bias_jacobian_matches_differences(column):
    imu, b = samples(200), np.array([0.1, -0.2, 0.05, 0.01, 0.02, -0.01])
    h = 1e-4 * np.eye(6)[column]
    up, down = (preintegrate(imu, *np.split(b + s * h, 2), QUIET) for s in (1, -1))
    J = preintegrate(imu, *np.split(b, 2), QUIET).jacobian
    numeric = difference(up, down) / 2e-4
    # the attitude error is propagated to first order in w dt (VINS), hence the tolerance
    np.testing.assert_allclose(J[:9, column], numeric, atol=3e-3 * np.abs(numeric).max())
    np.testing.assert_array_equal(J[9:, column], np.eye(6)[column])


@pytest.mark.parametrize("kind", ["continuous", "discrete"])
def test_covariance_matches_monte_carlo(kind):
    """Continuous: white noise on every sample, shared by both intervals that touch it.  Discrete: VINS' own model."""
    rng = np.random.default_rng(0)
    hz, trials = 100.0, 1500
    imu = samples(hz, 0.3)
    dt = 1 / hz
    noise = ImuNoise("continuous", 0.02, 0.003, 0.0, 0.0)
    if kind == "discrete":  # equal sigma at both ends of an interval, independent: half the variance of shared ones
        noise = ImuNoise("discrete", 0.02 * np.sqrt(2 / dt), 0.003 * np.sqrt(2 / dt), 0.0, 0.0)
    clean = preintegrate(imu, ZERO, ZERO, noise)
    errors = []
    for _ in range(trials):
        gyro_n, accel_n = (
            rng.normal(0, 0.003 / np.sqrt(dt), (len(imu), 3)),
            rng.normal(0, 0.02 / np.sqrt(dt), (len(imu), 3)),
        )
        noisy = replace(imu, gyro_rad_s=imu.gyro_rad_s + gyro_n, accel_m_s2=imu.accel_m_s2 + accel_n)
        errors.append(difference(preintegrate(noisy, ZERO, ZERO, noise), clean))
    sampled = np.cov(np.array(errors).T)
    sigma = np.sqrt(clean.covariance.diagonal()[:9])
    np.testing.assert_allclose(np.sqrt(sampled.diagonal()), sigma, rtol=0.08)
    correlation = (sampled - clean.covariance[:9, :9]) / np.outer(sigma, sigma)
    assert np.abs(correlation).max() < 0.15


def test_continuous_covariance_does_not_depend_on_the_rate():
    slow, fast = (preintegrate(samples(hz), ZERO, ZERO, QUIET).covariance for hz in (200, 800))
    np.testing.assert_allclose(slow.diagonal(), fast.diagonal(), rtol=0.02)
    assert fast[12, 12] == pytest.approx(QUIET.gyr_w**2 * 0.4)  # a random walk over 0.4 s


def test_discrete_noise_is_used_per_sample_and_bias_walk_times_dt():
    noise = ImuNoise("discrete", 0.08, 0.004, 4e-5, 2e-6)
    P = preintegrate(samples(200), ZERO, ZERO, noise).covariance
    assert P[9, 9] == pytest.approx(80 * (4e-5 * 0.005) ** 2)
    assert P[3, 3] == pytest.approx(80 * (0.004 * 0.005) ** 2 / 2, rel=0.05)


def test_covariance_is_symmetric_and_positive_definite():
    P = preintegrate(samples(200), ZERO, ZERO, QUIET).covariance
    np.testing.assert_array_equal(P, P.T)
    assert (np.linalg.eigvalsh(P) > 0).all()


def test_merging_equals_integrating_the_whole():
    imu = samples(200)
    b_a, b_g = np.array([0.1, 0, 0]), np.array([0, 0.01, 0])
    first, second = (preintegrate(part, b_a, b_g, QUIET) for part in (imu[:31], imu[30:]))
    merged, whole = merge(first, second, QUIET), preintegrate(imu, b_a, b_g, QUIET)
    np.testing.assert_array_equal(merged.imu.t_ns, imu.t_ns)
    np.testing.assert_array_equal(merged.delta_p, whole.delta_p)
    np.testing.assert_array_equal(merged.covariance, whole.covariance)


def test_repropagation_equals_integration_with_the_new_bias():
    b_a, b_g = np.array([0.3, 0, -0.1]), np.array([0, 0.05, 0])
    again = repropagate(preintegrate(samples(200), ZERO, ZERO, QUIET), b_a, b_g, QUIET)
    direct = preintegrate(samples(200), b_a, b_g, QUIET)
    np.testing.assert_array_equal(again.delta_q, direct.delta_q)
    np.testing.assert_array_equal(again.jacobian, direct.jacobian)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_few_samples_are_enough(n):
    m = preintegrate(samples(200)[:n], ZERO, ZERO, QUIET)
    assert m.dt_s == pytest.approx(0.005 * max(n - 1, 0))
    assert np.isfinite(m.covariance).all() and np.isfinite(m.delta_p).all()
    np.testing.assert_allclose(np.linalg.norm(m.delta_q), 1)


@pytest.mark.parametrize("kind", ["continuous", "discrete"])
def test_equal_stamps_add_nothing(kind):
    noise = replace(QUIET, kind=kind)
    imu = samples(200)
    doubled = ImuSamples.concatenate([imu[:20], imu[19:]])
    a, b = (preintegrate(s, ZERO, ZERO, noise) for s in (imu, doubled))
    np.testing.assert_allclose(difference(a, b), 0, atol=1e-15)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-9, atol=1e-30)


def test_same_input_gives_the_same_bits():
    a, b = (preintegrate(samples(200), ZERO, ZERO, sw.NOISE) for _ in range(2))
    assert a.covariance.tobytes() == b.covariance.tobytes()
    assert a.jacobian.tobytes() == b.jacobian.tobytes()


def test_a_gap_between_samples_leaves_the_interval_uncertain():
    whole = samples(200)
    gappy = whole[np.r_[0:5, len(whole) - 5 : len(whole)]]
    aware = replace(QUIET, gap_s=0.05, gap_acc=2.0, gap_gyr=0.5)
    np.testing.assert_array_equal(
        preintegrate(whole, ZERO, ZERO, aware).covariance, preintegrate(whole, ZERO, ZERO, QUIET).covariance
    )
    sigma = np.sqrt(preintegrate(gappy, ZERO, ZERO, aware).covariance.diagonal())
    gap_s = np.diff(gappy.t_ns).max() * 1e-9
    np.testing.assert_allclose(sigma[6:9], 2.0 * gap_s, rtol=0.2)
    np.testing.assert_allclose(sigma[3:6], 0.5 * gap_s, rtol=0.2)
