import numpy as np
import pytest
import synthetic_flight as flight

from vins_core.geometry import se3, so3
from vins_core.initialization import alignment, gyro_bias
from vins_core.params import Init


def visual_truth(f, scale=1.0, frame=None):
    """Camera positions (divided by the scale) and body rotations in an arbitrary frame, as vision would see them."""
    Ts = np.array([se3.from_quaternion_translation(f.motion.q(t), f.motion.position(t)) for t in f.times])
    T_x_w = np.linalg.inv(Ts[0] @ flight.T_B_C) if frame is None else frame
    cameras, bodies = T_x_w @ Ts @ flight.T_B_C, T_x_w @ Ts
    return cameras[:, :3, 3] / scale, bodies[:, :3, :3], T_x_w


def preintegrations(f):
    return [frame.imu for frame in f.history[1:]]


@pytest.mark.parametrize("seed", range(3))
def test_gyro_bias_is_what_vision_did_not_see(seed):
    b_g = np.random.default_rng(seed).normal(0, 0.05, 3)
    f = flight.fly(flight.lively(seed), seed, b_g=b_g)
    _, R, _ = visual_truth(f)
    found, imu, stage = gyro_bias.calibrate(Init(), flight.NOISE, R, preintegrations(f))
    assert stage.passed
    assert np.allclose(found, b_g, atol=1e-4)
    assert all(np.array_equal(p.b_g, found) and not p.b_a.any() for p in imu)
    assert np.abs(gyro_bias.rotation_residuals(R, imu)).max() < 1e-4


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scale", [0.2, 3.0])
def test_alignment_finds_scale_gravity_and_velocity(seed, scale):
    f = flight.fly(flight.lively(seed), seed, b_g=np.zeros(3))
    p, R, T_x_w = visual_truth(f, scale)
    solved, stage = alignment.align(Init(), flight.G, p, R, preintegrations(f), flight.T_B_C[:3, 3])
    assert stage.passed
    assert solved.scale == pytest.approx(scale, rel=5e-3)
    up = -solved.gravity / np.linalg.norm(solved.gravity)
    assert np.linalg.norm(solved.gravity) == pytest.approx(flight.G, rel=1e-3)
    assert np.rad2deg(np.arccos(up @ T_x_w[:3, 2])) < 0.1
    v = np.array([f.motion.velocity(t) for t in f.times]) @ T_x_w[:3, :3].T
    assert np.allclose(solved.v, v, atol=0.01)


def test_refined_gravity_has_the_known_size():
    f = flight.fly(flight.lively(1), 1, b_g=np.zeros(3), b_a=np.array([0.0, 0.0, 0.15]))
    p, R, T_x_w = visual_truth(f)
    args = (Init(), flight.G, p, R, preintegrations(f), flight.T_B_C[:3, 3])
    linear, _ = alignment.align(*args)
    solved, stage = alignment.refine_gravity(*args, linear)
    assert stage.passed
    assert np.linalg.norm(solved.gravity) == pytest.approx(flight.G, abs=1e-9)
    assert np.linalg.norm(linear.gravity) != pytest.approx(flight.G, abs=0.05)
    assert np.rad2deg(np.arccos(-solved.gravity @ T_x_w[:3, 2] / flight.G)) < 1.0


def test_scale_is_unobservable_at_constant_velocity():
    f = flight.fly(flight.constant_velocity(turning=True), 0, pixel_sigma=0.5, imu_noise=True, b_g=np.zeros(3))
    p, R, _ = visual_truth(f)
    noisy = p + np.random.default_rng(0).normal(0, 2e-3, p.shape)
    solved, _ = alignment.align(Init(), flight.G, noisy, R, preintegrations(f), flight.T_B_C[:3, 3])
    lively = flight.fly(flight.lively(0), 0, pixel_sigma=0.5, imu_noise=True, b_g=np.zeros(3))
    p, R, _ = visual_truth(lively)
    noisy = p + np.random.default_rng(0).normal(0, 2e-3, p.shape)
    moving, _ = alignment.align(Init(), flight.G, noisy, R, preintegrations(lively), flight.T_B_C[:3, 3])
    assert solved.scale_sigma > 10 * moving.scale_sigma


def test_imu_in_units_of_g_is_refused():
    f = flight.fly(flight.lively(0), 0, b_g=np.zeros(3), accel_unit=9.81)
    p, R, _ = visual_truth(f)
    _, stage = alignment.align(Init(), flight.G, p, R, preintegrations(f), flight.T_B_C[:3, 3])
    assert not stage.passed and "gravity comes out as" in stage.outcome and "units" in stage.outcome


def test_a_turned_camera_is_refused_by_the_gyroscope():
    f = flight.fly(flight.lively(0), 0)
    _, R, _ = visual_truth(f)
    turned = R @ so3.to_matrix(so3.exp(np.array([0.0, 0.0, np.pi / 2])))
    _, _, stage = gyro_bias.calibrate(Init(), flight.NOISE, turned, preintegrations(f))
    assert not stage.passed and "rotation between camera and IMU" in stage.outcome
    assert stage.gates[0].knob == "init.max_rotation_error_deg"
