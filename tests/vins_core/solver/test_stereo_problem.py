"""Windows with a second camera: what it adds to a problem, to the solvers, and to what marginalisation leaves."""

from dataclasses import replace

import dense
import numpy as np
import pytest
import synthetic_stereo as ss
import synthetic_window as sw

from vins_core import params as settings
from vins_core.geometry import se3
from vins_core.params import Params
from vins_core.solver.covariance import covariances, relative_poses
from vins_core.solver.ipopt import compare_optimum
from vins_core.solver.linearize import Linearizer
from vins_core.solver.problem import WindowProblem
from vins_core.solver.solve import solve
from vins_core.window.assemble import assemble, solve_report, unpack
from vins_core.window.departure import oldest_leaves
from vins_core.window.marginalize import marginalize_oldest, marginalize_second_newest
from vins_core.window.prior_analysis import information
from vins_core.window.slide import drop_oldest, drop_second_newest
from vins_core.window.state import WindowState

PARAMS = settings.replace(Params(), {"window.max_iterations": 30})


def problem_of(window: WindowState, **options: object) -> WindowProblem:
    return replace(assemble(PARAMS, window, sw.GRAVITY).problem, **options)


def pose_errors_m(window: WindowState, truth: WindowState) -> np.ndarray:
    """Distances of the bodies with both windows seen from their oldest body."""
    ours, theirs = (ss.poses_of(w.frames) for w in (window, truth))
    return np.linalg.norm((se3.inverse(ours[0]) @ ours - se3.inverse(theirs[0]) @ theirs)[:, :3, 3], axis=1)


def solved(window: WindowState) -> WindowState:
    assembly = assemble(PARAMS, window, sw.GRAVITY)
    return unpack(window, assembly, solve(PARAMS, assembly.problem).states)


def test_every_sight_of_the_second_camera_is_one_factor_of_its_kind() -> None:
    window = ss.make(n_tracks=80).window
    problem = problem_of(window)
    cross, same = problem.stereo
    assert (cross.kind, same.kind) == ("cross", "same")
    assert (cross.observer > cross.anchor).all() and (same.observer == same.anchor).all()
    ids = assemble(PARAMS, window, sw.GRAVITY).ids
    seen = sum(np.isin(f.observations.right.ids, ids).sum() for f in window.frames if f.observations.right)
    assert len(cross) + len(same) == seen > 100


@pytest.mark.parametrize("form", ["plane", "sphere"])
@pytest.mark.parametrize("inertial", [True, False])
def test_exact_data_recover_motion_depth_and_scale(form: str, inertial: bool) -> None:
    """Without IMU the baseline between the cameras alone says how large the world is."""
    options = {} if inertial else {"imu_noise": 0.0}
    flight = ss.make(3, right_sigma_px=0.0, pixel_sigma=0.0, n_tracks=100, **options)
    params = settings.replace(PARAMS, {"projection.residual": form})
    window, truth = flight.window, flight.truth
    if not inertial:
        frames = tuple(replace(f, p_w_b=1.15 * f.p_w_b) for f in window.frames)
        table = replace(window.landmarks, inv_depth=window.landmarks.inv_depth / 1.15)
        window = ss.without_imu(replace(window, frames=frames, landmarks=table))
    assembly = assemble(params, window, sw.GRAVITY)
    after = unpack(window, assembly, solve(params, assembly.problem).states)
    assert pose_errors_m(window, truth).max() > 0.03
    assert pose_errors_m(after, truth).max() < (2e-2 if inertial else 1e-6)
    rows = np.searchsorted(after.landmarks.ids, assembly.ids)
    relative = after.landmarks.inv_depth[rows] / truth.landmarks.inv_depth[rows] - 1
    assert np.abs(relative).max() < (2e-2 if inertial else 1e-6)


def test_without_imu_the_oldest_pose_is_held_whole_and_velocities_follow_from_positions() -> None:
    window = ss.without_imu(ss.make(2, n_tracks=100).window)
    after = solved(window)
    np.testing.assert_allclose(after.frames[0].p_w_b, window.frames[0].p_w_b, atol=1e-9)
    np.testing.assert_allclose(after.frames[0].q_w_b, window.frames[0].q_w_b, atol=1e-9)
    for before, frame in zip(after.frames, after.frames[1:]):
        dt_s = (frame.t_ns - before.t_ns) * 1e-9
        np.testing.assert_allclose(frame.v_w_b, (frame.p_w_b - before.p_w_b) / dt_s, atol=1e-9)
        assert not frame.b_a.any() and not frame.b_g.any()


@pytest.mark.parametrize("free_extrinsics", [False, True])
@pytest.mark.parametrize("inertial", [True, False])
def test_normal_equations_are_those_of_the_stacked_jacobian(inertial: bool, free_extrinsics: bool) -> None:
    window = ss.make(1, n_frames=7, n_tracks=50).window
    problem = problem_of(window if inertial else ss.without_imu(window), free_extrinsics=free_extrinsics)
    J, r, linearizer = dense.jacobian(problem)
    system = Linearizer(problem).linearize(problem.initial)
    D, P = linearizer.layout.size, linearizer.layout.visual
    assert (63 * inertial, 6 * (7 + 2 * free_extrinsics)) == (D - P, P)
    scale = np.sqrt(np.maximum(np.diag(J.T @ J), 1e-12))
    H = np.zeros((len(scale), len(scale)))
    H[:D, :D], H[D:, :P], H[:P, D:] = system.H, system.W, system.W.T
    H[range(D, len(H)), range(D, len(H))] = system.h
    np.testing.assert_allclose(H / np.outer(scale, scale), J.T @ J / np.outer(scale, scale), atol=1e-10)
    np.testing.assert_allclose(np.append(system.g, system.g_l) / scale, J.T @ r / scale, atol=1e-7)


@pytest.mark.parametrize("inertial", [True, False])
@pytest.mark.parametrize("method", ["lm", "dogleg"])
def test_ipopt_finds_no_better_optimum(inertial: bool, method: str) -> None:
    window = solved(ss.make(4, n_frames=8, n_tracks=80).window)
    problem = problem_of(window if inertial else ss.without_imu(window))
    solution = solve(settings.replace(PARAMS, {"solver.method": method}), problem)
    compared = compare_optimum(problem, solution)
    assert abs(compared.excess) < 1e-4
    assert compared.p_m.max() < 1e-3


@pytest.mark.parametrize("inertial", [True, False])
def test_the_prior_is_the_schur_complement_of_all_that_touched_the_oldest_frame(inertial: bool) -> None:
    window = ss.make(5, n_frames=7, n_tracks=60).window
    window = solved(window if inertial else ss.without_imu(window))
    departure = oldest_leaves(PARAMS, window, sw.GRAVITY)
    prior, report = marginalize_oldest(PARAMS, window, sw.GRAVITY)
    assert prior is not None and [b.kind for b in prior.blocks].count("extrinsic") == 2
    assert any(b.kind == "speed_bias" for b in prior.blocks) == inertial
    H, m = information(departure), report.m
    expected = H[m:, m:] - H[m:, :m] @ np.linalg.pinv(H[:m, :m], rcond=1e-14, hermitian=True) @ H[:m, m:]
    scale = np.sqrt(np.diag(H)[m:])
    np.testing.assert_allclose(
        prior.J.T @ prior.J / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6
    )


def test_first_estimates_at_the_current_states_are_the_normal_equations() -> None:
    departure = oldest_leaves(PARAMS, solved(ss.make(6, n_frames=7, n_tracks=60).window), sw.GRAVITY)
    assert len([t for t in departure.problem.tables if t.kind != "mono"]) == 2
    plain = departure.projections()
    by_hand = departure._projections_at_first_estimates(replace(departure.problem, imu=(), prior=None))
    assert plain is not None
    for a, b in ((plain.H, by_hand.H), (plain.g, by_hand.g), (plain.W, by_hand.W), (plain.h, by_hand.h)):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(a).max())


@pytest.mark.parametrize("inertial", [True, False])
def test_a_window_slides_and_goes_on(inertial: bool) -> None:
    """The prior of a solved window does not move the next solve, and either frame may leave."""
    window = ss.make(7, n_frames=8, n_tracks=120, perturbation=0.3).window
    window = solved(window if inertial else ss.without_imu(window))
    prior, _ = marginalize_oldest(PARAMS, window, sw.GRAVITY)
    slid = drop_oldest(replace(window, prior=prior))
    again = solved(slid)
    assert pose_errors_m(again, slid).max() < 0.02
    prior, _ = marginalize_second_newest(PARAMS, again, sw.GRAVITY)
    shorter = drop_second_newest(replace(again, prior=prior), sw.NOISE)
    assert pose_errors_m(solved(shorter), shorter).max() < 0.02


def test_covariance_of_a_stereo_window_without_imu_grows_away_from_the_held_pose() -> None:
    window = solved(ss.without_imu(ss.make(8, n_frames=7, n_tracks=80).window))
    problem = problem_of(window)
    known = covariances(problem, problem.initial)
    assert known is not None and np.isnan(known.speed_biases).all()
    sigma_m = np.sqrt(np.trace(known.poses[:, :3, :3], axis1=1, axis2=2))
    assert sigma_m[0] < 1e-5 and sigma_m[-1] > sigma_m[1] > sigma_m[0]


def test_a_window_without_any_factor_stays_where_it_is() -> None:
    """As one without IMU is at its first frame."""
    window = ss.without_imu(ss.make(9, n_frames=3, n_tracks=40).window)
    params = settings.replace(PARAMS, {"window.min_observations": 4})
    problem = assemble(params, window, sw.GRAVITY).problem
    assert not problem.tables and not problem.imu
    solution = solve(params, problem)
    np.testing.assert_array_equal(solution.states.poses, problem.initial.poses)
    assert covariances(problem, problem.initial) is None
    assert relative_poses(problem, problem.initial, [(0, 1)], solution.system) == [None]


def test_the_report_says_which_camera_saw_what() -> None:
    window = ss.make(n_tracks=80).window
    assembly = assemble(PARAMS, window, sw.GRAVITY)
    report = solve_report(assembly, solve(PARAMS, assembly.problem))
    by_camera = np.bincount(report.visual_camera)
    assert by_camera.tolist() == [len(assembly.problem.projections), sum(map(len, assembly.problem.stereo))]
    own_frame = report.visual_slots[:, 0] == report.visual_slots[:, 1]
    assert (report.visual_camera[own_frame] == 1).all() and own_frame.sum() == len(assembly.problem.stereo[1])
    assert len(report.visual_ids) == len(report.visual_error_px) == len(report.visual_camera)
