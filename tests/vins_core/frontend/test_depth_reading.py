"""What is read from a depth image at a track, and why nothing is."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from vins_core.errors import CalibrationError
from vins_core.frontend.depth import FATES, KEPT, gates, measure, read
from vins_core.frontend.state import TrackerState
from vins_core.frontend.track import follow
from vins_core.geometry.pinhole_radtan import PinholeRadtan
from vins_core.params import Frontend
from vins_core.report import DepthLoss, TrackReport
from vins_core.sensors import CameraCalibration, DepthCalibration, DepthRef, ImageRef, ImuSamples, Packet
from vins_core.window.state import Observations

PARAMS = Frontend(klt_window=5)
SENSOR = DepthCalibration("/depth", min_m=0.5, max_m=6.0)
MIDDLE = np.array([[20.0, 15.0]], np.float32)


def wall(depth_m: float) -> np.ndarray:
    return np.full((30, 40), depth_m, np.float32)


def plain(shape: tuple[int, int] = (30, 40)) -> np.ndarray:
    return np.full(shape, 90, np.uint8)


def fate_of(depth_m: np.ndarray | None, uv_px: np.ndarray = MIDDLE, **changes: object) -> DepthLoss | None:
    fate = read(replace(PARAMS, **changes), SENSOR, depth_m, plain(), uv_px).fate[0]
    return None if fate == KEPT else list(FATES)[fate]


@pytest.mark.parametrize(
    ("depth_m", "fate"),
    [
        (wall(2.0), None),
        (None, DepthLoss.NO_IMAGE),
        (wall(np.nan), DepthLoss.MISSING),
        (wall(0.4), DepthLoss.NEAR),
        (wall(7.0), DepthLoss.FAR),
    ],
)
def test_a_wall_is_seen_within_the_range_of_the_sensor(depth_m: np.ndarray | None, fate: DepthLoss | None) -> None:
    assert fate_of(depth_m) == fate


def test_pixels_without_depth_do_not_count() -> None:
    depth_m = wall(2.0)
    depth_m[15, 21], depth_m[13, 19] = np.nan, np.nan
    reading = read(PARAMS, SENSOR, depth_m, plain(), MIDDLE + np.float32(0.3))
    assert reading.fate[0] == KEPT and reading.depth_m[0] == 2.0 and reading.share[0] == np.float32(23 / 25)


def test_noise_is_averaged_and_not_taken_for_an_edge() -> None:
    rng = np.random.default_rng(1)
    depth_m = (3.0 * (1 + 0.02 * rng.standard_normal((400, 400)))).astype(np.float32)
    uv_px = rng.uniform(8, 391, (500, 2)).astype(np.float32)
    reading = read(Frontend(), SENSOR, depth_m, plain((400, 400)), uv_px)
    assert (reading.fate == KEPT).all()
    assert (reading.depth_m / 3.0 - 1).std() < 0.003


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_where_near_meets_far_nothing_is_read(share: float) -> None:
    depth_m = wall(2.0)
    depth_m[:, 18 + round(5 * share) :] = 3.0
    assert fate_of(depth_m) is DepthLoss.EDGE
    assert fate_of(depth_m, depth_max_variation=1.0) is None


def test_the_depth_is_that_of_the_texture_that_flow_follows() -> None:
    """Left of the track 2 m, right of it 2.1 m, and all texture on one of the sides."""
    depth_m = wall(2.0)
    depth_m[:, 20:] = 2.1
    for side, expected in ((slice(0, 19), 2.0), (slice(22, None), 2.1)):
        image = plain()
        image[:, side] = np.random.default_rng(3).integers(0, 255, image[:, side].shape)
        reading = read(replace(PARAMS, klt_window=13), SENSOR, depth_m, image, MIDDLE)
        assert reading.depth_m[0] == pytest.approx(expected, abs=0.02)
    assert read(PARAMS, SENSOR, depth_m, plain(), MIDDLE).depth_m[0] == pytest.approx(2.06, abs=0.01)


@pytest.mark.parametrize("klt_window", [7, 8, 13])
def test_flow_follows_the_depth_that_is_read(klt_window: int) -> None:
    """A slanted wall passes by sideways; what flow measures times the depth read is how far."""
    rng = np.random.default_rng(4)
    v, u = np.mgrid[0:120, 0:160].astype(np.float32)
    inverse = 0.5 + 0.001 * (u - 80)
    texture = cv2.GaussianBlur(rng.normal(size=(120, 400)).astype(np.float32), (0, 0), 1.5)
    texture = np.clip(128 + 200 * texture, 0, 255)
    images = [
        cv2.remap(texture, u - shift * inverse + 100, v, cv2.INTER_CUBIC).round().astype(np.uint8) for shift in (0, 4)
    ]
    uv_px = rng.uniform([20, 20], [140, 100], (200, 2)).astype(np.float32)
    params = replace(PARAMS, klt_window=klt_window, klt_levels=0, klt_epsilon=1e-3)
    found, fate = follow(*images, uv_px, params, None)
    reading = read(params, SENSOR, (1 / inverse).astype(np.float32), images[0], uv_px)
    kept = (fate == KEPT) & (reading.fate == KEPT)
    moved = (found[:, 0] - uv_px[:, 0]) * reading.depth_m
    assert kept.sum() > 100 and np.median(moved[kept]) == pytest.approx(4, rel=0.01)


def test_at_the_border_of_the_image_the_patch_is_smaller() -> None:
    corner = np.array([[0.0, 0.0]], np.float32)
    assert fate_of(wall(2.0), corner) is DepthLoss.MISSING
    assert fate_of(wall(2.0), corner, depth_min_patch_share=0.3) is None


class Images:
    def __init__(self, image: np.ndarray) -> None:
        self.image = image

    def load(self, ref: ImageRef) -> np.ndarray:
        return plain()

    def load_depth(self, ref: DepthRef, scale_m: float) -> np.ndarray:
        return self.image


def tracked() -> tuple[TrackerState, Observations, TrackReport]:
    ids, uv_px = np.array([3, 5, 8]), np.array([[20, 15], [8, 8], [30, 20]], np.float32)
    rays, flat = np.tile([0.0, 0.0, 1.0], (2, 1)), np.zeros((2, 2), np.float32)
    none = np.zeros(0)
    report = TrackReport(ids, uv_px, np.ones(3, np.int32), uv_px, none, none, none, none, 0, ())
    return TrackerState.empty(), Observations(ids[[0, 2]], rays, uv_px[[0, 2]], flat), report


CAMERA = CameraCalibration(
    "cam0", PinholeRadtan(40, 30, 30.0, 30.0, 20.0, 15.0, 0.0, 0.0, 0.0, 0.0), np.eye(4), depth=SENSOR
)


def packet(depth: DepthRef | None) -> Packet:
    return Packet(0, (ImageRef(0, 0, 0),), ImuSamples.empty(), depths=(depth,))


def test_the_estimator_gets_the_depths_of_its_own_tracks() -> None:
    image = wall(2.0)
    image[20, 28:33] = np.nan
    image[18, 28] = 2.2
    _, observations, report = measure(PARAMS, CAMERA, Images(image), packet(DepthRef(0, 0, 0)), tracked())
    assert list(report.depth_loss) == [255, 255, 255] and observations.depth_m is not None
    np.testing.assert_array_equal(observations.depth_m, report.depth_m[[0, 2]])
    _, observations, report = measure(PARAMS, CAMERA, Images(image), packet(None), tracked())
    assert (report.depth_loss == FATES[DepthLoss.NO_IMAGE]).all()
    assert observations.depth_m is not None and np.isnan(observations.depth_m).all()
    assert not next(g for g in report.gates if g.name == "depth found").passed


def test_depth_that_is_not_registered_to_the_camera_is_refused_with_its_size() -> None:
    with pytest.raises(CalibrationError, match="20x10 pixels, its camera 40x30"):
        measure(PARAMS, CAMERA, Images(np.ones((10, 20), np.float32)), packet(DepthRef(0, 0, 0)), tracked())


def test_the_record_answers_every_gate_of_a_track_again() -> None:
    image = wall(7.0)
    image[:, :17] = 0.4
    image[0:12, 0:12] = np.nan
    _, _, report = measure(PARAMS, CAMERA, Images(image), packet(DepthRef(0, 0, 0)), tracked())
    failed = [{g.name for g in gates(PARAMS, SENSOR, report, row) if not g.passed} for row in range(3)]
    assert failed[0] == {"farthest depth"} and failed[1] >= {"pixels with depth"}
