import numpy as np
import pytest
import synthetic_window as sw
from factor_laws import assert_jacobian_matches_differences, residual

from vins_core.factors.imu import ACTIVE, IMU, measurement
from vins_core.factors.preintegration import preintegrate
from vins_core.geometry import so3


def interval(seed: int = 0):
    """Two true states and the motion measured between them, without noise."""
    flight = sw.make(seed, n_frames=2, n_tracks=3, imu_noise=0.0, imu_hz=2000.0)
    a, b = flight.truth.frames
    return states(a), states(b), b.imu


def states(frame) -> list[np.ndarray]:
    return [np.append(frame.p_w_b, frame.q_w_b), np.concatenate([frame.v_w_b, frame.b_a, frame.b_g])]


@pytest.mark.parametrize("seed", range(3))
def test_jacobian_matches_differences(seed):
    rng = np.random.default_rng(seed)
    x_i, x_j, motion = interval(seed)
    x_i[1] = x_i[1] + rng.normal(0, 0.02, 9)  # off the bias of integration
    x_j[0] = np.append(x_j[0][:3] + rng.normal(0, 0.05, 3), so3.retract(x_j[0][3:], rng.normal(0, 0.02, 3)))
    data = measurement([motion], sw.GRAVITY)[:, 0]
    assert_jacobian_matches_differences(IMU, [*x_i, *x_j], data)


def test_residual_vanishes_at_the_true_states():
    x_i, x_j, motion = interval()
    r = residual(IMU, [*x_i, *x_j], measurement([motion], sw.GRAVITY)[:, 0])
    np.testing.assert_allclose(r, 0, atol=2e-7)


def test_residual_does_not_see_position_and_yaw():
    x_i, x_j, motion = interval()
    data = measurement([motion], sw.GRAVITY)[:, 0]
    turn = so3.exp(np.array([0, 0, 1.2]))

    def moved(x):
        pose, speed = x
        return [
            np.append(so3.rotate(turn, pose[:3]) + np.array([3, -2, 5]), so3.multiply(turn, pose[3:])),
            np.append(so3.rotate(turn, speed[:3]), speed[3:]),
        ]

    x_j[0][:3] += 0.1
    np.testing.assert_allclose(
        residual(IMU, [*moved(x_i), *moved(x_j)], data), residual(IMU, [*x_i, *x_j], data), atol=1e-9
    )


def test_first_order_bias_correction_equals_integrating_again():
    x_i, x_j, motion = interval()
    errors = []
    for scale in (1e-2, 1e-3):
        b_a, b_g = motion.b_a + scale * np.array([1, -2, 1]), motion.b_g + 0.1 * scale * np.array([1, 1, -2])
        x_i[1][3:] = np.append(b_a, b_g)
        again = preintegrate(motion.imu, b_a, b_g, sw.NOISE)
        rows = measurement([motion, again], sw.GRAVITY)
        corrected, exact = (residual(IMU, [*x_i, *x_j], row) for row in rows.T)
        errors.append(np.abs(corrected - exact)[:9].max())
    assert errors[0] < 1e-5
    assert errors[1] < errors[0] / 50  # what is left out is of second order


def test_whitening_is_the_square_root_of_the_information():
    *_, motion = interval()
    L_inverse = motion.whitening
    np.testing.assert_allclose(L_inverse @ motion.covariance @ L_inverse.T, np.eye(15), atol=1e-7)
    assert np.allclose(L_inverse, np.tril(L_inverse))


def test_an_interval_of_zero_length_still_has_finite_weights():
    *_, motion = interval()
    empty = preintegrate(motion.imu[:1], motion.b_a, motion.b_g, sw.NOISE)
    assert np.isfinite(empty.whitening).all()


def test_vm_batch_equals_single_evaluations():
    x_i, x_j, motion = interval()
    rng = np.random.default_rng(0)
    batch = IMU.batch(3, ACTIVE, backend="vm")
    data = measurement([motion], sw.GRAVITY)[:, 0]
    speeds = x_i[1] + rng.normal(0, 0.1, (3, 9))
    for k in range(3):
        for block, value in zip(batch.inputs, [x_i[0], speeds[k], *x_j]):
            block[:, k] = value
        batch.data[:, k] = data
    batch.evaluate()
    for k in range(3):
        alone = np.array(IMU.function(ACTIVE)(x_i[0], speeds[k], *x_j, data))
        np.testing.assert_array_equal(batch.system[:, :, k].T, alone)
