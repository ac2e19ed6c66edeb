"""Milliseconds of the front end on 752x480 images: `pytest tests/benchmarks/test_frontend.py --benchmark-enable`."""

import cv2
import numpy as np
import pytest

from vins_core.frontend.detect import detect_corners, keep_spaced
from vins_core.frontend.images import equalized
from vins_core.frontend.reject import epipolar_inliers
from vins_core.frontend.state import TrackerState
from vins_core.frontend.step import track
from vins_core.frontend.track import follow
from vins_core.geometry import se3, so3
from vins_core.geometry.kannala_brandt import KannalaBrandt
from vins_core.geometry.pinhole_radtan import PinholeRadtan
from vins_core.geometry.triangulation import triangulate_tracks
from vins_core.params import Frontend
from vins_core.sensors import CameraCalibration, ImageRef, ImuSamples, Packet

PINHOLE = PinholeRadtan(752, 480, 461.6, 460.3, 363.0, 248.1, -0.2917, 0.08228, 5.333e-05, -0.0001578)
FISHEYE = KannalaBrandt(512, 512, 190.98, 190.97, 254.93, 256.9, 0.0034, 0.00077, -0.002, 0.0002)
CAMERA = CameraCalibration("cam0", PINHOLE, np.eye(4))
PARAMS = Frontend()


@pytest.fixture(scope="module", autouse=True)
def single_thread():
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


class Strip:
    """Images that slide over one texture, 3 pixels at a time; decoding costs nothing."""

    def __init__(self, n=40):
        rng = np.random.default_rng(0)
        canvas = sum(
            cv2.resize(rng.uniform(-a, a, (560 // s, 960 // s)), (960, 560), interpolation=cv2.INTER_CUBIC)
            for s, a in ((3, 20.0), (12, 60.0), (40, 60.0))
        )
        canvas = np.clip(canvas + 128, 0, 255).astype(np.uint8)
        self.images = [np.ascontiguousarray(canvas[k : k + 480, 3 * k : 3 * k + 752]) for k in range(n)]

    def load(self, ref):
        return self.images[ref.index]


@pytest.fixture(scope="module")
def strip():
    return Strip()


@pytest.fixture(scope="module")
def corners(strip):
    return detect_corners(strip.images[0], PARAMS.max_cnt, np.zeros((0, 2), np.float32), PARAMS, None)


def ref(index):
    return ImageRef(50_000_000 * index, 0, index)


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole-radtan", "kannala-brandt"])
def test_lift_150_points(benchmark, camera):
    uv = np.random.default_rng(0).uniform(60, 440, (150, 2))
    assert np.isfinite(benchmark(camera.lift, uv)).all()


def test_equalize_an_image(benchmark, strip):
    def once():
        fresh = Strip.__new__(Strip)  # a new source, so that nothing is remembered
        fresh.images = strip.images
        return equalized(fresh, ref(0), PARAMS)

    assert benchmark(once).shape == (480, 752)


def test_follow_150_tracks_to_the_next_image_and_back(benchmark, strip, corners):
    _, fate = benchmark(follow, strip.images[0], strip.images[1], corners, PARAMS)
    assert (fate == 255).mean() > 0.9


def test_refill_40_of_150_corners(benchmark, strip, corners):
    assert len(benchmark(detect_corners, strip.images[0], 40, corners[40:], PARAMS, None)) == 40


def test_space_150_tracks(benchmark, corners):
    assert benchmark(keep_spaced, corners, PARAMS.min_dist, None).any()


@pytest.mark.parametrize("model", ["essential", "fundamental"])
def test_epipolar_test_of_150_pairs(benchmark, model):
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-3, 3, (150, 2)), rng.uniform(3, 8, 150)])
    rays = [p / np.linalg.norm(p, axis=1, keepdims=True) for p in (points, points + np.array([0.1, 0, 0.02]))]
    rays = [r + rng.normal(0, 3e-4, r.shape) for r in rays]
    rays[1][:15] += rng.uniform(0.02, 0.1, (15, 3))
    assert benchmark(epipolar_inliers, *rays, Frontend(epipolar_model=model)).mean() > 0.7


def test_a_frame_of_two_images(benchmark, strip):
    """Equalise, follow and lift twice; reject, space and refill once."""
    states = [TrackerState.empty()]
    for k in range(0, 38, 2):
        packet = Packet(k // 2, (ref(k + 1), ref(k + 2)), ImuSamples.empty())
        states.append(track(PARAMS, CAMERA, strip, states[-1], packet)[0])

    frames = iter(range(10**9))

    def next_frame():
        k = 1 + next(frames) % 18
        return (PARAMS, CAMERA, strip, states[k], Packet(k, (ref(2 * k + 1), ref(2 * k + 2)), ImuSamples.empty())), {}

    _, observations, _ = benchmark.pedantic(track, setup=next_frame, rounds=40, warmup_rounds=2)
    assert len(observations) > 80


def test_triangulate_190_tracks_of_11_observations(benchmark):
    rng = np.random.default_rng(0)
    T_w_c = se3.from_quaternion_translation(so3.exp(rng.normal(0, 0.1, (11, 3))), rng.normal(0, 0.3, (11, 3)))
    points = np.column_stack([rng.uniform(-2, 2, (190, 2)), rng.uniform(3, 8, 190)])
    track_row, slot = np.repeat(np.arange(190), 11), np.tile(np.arange(11), 190)
    rays = se3.transform(se3.inverse(T_w_c[slot]), points[track_row])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    depth = benchmark(triangulate_tracks, T_w_c, track_row, slot, rays, np.zeros(190, int))
    assert np.isfinite(depth).all()
