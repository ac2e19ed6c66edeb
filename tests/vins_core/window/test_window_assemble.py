from dataclasses import replace

import numpy as np
import pytest
import synthetic_window as sw

from vins_core import params as settings
from vins_core.geometry import so3
from vins_core.params import Params
from vins_core.solver.levenberg_marquardt import solve
from vins_core.solver.problem import retract_poses
from vins_core.solver.solve import solve as trust_region
from vins_core.window import landmarks
from vins_core.window.assemble import assemble, gather_tracks, inv_depth_sigma, solve_report, unpack
from vins_core.window.slide import drop_oldest, restrict
from vins_core.window.state import OUTLIER, Landmarks

PARAMS = Params()


@pytest.fixture(scope="module")
def flight():
    return sw.make(n_tracks=120, max_angle_deg=60)


def test_tracks_hold_every_observation_once_in_order(flight):
    frames = flight.window.frames
    tracks = gather_tracks(frames)
    assert len(tracks.slots) == sum(len(f.observations) for f in frames)
    assert (np.diff(tracks.ids) > 0).all()
    for k in range(0, len(tracks.ids), 7):
        rows = slice(tracks.start[k], tracks.start[k + 1])
        seen = [s for s, f in enumerate(frames) if tracks.ids[k] in f.observations.ids]
        np.testing.assert_array_equal(tracks.slots[rows], seen)
        assert tracks.anchor[k] == seen[0] and tracks.count[k] == len(seen)
        for slot, ray in zip(tracks.slots[rows], tracks.rays[rows]):
            o = frames[slot].observations
            np.testing.assert_array_equal(ray, o.rays[np.searchsorted(o.ids, tracks.ids[k])])


def test_every_later_observation_of_a_landmark_is_one_factor(flight):
    built = assemble(PARAMS, flight.window, sw.GRAVITY)
    tracks, table = built.tracks, built.problem.projections
    rows = np.searchsorted(tracks.ids, built.ids)
    np.testing.assert_array_equal(np.bincount(table.landmark), tracks.count[rows] - 1)
    assert (table.observer > table.anchor).all()
    np.testing.assert_array_equal(table.anchor, built.anchor[table.landmark])
    np.testing.assert_allclose(np.linalg.norm(table.rays_j, axis=1), 1)


def test_landmarks_enter_by_status_depth_observations_and_anchor(flight):
    window = flight.window
    built = assemble(PARAMS, window, sw.GRAVITY)
    assert built.anchor.max() == 7  # REFERENCE W6: start_frame < WINDOW_SIZE - 2 = 8
    table = window.landmarks
    inv_depth, status = table.inv_depth.copy(), table.status.copy()
    out = np.searchsorted(table.ids, built.ids[:3])
    inv_depth[out[0]], inv_depth[out[1]], status[out[2]] = np.nan, -0.1, OUTLIER
    fewer = assemble(PARAMS, replace(window, landmarks=replace(table, inv_depth=inv_depth, status=status)), sw.GRAVITY)
    np.testing.assert_array_equal(fewer.ids, built.ids[3:])
    long_only = assemble(settings.replace(PARAMS, {"window.min_observations": 5}), window, sw.GRAVITY)
    assert np.bincount(long_only.problem.projections.landmark).min() == 4
    assert set(long_only.ids) < set(built.ids)


def test_rays_across_the_image_plane_need_the_sphere(flight):
    frame = flight.window.frames[2]
    o = frame.observations
    rays = o.rays.copy()
    rays[:] = [1.0, 0.0, 0.0]
    sideways = replace(frame, observations=replace(o, rays=rays))
    frames = (*flight.window.frames[:2], sideways, *flight.window.frames[3:])
    window = replace(flight.window, frames=frames)
    plane = assemble(PARAMS, window, sw.GRAVITY)
    sphere = assemble(settings.replace(PARAMS, {"projection.residual": "sphere"}), window, sw.GRAVITY)
    assert not (plane.problem.projections.observer == 2).any()
    assert (sphere.problem.projections.observer == 2).any()
    for built in (plane, sphere):  # as an anchor it serves both: there a landmark has a distance instead of a depth
        assert (built.anchor == 2).any()


@pytest.mark.parametrize("turn_deg", [100.0, 180.0])
def test_a_camera_mounted_another_way_round_gives_the_same_motion(flight, turn_deg):
    params = settings.replace(PARAMS, {"projection.residual": "sphere", "window.max_iterations": 30})
    R = so3.to_matrix(so3.exp(np.radians([turn_deg, 0.0, 0.0])))
    T_b_c = flight.window.T_b_c.copy()
    T_b_c[0, :3, :3] = T_b_c[0, :3, :3] @ R

    def turned(frame):
        return replace(frame, observations=replace(frame.observations, rays=frame.observations.rays @ R))

    def solved(window):
        empty = replace(window, landmarks=restrict(Landmarks.empty(), window.frames))
        window = landmarks.triangulate(params.window, empty)
        built = assemble(params, window, sw.GRAVITY)
        solution = trust_region(params, built.problem)
        return unpack(window, built, solution.states), solution.after.total, built.tracks.rays[:, 2]

    straight, cost, _ = solved(flight.window)
    window = replace(flight.window, T_b_c=T_b_c, frames=tuple(turned(f) for f in flight.window.frames))
    other, other_cost, z = solved(window)
    assert (z < 0).mean() > 0.5
    np.testing.assert_allclose(other_cost, cost, rtol=1e-6)
    for a, b in zip(straight.frames, other.frames):
        np.testing.assert_allclose(a.p_w_b, b.p_w_b, atol=1e-5)
        assert np.linalg.norm(so3.difference(a.q_w_b, b.q_w_b)) < 1e-5
    for window in (straight, other):  # the oldest leaves: depths find another anchor and stay in front of it
        slid = drop_oldest(window).landmarks.inv_depth
        assert (slid[np.isfinite(slid)] > 0).all() and np.isfinite(slid).sum() > 30


def test_imu_factors_over_long_intervals_are_left_out(flight):
    frames = list(flight.window.frames)
    frames[4] = replace(frames[4], imu=replace(frames[4].imu, dt_s=11.0))
    built = assemble(PARAMS, replace(flight.window, frames=tuple(frames)), sw.GRAVITY)
    assert [k for k, _ in built.problem.imu] == [0, 1, 2, 4, 5, 6, 7, 8, 9]
    report = solve_report(built, solve(PARAMS.solver, 2, built.problem))
    assert np.isnan(report.imu_sigma[3]).all() and np.isfinite(report.imu_sigma[4]).all()


def test_unpacking_what_was_assembled_changes_nothing(flight):
    window = flight.window
    built = assemble(PARAMS, window, sw.GRAVITY)
    same = unpack(window, built, built.problem.initial)
    for a, b in zip(window.frames, same.frames):
        np.testing.assert_allclose(a.p_w_b, b.p_w_b, atol=1e-14)
        np.testing.assert_allclose(so3.difference(a.q_w_b, b.q_w_b), 0, atol=1e-14)
        np.testing.assert_allclose(a.v_w_b, b.v_w_b, atol=1e-14)
    np.testing.assert_array_equal(same.landmarks.inv_depth, window.landmarks.inv_depth)


@pytest.mark.parametrize("pitch", [0.0, np.pi / 2])
def test_unpacking_takes_back_any_motion_along_the_gauge(flight, pitch):
    tilt = so3.exp(np.array([0.0, pitch, 0.0]))
    frames = tuple(replace(f, q_w_b=so3.multiply(tilt, f.q_w_b)) for f in flight.window.frames)
    window = replace(flight.window, frames=frames)
    built = assemble(PARAMS, window, sw.GRAVITY)
    start = built.problem.initial
    turn = so3.exp(np.array([0, 0, 0.4]))
    poses = np.concatenate([so3.rotate(turn, start.poses[:, :3]) + 2.0, so3.multiply(turn, start.poses[:, 3:])], 1)
    speeds = np.concatenate([so3.rotate(turn, start.speed_biases[:, :3]), start.speed_biases[:, 3:]], 1)
    back = unpack(window, built, replace(start, poses=poses, speed_biases=speeds))
    for a, b in zip(window.frames, back.frames):
        np.testing.assert_allclose(b.p_w_b, a.p_w_b, atol=1e-12)
        np.testing.assert_allclose(so3.difference(b.q_w_b, a.q_w_b), 0, atol=1e-12)
        np.testing.assert_allclose(b.v_w_b, a.v_w_b, atol=1e-12)


def test_roll_and_pitch_of_the_oldest_frame_are_kept_from_the_solve(flight):
    built = assemble(PARAMS, flight.window, sw.GRAVITY)
    start = built.problem.initial
    d = np.zeros((11, 6))
    d[:, 3:] = so3.rotate(so3.inverse(start.poses[:, 3:]), np.tile([0.1, 0.0, 0.0], (11, 1)))  # a roll of the world
    moved = unpack(flight.window, built, replace(start, poses=retract_poses(start.poses, d)))
    turn = so3.log(so3.multiply(moved.frames[0].q_w_b, so3.inverse(start.poses[0, 3:])))
    np.testing.assert_allclose(turn, [0.1, 0, 0], atol=1e-12)


def test_report_states_the_errors_in_px460(flight):
    built = assemble(PARAMS, flight.window, sw.GRAVITY)
    solution = solve(PARAMS.solver, 8, built.problem)
    report = solve_report(built, solution)
    assert len(report.visual_ids) == len(built.problem.projections) == len(report.visual_error_px)
    assert report.after.total < report.before.total == report.before.visual + report.before.imu
    solved = unpack(flight.window, built, solution.states)
    k = 5
    anchor, observer = (solved.frames[s] for s in report.visual_slots[k])
    table = solved.landmarks
    inv_depth = table.inv_depth[np.searchsorted(table.ids, report.visual_ids[k])]
    xy = observer.observations.rays[np.searchsorted(observer.observations.ids, report.visual_ids[k])]
    ray = anchor.observations.rays[np.searchsorted(anchor.observations.ids, report.visual_ids[k])]
    R_c, t_c = sw.T_B_C[:3, :3], sw.T_B_C[:3, 3]
    world = so3.rotate(anchor.q_w_b, R_c @ (ray / ray[2] / inv_depth) + t_c) + anchor.p_w_b
    p = R_c.T @ (so3.rotate(so3.inverse(observer.q_w_b), world - observer.p_w_b) - t_c)
    expected = 460 * np.linalg.norm(p[:2] / p[2] - xy[:2] / xy[2])
    assert report.visual_error_px[k] == pytest.approx(expected, rel=1e-4)


def test_inverse_depth_sigma_shrinks_with_parallax_and_matches_the_residuals(flight):
    built = assemble(PARAMS, flight.window, sw.GRAVITY)
    solution = solve(PARAMS.solver, 8, built.problem)
    sigma = inv_depth_sigma(solution)
    count = np.bincount(built.problem.projections.landmark)
    assert np.median(sigma[count >= 8]) < np.median(sigma[count <= 3])
    assert (sigma > 0).all()


def test_a_window_without_landmarks_assembles(flight):
    window = flight.window
    bare = replace(window, landmarks=Landmarks.empty())
    built = assemble(PARAMS, bare, sw.GRAVITY)
    solution = solve(PARAMS.solver, 8, built.problem)
    assert built.problem.n_landmarks == 0 and solution.after.imu <= solution.before.imu
    unpack(bare, built, solution.states)
