"""What the 3D view draws, as arrays: tested without a browser."""

from __future__ import annotations

import numpy as np
import pytest
from fake_run import CAMERA, FIRST_SOLVE, FOCAL, HEIGHT, T_B_C, FakeRun, fake_run

from app import palette
from app.context import RunView, Selection
from app.landmark_map import LandmarkMap
from app.scene.frame import SceneFrame, scene_unit, vertical_fov, window_camera_poses
from app.scene.ground import grid_cell
from app.scene.landmarks import STYLES, by_status
from app.scene.pick import nearest_to_ray, pick
from app.scene.selection import selection_rays, three_sigma
from app.scene.trajectory import dashes, polyline
from app.scene.view import COVERED, overview, shoulder
from app.scene.window import frustum_scale, imu_colours
from vins_core.report import LandmarkStatus

NOTHING = Selection()


@pytest.fixture(scope="module")
def run() -> FakeRun:
    return fake_run()


def scene(run: FakeRun, k: int, selection: Selection = NOTHING) -> SceneFrame:
    report = run.report(k)
    return SceneFrame(RunView(run), k, report, selection, None, np.zeros((0, 3)), scene_unit(report))  # type: ignore[arg-type]


# Trajectory


def test_a_line_through_n_points_has_n_minus_1_segments_that_touch() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    segments = polyline(points)
    assert segments.shape == (19, 2, 3)
    np.testing.assert_array_equal(segments[1:, 0], segments[:-1, 1])


def test_a_long_line_is_thinned_but_keeps_both_ends() -> None:
    points = np.arange(30_000.0).reshape(-1, 3)
    segments = polyline(points, most=500)
    assert len(segments) <= 501
    np.testing.assert_array_equal(segments[0, 0], points[0])
    np.testing.assert_array_equal(segments[-1, 1], points[-1])


def test_a_line_breaks_where_there_is_no_estimate() -> None:
    points = np.arange(15.0).reshape(5, 3)
    points[2] = np.nan
    assert len(polyline(points)) == 2


@pytest.mark.parametrize("n", [0, 1])
def test_too_few_points_draw_nothing(n: int) -> None:
    assert polyline(np.zeros((n, 3))).shape == dashes(np.zeros((n, 3)), 1.0).shape == (0, 2, 3)


def test_dashes_cover_half_of_the_way_whatever_the_sampling() -> None:
    x = np.sort(np.concatenate([[0, 10], np.random.default_rng(3).uniform(0, 10, 200) ** 2 / 10]))
    drawn = dashes(np.stack([x, 0 * x, 0 * x], 1), 0.25)
    assert np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=1).sum() == pytest.approx(5.0, abs=0.3)


# Window


def test_imu_edges_turn_to_the_colour_of_failure_with_their_residual() -> None:
    sigma = np.outer([0.0, 4.0, 20.0], np.ones(5))
    colours = imu_colours(sigma, 3)
    assert tuple(colours[0]) == palette.rgb(palette.IMU)
    assert tuple(colours[2]) == palette.rgb(palette.BAD)
    assert (np.sort([colours[0], colours[1], colours[2]], 0)[1] == colours[1]).all()  # between the two


def test_an_unknown_imu_residual_is_not_drawn_as_a_good_one() -> None:
    assert tuple(imu_colours(np.full((1, 5), np.nan), 1)[0]) == palette.rgb(palette.BAD)


def test_frustums_do_not_pulse_when_the_spacing_changes_a_little() -> None:
    T = np.tile(np.eye(4), (11, 1, 1))
    T[:, 0, 3] = 0.105 * np.arange(11)
    jittered = T.copy()
    jittered[:, 0, 3] *= 1.03
    assert frustum_scale(T, 3.0) == frustum_scale(jittered, 3.0)


def test_camera_poses_apply_the_extrinsic_on_the_body_side(run: FakeRun) -> None:
    window = run.report(30).window
    assert window is not None
    T_w_c = window_camera_poses(window, T_B_C)
    down = T_w_c[-1, :3, 1]  # y of a camera looks down, and this one is carried upright
    assert down[2] < -0.9


def test_the_field_of_view_is_that_of_the_image(run: FakeRun) -> None:
    fov, aspect = vertical_fov(run.header.calibration.cameras[0])
    assert fov == pytest.approx(2 * np.arctan(HEIGHT / 2 / FOCAL), abs=0.01)
    assert aspect == pytest.approx(CAMERA.width / CAMERA.height)


# Landmarks


def test_every_landmark_with_a_position_is_drawn_once_and_no_other(run: FakeRun) -> None:
    landmarks = run.report(40).landmarks
    assert landmarks is not None
    drawn = np.concatenate(list(by_status(landmarks).values()))
    assert len(drawn) == np.isfinite(landmarks.xyz_w).all(1).sum()
    assert np.isfinite(drawn).all()


def test_states_differ_in_shape_and_not_only_in_colour() -> None:
    assert len({shape for shape, _, _ in STYLES.values()}) == len(STYLES) == len(LandmarkStatus)


def test_the_map_of_passed_landmarks_is_the_same_forwards_and_backwards(run: FakeRun) -> None:
    whole, grown = LandmarkMap(), LandmarkMap()
    for report in run.reports:
        whole.extend(report)
    for k, report in enumerate(run.reports):
        grown.extend(report)
        np.testing.assert_array_equal(grown.at(k), whole.at(k))
    assert len(whole.at(FIRST_SOLVE)) == 0 < len(whole.at(59))


def test_a_landmark_joins_the_map_only_when_the_window_has_forgotten_it(run: FakeRun) -> None:
    passed = LandmarkMap()
    for report in run.reports:
        passed.extend(report)
        if report.landmarks is None:
            continue
        alive = {tuple(p) for p in report.landmarks.xyz_w}
        assert not alive & {tuple(p) for p in passed.at(report.frame)}


# Selection


def test_rays_lead_from_every_observing_camera_to_the_landmark(run: FakeRun) -> None:
    solve, landmarks = run.report(40).solve, run.report(40).landmarks
    assert solve is not None and landmarks is not None
    id = int(solve.visual_ids[0])
    frame = scene(run, 40, Selection("track", id))
    rays = selection_rays(frame)
    slots = np.unique(solve.visual_slots[solve.visual_ids == id])
    np.testing.assert_allclose(rays[:, 0], frame.camera_poses()[slots, :3, 3])
    np.testing.assert_allclose(rays[:, 1], np.tile(landmarks.xyz_w[landmarks.ids == id], (len(slots), 1)))


def test_rays_of_a_frame_lead_to_the_landmarks_it_observes(run: FakeRun) -> None:
    report = run.report(40)
    assert report.window is not None and report.solve is not None
    rays = selection_rays(scene(run, 40, Selection("frame", int(report.window.frames[3]))))
    seen = np.unique(report.solve.visual_ids[(report.solve.visual_slots == 3).any(1)])
    assert len(rays) == len(seen) > 0


@pytest.mark.parametrize("selection", [Selection(), Selection("track", 10**9), Selection("frame", 10**9)])
def test_what_is_not_in_the_window_has_no_rays(run: FakeRun, selection: Selection) -> None:
    assert len(selection_rays(scene(run, 40, selection))) == 0
    assert len(selection_rays(scene(run, 3, selection))) == 0


def test_the_ellipsoid_reaches_as_far_as_the_bound_of_inverse_depth() -> None:
    depth, sigma = 4.0, 0.01
    along = three_sigma(np.array([0, 0, depth]), 1 / depth, sigma)[2]
    assert depth + along == pytest.approx(1 / (1 / depth - 3 * sigma))


def test_the_ellipsoid_stays_finite_when_infinity_is_within_the_bound() -> None:
    assert np.isfinite(three_sigma(np.array([0, 0, 4.0]), 0.25, 0.2)).all()
    assert np.isfinite(three_sigma(np.array([0, 0, 4.0]), 0.25, np.nan)).all()


# Picking and viewpoints


def test_a_ray_picks_the_point_it_passes_and_never_one_behind(run: FakeRun) -> None:
    points = np.array([[0.0, 0.01, 5.0], [0.0, 0.0, -5.0], [np.nan, 0, 1], [1.0, 0, 5]])
    row, angle = nearest_to_ray(points, np.zeros(3), np.array([0, 0, 2.0]))
    assert row == 0 and angle == pytest.approx(0.002, rel=1e-3)
    assert nearest_to_ray(points[1:2], np.zeros(3), np.array([0, 0, 1.0])) == (-1, np.inf)


def test_a_click_on_any_landmark_selects_it_and_one_into_the_void_nothing(run: FakeRun) -> None:
    frame, origin = scene(run, 40), np.array([-9.0, -11.0, 9.0])
    landmarks = frame.report.landmarks
    assert landmarks is not None
    for k in np.flatnonzero(np.isfinite(landmarks.xyz_w).all(1))[::10]:
        picked = pick(frame, origin, landmarks.xyz_w[k] - origin)
        assert picked == Selection("track", int(landmarks.ids[k]))
    assert pick(frame, origin, np.array([-1.0, -1, 1])) == Selection()


def test_a_click_on_a_camera_selects_its_frame(run: FakeRun) -> None:
    frame, origin = scene(run, 40), np.array([-9.0, -11.0, 9.0])
    assert frame.report.window is not None
    for slot, centre in enumerate(frame.camera_poses()[:, :3, 3]):
        assert pick(frame, origin, centre - origin) == Selection("frame", int(frame.report.window.frames[slot]))


@pytest.mark.parametrize("aspect", [0.6, 1.0, 1.8])
def test_the_overview_sees_every_point_above_the_timeline(aspect: float) -> None:
    points, fov = np.random.default_rng(5).normal(size=(200, 3)) * [8, 2, 1] + [3, 4, 5], 1.3
    position, look_at = overview(points, fov, aspect)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    x, y, z = ((points - position) @ axis for axis in (right, up, forward))
    high = np.tan(fov / 2)
    assert (z > 0).all() and (np.abs(x / z) < high * aspect).all()
    assert (y / z < high).all() and (y / z > -high * (1 - 2 * COVERED)).all()


def test_there_is_a_view_of_a_run_without_poses() -> None:
    position, look_at = overview(np.zeros((0, 3)), 1.3, 1.0)
    assert np.linalg.norm(position - look_at) > 1


def test_following_looks_over_the_shoulder_even_straight_down() -> None:
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0])
    position, look_at = shoulder(T, 3.0)
    assert np.isfinite(position).all() and position[2] > look_at[2]


@pytest.mark.parametrize("unit", [0.3, 1.0, 4.0, 25.0])
def test_grid_cells_are_round_numbers_that_suit_the_scene(unit: float) -> None:
    cell = grid_cell(unit)
    assert 0.5 < cell / (unit / 4) < 2
    assert float(f"{cell:.0e}") == pytest.approx(cell) and f"{cell:.0e}"[0] in "125"
