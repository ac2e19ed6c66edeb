"""Left and right images of a textured plane: where the second camera sees each track is known."""

from dataclasses import replace

import numpy as np
import pytest
from plane_world import CAMERA, PARAMS, STEP_NS, Film, homography, move, packet, ref, render, start, texture

from vins_core.errors import CalibrationError
from vins_core.frontend.step import track
from vins_core.frontend.stereo import inverse_depths
from vins_core.geometry import se3, so3
from vins_core.geometry.pinhole_radtan import PinholeRadtan
from vins_core.report import RIGHT_LOSSES, RightLoss
from vins_core.sensors import CameraCalibration, ImageRef

BASELINE_M, DEPTH_M = 0.1, 2.0
TURN = np.array([0.01, -0.015, 0.02])
T_B_C1 = se3.from_quaternion_translation(so3.exp(TURN), np.array([BASELINE_M, 0.0, 0.0]))
RIGHT = replace(CAMERA, name="cam1", T_b_c=T_B_C1, topic="/cam1")
VELOCITY = np.array([0.02, 0.01, 0.0])


def second(index: int) -> ImageRef:
    """The image that camera 1 took with image `index`."""
    return ImageRef(index * STEP_NS, 1, 100 + index)


def rig(
    n: int = 3, right_shift_px: float = 0.0, depth: float = DEPTH_M, velocity: np.ndarray = VELOCITY
) -> tuple[Film, list[np.ndarray], list[np.ndarray]]:
    """Images of both cameras, and the homographies from the first left image to each of them."""
    lefts = [homography(velocity * k, depth=depth) for k in range(n)]
    rights = [homography(velocity * k + [BASELINE_M, 0, 0], TURN, depth) for k in range(n)]
    shift = np.array([[1, 0, 0], [0, 1, right_shift_px], [0, 0, 1.0]])
    images = {k: render(H) for k, H in enumerate(lefts)} | {100 + k: render(shift @ H) for k, H in enumerate(rights)}
    return Film(images), lefts, rights


def run(film: Film, n: int = 3, params=PARAMS, right: CameraCalibration = RIGHT, without: tuple[int, ...] = ()):
    state, out = start(), []
    for k in range(n):
        refs = [ref(k)] if k in without else [ref(k), second(k)]
        state, observations, report = track(params, CAMERA, film, state, packet(k, *refs), None, right)
        out.append((state, observations, report))
    return out


def test_the_second_camera_sees_tracks_where_the_plane_is() -> None:
    film, lefts, rights = rig()
    _, observations, report = run(film)[-1]
    seen = report.right_loss == 255
    assert seen.mean() > 0.7
    expected = move(rights[2] @ np.linalg.inv(lefts[2]), report.uv_px[seen])
    assert np.median(np.linalg.norm(report.right_uv_px[seen] - expected, axis=1)) < 0.25
    refused = np.isin(
        report.right_loss, [RIGHT_LOSSES.index(RightLoss.FLOW_BACK), RIGHT_LOSSES.index(RightLoss.EPIPOLAR)]
    )
    np.testing.assert_array_equal(np.isfinite(report.right_uv_px).all(1), seen | refused)
    right = observations.right
    assert right is not None and np.isin(right.ids, observations.ids).all() and (np.diff(right.ids) > 0).all()
    np.testing.assert_allclose(right.rays, RIGHT.model.lift(right.uv_px))
    np.testing.assert_array_equal(np.isin(report.ids[seen], observations.ids).sum(), len(right))


def test_both_cameras_see_a_track_at_its_depth() -> None:
    _, observations, _ = run(rig()[0])[-1]
    assert observations.right is not None
    rows = np.searchsorted(observations.ids, observations.right.ids)
    a, b = observations.rays[rows], observations.right.rays @ T_B_C1[:3, :3].T
    normal = np.cross(a, b)
    depth = a[:, 2] * np.linalg.norm(np.cross(b, [[BASELINE_M, 0, 0]]), axis=1) / np.linalg.norm(normal, axis=1)
    assert np.median(np.abs(depth / DEPTH_M - 1)) < 0.01


def test_near_points_are_found_several_windows_away() -> None:
    """A plane at 30 cm is shifted by 70 px, and a window of 13 px does not reach that far by itself: one match that it
    finds shows its neighbours the way."""
    film, lefts, rights = rig(4, depth=0.3, velocity=0.1 * VELOCITY)
    for k, (_, _, report) in enumerate(run(film, 4)):
        expected = move(rights[k] @ np.linalg.inv(lefts[k]), report.uv_px)
        seen = ((expected > 10) & (expected < [CAMERA.model.width - 10, CAMERA.model.height - 10])).all(1)
        found = report.right_loss == 255
        assert seen.sum() > 25 and found[seen].mean() > 0.8
        assert np.median(np.linalg.norm(report.right_uv_px[found] - expected[found], axis=1)) < 0.5


def test_an_inverse_depth_is_that_of_the_point() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (50, 2)), rng.uniform(1, 20, 50)])
    T_c1_c0 = se3.inverse(T_B_C1)
    rays = [p / np.linalg.norm(p, axis=1, keepdims=True) for p in (points, se3.transform(T_c1_c0, points))]
    np.testing.assert_allclose(inverse_depths(T_c1_c0, *rays), 1 / points[:, 2], rtol=1e-9)
    far = rays[0], rays[0] @ T_c1_c0[:3, :3].T
    np.testing.assert_allclose(inverse_depths(T_c1_c0, *far), 0.0, atol=1e-12)
    assert (inverse_depths(np.eye(4), *rays) == 0).all(), "without a baseline everything is far away"


def test_tracks_of_the_first_camera_are_what_they_are_without_a_second() -> None:
    film, *_ = rig()
    alone, both = start(), start()
    for k in range(3):
        alone, a, report_a = track(PARAMS, CAMERA, film, alone, packet(k, ref(k)))
        both, b, report_b = track(PARAMS, CAMERA, film, both, packet(k, ref(k), second(k)), None, RIGHT)
        for name in ("ids", "uv_px", "rays", "velocity"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        np.testing.assert_array_equal(report_a.lost_ids, report_b.lost_ids)
        assert report_b.gates[: len(report_a.gates)] == report_a.gates
        assert a.right is None and not len(report_a.right_loss) and report_b.gates[-1].name == "stereo matches"


def test_velocity_in_the_second_camera_is_that_of_its_image() -> None:
    _, observations, _ = run(rig()[0])[-1]
    right = observations.right
    assert right is not None
    moving = np.linalg.norm(right.velocity, axis=1) > 0
    expected = -(so3.to_matrix(so3.exp(TURN)).T @ VELOCITY)[:2] / DEPTH_M / (STEP_NS * 1e-9)
    assert moving.mean() > 0.8
    np.testing.assert_allclose(np.median(right.velocity[moving], axis=0), expected, rtol=0.08, atol=0.01)


@pytest.mark.parametrize(("limit_px", "kept"), [(2.0, False), (50.0, True)])
def test_what_is_off_the_epipolar_line_is_no_match(limit_px: float, kept: bool) -> None:
    """The right image is 5 px lower than the calibration says: 10 px460."""
    film, *_ = rig(right_shift_px=5.0)
    *_, report = run(film, params=replace(PARAMS, stereo_epipolar_px=limit_px))[-1]
    off = report.right_loss == RIGHT_LOSSES.index(RightLoss.EPIPOLAR)
    assert (off.mean() < 0.1) == kept and ((report.right_loss == 255).mean() > 0.7) == kept


def test_a_missing_right_image_leaves_tracks_with_one_camera() -> None:
    (_, _, _), (_, observations, report), (_, after, _) = run(rig()[0], without=(1,))
    assert observations.right is not None and len(observations.right) == 0 and len(observations) > 20
    assert (report.right_loss == RIGHT_LOSSES.index(RightLoss.NO_IMAGE)).all()
    assert after.right is not None and len(after.right) > 20
    assert not after.right.velocity.any()


def test_a_featureless_right_image_has_no_matches() -> None:
    film, *_ = rig()
    for k in range(3):
        film.images[100 + k] = np.full_like(film.images[k], 90)
    _, observations, report = run(film)[-1]
    assert observations.right is not None and len(observations.right) == 0
    assert not report.gates[-1].passed and not report.gates[-1].decides


def test_a_right_image_of_another_size_is_refused() -> None:
    film, *_ = rig()
    small = PinholeRadtan(160, 120, 110.0, 110.0, 80.0, 60.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(CalibrationError, match=r"/cam1: image .* is 320x240, but the calibration of cam1 says 160x120"):
        run(film, right=replace(RIGHT, model=small))


def test_texture_is_what_the_matches_follow() -> None:
    """Another plane behind the right camera: what flow finds there is not where the epipolar lines are."""
    film, *_ = rig()
    for k in range(3):
        film.images[100 + k] = render(np.eye(3), texture(seed=9))
    *_, report = run(film)[-1]
    assert (report.right_loss == 255).mean() < 0.15
