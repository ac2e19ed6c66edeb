import dataclasses

import numpy as np
import pytest
from plane_world import CAMERA, PARAMS, STEP_NS, film, move, ref, start

from vins_core.frontend.predict import turn_between, turn_pixels
from vins_core.frontend.step import track
from vins_core.geometry import se3, so3
from vins_core.sensors import ImuSamples, Packet

ALONE, RESCUE, ALWAYS = (dataclasses.replace(PARAMS, predict=mode) for mode in ("off", "rescue", "always"))


def imu(rate, start_ns, end_ns, period_ns=5_000_000):
    """Gyroscope samples of rate(t_s) (3,) with one at each end."""
    t_ns = np.unique(np.append(np.arange(start_ns, end_ns, period_ns), end_ns))
    gyro = np.array([rate(t * 1e-9) for t in t_ns])
    return ImuSamples(t_ns, gyro, np.zeros_like(gyro))


def turning(n, w_per_image, camera=CAMERA, td_ns=0, gyro_error=1.0):
    """Frames of one image of a camera that turns fast, with the gyroscope of a body mounted as `camera` says."""
    images, Hs = film(n, velocity=(0, 0, 0), turn=w_per_image)
    w_b = camera.T_b_c[:3, :3] @ np.array(w_per_image) / (STEP_NS * 1e-9) * gyro_error
    packets = [
        Packet(k, (ref(k),), imu(lambda t: w_b, max(k - 1, 0) * STEP_NS + td_ns, k * STEP_NS + td_ns)) for k in range(n)
    ]
    return images, Hs, packets


def survivors(images, packets, params, camera=CAMERA):
    """Share of tracks that each frame finds again."""
    state, shares = start(), []
    for p in packets:
        n = len(state.ids)
        state, _, report = track(params, camera, images, state, p)
        if n:
            shares.append((report.age > 1).sum() / n)
    return np.array(shares)


def test_a_constant_rate_turns_by_rate_times_time():
    w = np.array([0.3, -1.0, 2.0])
    q = turn_between(imu(lambda t: w, 0, 100_000_000), 12_345_678, 77_000_000)
    np.testing.assert_allclose(q, so3.exp(w * (77_000_000 - 12_345_678) * 1e-9), atol=1e-12)


def test_a_turn_with_a_moving_axis_is_good_to_a_few_pixels():
    """Against fine integration, over one interval of 50 ms at up to 6 rad/s with a rate that changes by 120 rad/s^2."""

    def rate(t):
        return np.array([6 * np.sin(20 * t), 6 * np.cos(20 * t), 2.0])

    fine = np.array([1.0, 0, 0, 0])
    for t in np.arange(0.01, 0.06, 1e-4):
        fine = so3.multiply(fine, so3.exp(rate(t + 5e-5) * 1e-4))
    error = so3.difference(turn_between(imu(rate, 0, 100_000_000), 10_000_000, 60_000_000), fine)
    assert np.linalg.norm(error) * 460 < 4
    assert np.linalg.norm(so3.log(fine)) * 460 > 100


def test_pixels_turn_as_the_homography_of_a_rotation_says():
    T_b_c = se3.from_rotation_translation(so3.to_matrix(so3.exp(np.array([0.5, -1.2, 2.0]))), np.zeros(3))
    camera = dataclasses.replace(CAMERA, T_b_c=T_b_c)
    w = np.array([0.05, -0.1, 0.2])
    _, Hs = film(2, velocity=(0, 0, 0), turn=w)
    uv = np.random.default_rng(0).uniform(60, 200, (30, 2))
    turned = turn_pixels(camera, so3.exp(T_b_c[:3, :3] @ w), camera.model.lift(uv), uv)
    np.testing.assert_allclose(turned, move(Hs[1], uv), atol=1e-4)


def test_what_turns_out_of_sight_is_expected_where_it_was():
    uv = np.array([[100.0, 80.0], [200.0, 150.0]])
    behind = turn_pixels(CAMERA, so3.exp(np.array([0, np.pi, 0.0])), CAMERA.model.lift(uv), uv)
    np.testing.assert_array_equal(behind, uv.astype(np.float32))


@pytest.mark.parametrize("td_ns", [0, 12_000_000])
@pytest.mark.parametrize("w", [(0.0, 0.2, 0.0), (0.2, 0.0, 0.0), (0.0, 0.2, 0.1)], ids=["yaw", "pitch", "yaw and roll"])
def test_prediction_keeps_tracks_through_a_turn_that_flow_alone_loses(w, td_ns):
    images, _, packets = turning(5, w, td_ns=td_ns)  # 44 pixels an image, a fifth of it leaves the image
    assert survivors(images, packets, ALWAYS).min() > 0.5
    assert survivors(images, packets, RESCUE).min() > 0.5
    assert survivors(images, packets, ALONE).max() < 0.4


def test_tracks_that_flow_finds_alone_are_not_touched_by_the_gyroscope():
    images, _, packets = turning(5, (0.01, 0.01, 0.01))
    np.testing.assert_array_equal(survivors(images, packets, RESCUE), survivors(images, packets, ALONE))
    alone, rescue, always = (second_frame(params, images, packets) for params in (ALONE, RESCUE, ALWAYS))
    np.testing.assert_array_equal(rescue.uv_px, alone.uv_px)
    both = np.intersect1d(alone.ids[alone.age > 1], always.ids[always.age > 1])
    assert len(both) > 40
    gap = np.linalg.norm(alone.uv_px[np.isin(alone.ids, both)] - always.uv_px[np.isin(always.ids, both)], axis=1)
    assert np.quantile(gap, 0.9) < 0.05


def second_frame(params, images, packets):
    state, _, _ = track(params, CAMERA, images, start(), packets[0])
    return track(params, CAMERA, images, state, packets[1])[0]


@pytest.mark.parametrize("error", [50.0, -10.0, 0.0], ids=["units", "axes", "dead"])
def test_a_gyroscope_that_lies_costs_time_but_no_tracks(error):
    images, _, packets = turning(4, (0.0, 0.02, 0.0), gyro_error=error)
    alone = survivors(images, packets, ALONE)
    assert alone.min() > 0.8
    np.testing.assert_array_equal(survivors(images, packets, RESCUE), alone)
    assert survivors(images, packets, ALWAYS).min() > 0.8
    trusting = dataclasses.replace(ALWAYS, predict_min_share=0.0)
    assert survivors(images, packets, trusting).max() < 0.2 or error == 0.0


def test_without_samples_there_is_no_prediction():
    images, _, packets = turning(3, (0.0, 0.02, 0.0))
    blind = [dataclasses.replace(p, imu=ImuSamples.empty()) for p in packets]
    np.testing.assert_array_equal(survivors(images, blind, ALWAYS), survivors(images, packets, ALONE))
