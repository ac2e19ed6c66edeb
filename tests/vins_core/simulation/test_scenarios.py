"""Each scenario is what its declaration says."""

import dataclasses

import cv2
import numpy as np
import pytest

from vins_core.errors import ParameterError
from vins_core.geometry import se3, so3
from vins_core.geometry.two_view import epipolar_angle
from vins_core.io.messages import ImageMessage, ImuMessage, TruthMessage
from vins_core.simulation import SCENARIOS, build, simulate
from vins_core.simulation.simulate import T0_NS

NAMED = {
    "room_loop",
    "standstill",
    "pure_rotation",
    "constant_velocity",
    "image_dropout",
    "imu_gap",
    "low_texture",
    "td_offset",
    "wrong_extrinsic",
}


def seconds(t_ns: np.ndarray) -> np.ndarray:
    return (t_ns - T0_NS) * 1e-9


def test_the_named_scenarios_exist_and_say_what_happens():
    assert set(SCENARIOS) >= NAMED
    assert all(len(s.doc) > 40 and s.doc.endswith(".") for s in SCENARIOS.values())


def test_equal_seeds_give_equal_bytes_and_others_do_not():
    def recorded(seed: int) -> list[tuple]:
        return [
            (m.t_ns, m.data) if isinstance(m, ImageMessage) else (m.t_ns, m.gyro_rad_s.tobytes())
            for m in simulate("room_loop", seed, 0.5).messages()
            if not isinstance(m, TruthMessage)
        ]

    once = recorded(3)
    assert once == recorded(3)
    assert once != recorded(4)


def test_a_shorter_recording_is_the_beginning_of_a_longer_one():
    short, long = simulate("room_loop", 1, 0.4), simulate("room_loop", 1, 2.0)
    np.testing.assert_allclose(short.imu.accel_m_s2, long.imu[: len(short.imu)].accel_m_s2, atol=1e-9)
    np.testing.assert_array_equal(short.image_t_ns, long.image_t_ns[: len(short.image_t_ns)])


def test_messages_come_in_the_order_of_their_stamps_with_imu_around_every_image():
    messages = list(simulate("td_offset", 1, 0.6).messages())
    stamps = [m.t_ns for m in messages]
    assert stamps == sorted(stamps)
    images = [m.t_ns for m in messages if isinstance(m, ImageMessage)]
    imu = [m.t_ns for m in messages if isinstance(m, ImuMessage)]
    assert len(images) == 5
    assert imu[0] < images[0] and images[-1] < imu[-1]


def test_td_offset_shifts_image_stamps_and_nothing_else():
    late, plain = simulate("td_offset", 1, 0.6), simulate("room_loop", 1, 0.6)
    td_ns = round(SCENARIOS["td_offset"].td_s * 1e9)
    assert td_ns > 0
    np.testing.assert_array_equal(late.image_t_ns + td_ns, plain.image_t_ns)
    np.testing.assert_array_equal(late.image(2), plain.image(2))
    np.testing.assert_array_equal(late.imu.gyro_rad_s, plain.imu.gyro_rad_s)
    assert late.calibration.td_s == 0.0
    assert late.true_calibration.td_s == SCENARIOS["td_offset"].td_s


def test_images_are_missing_exactly_where_declared():
    simulation = simulate("image_dropout")
    t_s = seconds(simulation.image_t_ns)
    every = seconds(simulate("room_loop", 1, simulation.duration_s).image_t_ns)
    dropped = np.zeros(len(every), bool)
    for start, end in simulation.scenario.image_dropouts:
        dropped |= (every >= start - 1e-9) & (every < end - 1e-9)
    assert dropped.any()
    np.testing.assert_array_equal(t_s, every[~dropped])


def test_the_imu_is_silent_exactly_where_declared():
    simulation = simulate("imu_gap")
    t_s, period_s = seconds(simulation.imu.t_ns), 1.0 / simulation.scenario.imu.rate_hz
    holes = np.flatnonzero(np.diff(t_s) > 1.5 * period_s)
    assert len(holes) == len(simulation.scenario.imu_gaps)
    for hole, (start, end) in zip(holes, simulation.scenario.imu_gaps):
        assert t_s[hole] == pytest.approx(start - period_s)
        assert t_s[hole + 1] == pytest.approx(end)


def test_the_wrong_extrinsic_is_wrong_by_the_declared_angle():
    simulation = simulate("wrong_extrinsic", duration_s=0.4)
    believed, true = (c.cameras[0].T_b_c for c in (simulation.calibration, simulation.true_calibration))
    error = so3.log(so3.from_matrix(true[:3, :3].T @ believed[:3, :3]))
    np.testing.assert_allclose(np.degrees(error), SCENARIOS["wrong_extrinsic"].believed_rotation_error_deg, atol=1e-9)
    np.testing.assert_array_equal(believed[:3, 3], true[:3, 3])


WRONG = {"td_offset", "td_20ms", "wrong_extrinsic", "rough_extrinsics", "unknown_extrinsics"}


@pytest.mark.parametrize("name", sorted(set(SCENARIOS) - WRONG))
def test_elsewhere_the_calibration_is_right(name):
    simulation = simulate(name, duration_s=0.4)
    believed, true = simulation.calibration, simulation.true_calibration
    np.testing.assert_array_equal(believed.cameras[0].T_b_c, true.cameras[0].T_b_c)
    assert believed.td_s == true.td_s
    assert believed.cameras[0].model == true.cameras[0].model


def test_unknown_extrinsics_and_td_are_asked_for_and_not_told():
    simulation = simulate("unknown_extrinsics", duration_s=0.4)
    assert simulation.calibration.extrinsics == "unknown"
    np.testing.assert_array_equal(simulation.calibration.cameras[0].T_b_c, np.eye(4))
    assert not np.allclose(simulation.true_calibration.cameras[0].T_b_c, np.eye(4))
    late = simulate("td_20ms", duration_s=0.4)
    assert (late.calibration.estimate_td, late.calibration.td_s, late.true_calibration.td_s) == (True, 0.0, 0.020)


@pytest.mark.parametrize("name", ["kb190_camera", "mei_camera", "scaramuzza_camera", "rational_camera", "stereo"])
def test_a_twin_has_the_motion_and_the_imu_of_the_pinhole_camera(name):
    twin, plain = simulate(name, 1, 1.0), simulate("room_loop", 1, 1.0)
    np.testing.assert_array_equal(twin.imu.gyro_rad_s, plain.imu.gyro_rad_s)
    np.testing.assert_array_equal(twin.imu.accel_m_s2, plain.imu.accel_m_s2)
    np.testing.assert_array_equal(twin.image_t_ns, plain.image_t_ns)
    np.testing.assert_array_equal(twin.truth.p_w_b, plain.truth.p_w_b)
    np.testing.assert_array_equal(twin.calibration.cameras[0].T_b_c, plain.calibration.cameras[0].T_b_c)


@pytest.mark.parametrize("name", ["kb190_camera", "mei_camera", "scaramuzza_camera", "rational_camera"])
def test_through_another_lens_the_same_ray_shows_the_same_grey(name):
    """Where both cameras look, the pinhole's image is found again at the twin's pixels."""
    twin, plain = simulate(name, 1, 1.2), simulate("room_loop", 1, 1.2)
    u, v = np.meshgrid(np.arange(40, 330, 3), np.arange(30, 210, 3))
    uv = np.stack([u.ravel(), v.ravel()], -1).astype(float)
    lens = twin.calibration.cameras[0].model
    there = lens.project(plain.calibration.cameras[0].model.lift(uv))
    blurred = [cv2.GaussianBlur(s.image(7), (0, 0), 2.0).astype(np.float32) for s in (plain, twin)]
    ours = blurred[0][v.ravel(), u.ravel()]
    theirs = cv2.remap(blurred[1], *there.astype(np.float32).reshape(-1, 1, 2).transpose(2, 0, 1), cv2.INTER_LINEAR)
    assert np.isfinite(there).all()
    assert np.corrcoef(ours, theirs.ravel())[0, 1] > 0.97


def test_the_second_camera_takes_its_own_image_at_the_same_time():
    simulation, plain = simulate("stereo", 1, 0.6), simulate("room_loop", 1, 0.6)
    images = [m for m in simulation.messages() if isinstance(m, ImageMessage)]
    assert [m.topic for m in images[:4]] == ["/cam0/image_raw", "/cam1/image_raw"] * 2
    assert [m.t_ns for m in images[::2]] == [m.t_ns for m in images[1::2]]
    np.testing.assert_array_equal(simulation.image(2), plain.image(2))
    assert np.mean(simulation.image(2, 0) != simulation.image(2, 1)) > 0.5
    left, right = simulation.calibration.cameras
    assert np.linalg.norm(right.T_b_c[:3, 3] - left.T_b_c[:3, 3]) == pytest.approx(0.12, rel=1e-3)


def test_a_point_of_the_room_is_where_both_cameras_say():
    """A patch around a corner of the left image is found in the right one on its epipolar line."""
    simulation = simulate("stereo", 1, 0.6)
    left, right = (simulation.image(3, camera) for camera in (0, 1))
    a, b = simulation.calibration.cameras
    corners = cv2.goodFeaturesToTrack(left, 60, 0.05, 12)
    found, ok, _ = cv2.calcOpticalFlowPyrLK(left, right, corners, None)
    rays_a, rays_b = (c.model.lift(p[ok.ravel() > 0, 0].astype(float)) for c, p in ((a, corners), (b, found)))
    T_a_b = se3.inverse(a.T_b_c) @ b.T_b_c
    assert ok.sum() > 30 and np.median(epipolar_angle(T_a_b, rays_a, rays_b)) < 0.5 / 229


def test_depth_is_along_the_optical_axis_with_the_declared_noise():
    """Two places on one wall: points lifted by their depth lie on it."""
    simulation = simulate("depth_camera", 1, 0.6)
    sensor = simulation.scenario.depth
    assert sensor is not None and simulation.calibration.cameras[0].depth is not None
    exact = build(
        "exact", dataclasses.replace(simulation.scenario, depth=dataclasses.replace(sensor, noise=0.0)), 1, 0.6
    )
    measured, true = simulation.depth(3).astype(float), exact.depth(3).astype(float)
    both = (measured > 0) & (true > 0)
    assert 0.9 < both.mean() < 0.99
    assert np.std(measured[both] / true[both] - 1.0) == pytest.approx(sensor.noise, rel=0.05)
    camera = exact.true_calibration.cameras[0]
    v, u = np.nonzero(true)
    rays = camera.model.lift(np.stack([u, v], -1).astype(float))
    points_c = rays / rays[:, 2:] * true[v, u][:, None] * sensor.scale_m
    t_s = (exact.image_t_ns[3] - T0_NS) * 1e-9
    body = exact.motion.at(np.array([t_s]))
    T_w_c = se3.from_quaternion_translation(body.q_w_b, body.p_w_b)[0] @ camera.T_b_c
    points_w = se3.transform(T_w_c, points_c)
    room = exact.renderer.world.room
    outside = np.abs(points_w - room.centre_w_m) - room.size_m / 2
    on_a_wall = np.abs(outside.max(1)) < 0.005
    assert outside.max() < 0.005 and on_a_wall.mean() > 0.2


def test_a_rolling_shutter_begins_at_its_stamp_when_the_calibration_says_so():
    scenario = SCENARIOS["rolling_shutter_20ms"]
    simulation = simulate("rolling_shutter_20ms", 1, 1.4)
    assert simulation.calibration.cameras[0].readout_s == 0.020 == scenario.exposure.readout_s
    exact = dataclasses.replace(scenario.exposure, noise_grey=0.0)
    rolling = build("rolling", dataclasses.replace(scenario, exposure=exact), 1, 1.4)
    flat = dataclasses.replace(exact, readout_s=0.0)
    first = build("first", dataclasses.replace(scenario, exposure=flat), 1, 1.4)
    images = [s.image(9).astype(int) for s in (rolling, first)]
    assert np.abs(images[0][0] - images[1][0]).mean() < 1.0 < np.abs(images[0][-1] - images[1][-1]).mean()


def test_imu_noise_and_biases_have_their_declared_sizes():
    scenario = dataclasses.replace(SCENARIOS["standstill"], duration_s=60.0)
    simulation = build("quiet", scenario)
    noise, rate = scenario.imu.noise, scenario.imu.rate_hz
    truth = simulation.truth
    assert truth.b_g is not None and truth.b_a is not None
    measured, walking = simulation.imu[::2], 100.0
    gyro = measured.gyro_rad_s - truth.b_g
    accel = measured.accel_m_s2 - truth.b_a - [0.0, 0.0, scenario.gravity_m_s2]
    accel = accel - accel.mean(0)  # the upright body leans by the motion's angles, here none
    assert gyro.std() == pytest.approx(noise.gyr_n * np.sqrt(rate), rel=0.05)
    assert accel.std() == pytest.approx(noise.acc_n * np.sqrt(rate), rel=0.05)
    assert np.diff(truth.b_a, axis=0).std() == pytest.approx(noise.acc_w / np.sqrt(walking), rel=0.05)
    assert np.diff(truth.b_g, axis=0).std() == pytest.approx(noise.gyr_w / np.sqrt(walking), rel=0.05)
    np.testing.assert_allclose(truth.b_g[0], scenario.imu.b_g_rad_s, atol=1e-12)


def test_the_furnished_room_has_corners_everywhere_and_the_bare_one_has_not():
    def strong_corners(name: str) -> np.ndarray:
        response = cv2.cornerMinEigenVal(simulate(name, duration_s=1.2).image(5), 3)
        thirds = [column for row in np.array_split(response, 3) for column in np.array_split(row, 3, axis=1)]
        return np.array([(cell > 0.002).sum() for cell in thirds])

    rich, poor = strong_corners("room_loop"), strong_corners("low_texture")
    assert rich.min() > 20
    assert poor.sum() < 0.05 * rich.sum()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("room_lop", 1, 1.0), "room_loop"),
        (("room_loop", 1, 0.0), "duration 0 s"),
        (("room_loop", 1, 1e6), "at most 600 s"),
        (("room_loop", -1, 1.0), "seed -1"),
    ],
)
def test_what_cannot_be_simulated_is_told(arguments, told):
    with pytest.raises(ParameterError, match=told):
        simulate(*arguments)
