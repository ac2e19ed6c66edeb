"""A window that sees an earlier place again: its pose is found, and the window learns no more than it should."""

from dataclasses import replace

import dense
import numpy as np
import pytest
import synthetic_window as sw
from same import differences

from vins_core import params as settings
from vins_core.factors.prior import difference_poses
from vins_core.geometry import poses, se3, so3
from vins_core.params import Params
from vins_core.report import KeyframeReport
from vins_core.sensors import Calibration
from vins_core.solver.covariance import covariances
from vins_core.solver.ipopt import compare_optimum
from vins_core.solver.problem import hold_oldest, retract_poses
from vins_core.solver.trust_region import rules
from vins_core.window.relocalize import MIN_FACTORS, RelocalisationRequest
from vins_core.window.state import WindowState
from vins_core.window.step import Solved, estimate, solve_window

QUERY = 8
"""Slot of the later keyframe: the second newest when the loop stage saw it, one slot further in the next frame."""
PARAMS = settings.replace(Params(), {"window.max_iterations": 30})
CALIBRATION = Calibration((), sw.NOISE, sw.GRAVITY)
ELSEWHERE = np.concatenate([[0.3, -0.4, 0.15], so3.exp(np.array([0.06, -0.1, 0.2]))])
"""T_q_m: the earlier body as the later one sees it."""


def request(
    truth: WindowState,
    *,
    query: int = QUERY,
    T_q_m: np.ndarray = ELSEWHERE,
    T_b_c: np.ndarray = sw.T_B_C,
    off: float = 1.0,
    sigma_px: float = 0.0,
    match: int = 3,
) -> RelocalisationRequest:
    """What the loop stage would ask about a body at T_q_m: true rays, and a start that is off by 10 cm and 3 deg.

    `query` is a slot of the window, which is the end of `truth`.
    """
    rng = np.random.default_rng(5)
    slot = query + len(truth.frames) - 11
    later, table = truth.frames[slot], truth.landmarks
    T_w_m = poses.compose(np.concatenate([later.p_w_b, later.q_w_b]), T_q_m)
    mine, known = np.isin(table.ids, later.observations.ids), {}
    for frame in reversed(truth.frames[:slot]):  # so that the first one that sees a landmark is its anchor
        T_w_c = matrix(np.concatenate([frame.p_w_b, frame.q_w_b])) @ sw.T_B_C
        for i, ray in zip(frame.observations.ids, frame.observations.rays):
            known[i] = (T_w_c, ray)
    rows = [r for r in np.flatnonzero(mine) if table.ids[r] in known]
    points_w = [
        se3.transform(T_w_c, ray / ray[2] / table.inv_depth[r])
        for r, (T_w_c, ray) in ((r, known[table.ids[r]]) for r in rows)
    ]
    local = se3.transform(se3.inverse(matrix(T_w_m) @ T_b_c), np.array(points_w))
    rows, local = np.array(rows)[local[:, 2] > 0.3], local[local[:, 2] > 0.3]
    rays = local / np.linalg.norm(local, axis=1, keepdims=True) + sigma_px / 460 * rng.normal(size=local.shape)
    start = retract_poses(T_w_m[None], off * np.array([[0.06, -0.06, 0.06, 0.03, -0.03, 0.03]]))[0]
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return RelocalisationRequest(40, match, later.frame, start, T_b_c, table.ids[rows], rays)


def matrix(T: np.ndarray) -> np.ndarray:
    return se3.from_quaternion_translation(T[3:], T[:3])


def solved(window: WindowState, *requests: RelocalisationRequest, params: Params = PARAMS) -> Solved:
    return solve_window(params, CALIBRATION, window, {}, requests)


def stacked(window: WindowState) -> np.ndarray:
    return np.array([np.concatenate([f.p_w_b, f.q_w_b]) for f in window.frames])


@pytest.fixture(scope="module")
def exact():
    return sw.make(pixel_sigma=0.0, imu_noise=0.0, imu_hz=2000.0, n_tracks=200)


@pytest.fixture(scope="module")
def flight():
    """A window with a prior, and the truth about all frames there have been, where every landmark has its anchor."""
    return replace(sw.steady(PARAMS, n_tracks=300), truth=sw.make(n_frames=12, n_tracks=300).truth)


def test_with_exact_data_the_pose_of_the_place_is_found(exact):
    (found,) = solved(exact.window, request(exact.truth)).relocalizations
    expected = poses.inverse(ELSEWHERE)
    assert found.n_factors > 30 and found.error_px_before > 5 and found.error_px_after < 1e-3
    np.testing.assert_allclose(found.T_match_query[:3], expected[:3], atol=1e-5)
    np.testing.assert_allclose(so3.difference(found.T_match_query[3:], expected[3:]), 0, atol=1e-5)


@pytest.mark.parametrize("form", ["plane", "sphere"])
def test_a_camera_that_was_mounted_in_another_way_changes_nothing(exact, form):
    params = settings.replace(PARAMS, {"projection.residual": form})
    mounted = sw.T_B_C @ se3.from_quaternion_translation(
        so3.exp(np.array([0.3, -0.2, 0.5])), np.array([0.2, 0.1, -0.3])
    )
    (found,) = solved(exact.window, request(exact.truth, T_b_c=mounted), params=params).relocalizations
    expected = poses.inverse(ELSEWHERE)
    np.testing.assert_allclose(found.T_match_query[:3], expected[:3], atol=1e-5)
    np.testing.assert_allclose(so3.difference(found.T_match_query[3:], expected[3:]), 0, atol=1e-5)


def test_the_covariance_knows_how_the_camera_was_mounted(flight):
    """The covariance of another body in the same place follows by turning that of the first."""
    turn = se3.from_quaternion_translation(so3.exp(np.array([0.3, -0.2, 0.5])), np.zeros(3))
    asked = request(flight.truth, sigma_px=0.7)
    other = replace(asked, T_b_c=turn @ asked.T_b_c, T_w_match=poses.compose(asked.T_w_match, poses.inverse(row(turn))))
    (a,), (b,) = (solved(flight.window, r).relocalizations for r in (asked, other))
    A = np.eye(6)
    A[:3, :3] = turn[:3, :3]
    np.testing.assert_allclose(b.covariance, A @ a.covariance @ A.T, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(b.T_match_query[:3], turn[:3, :3] @ a.T_match_query[:3], atol=1e-9)


def row(T: np.ndarray) -> np.ndarray:
    return np.concatenate([T[:3, 3], so3.from_matrix(T[:3, :3])])


def test_a_consistent_place_moves_the_window_within_what_it_does_not_know(flight):
    plain, seen = solved(flight.window), solved(flight.window, request(flight.truth, sigma_px=0.7))
    problem = plain.assembly.problem
    states = [hold_oldest(s.solution.states, problem.initial.poses[0]) for s in (plain, seen)]
    moved = difference_poses(states[1].poses[: problem.n_frames], states[0].poses)
    known = covariances(problem, states[0])
    sigma = np.sqrt(np.maximum(np.diagonal(known.poses, axis1=1, axis2=2), 0))[1:]
    assert np.abs(moved[1:] / sigma).max() < 1.0
    assert np.abs(moved).max() > 0  # it is seen by landmarks, which it does move


def test_what_a_place_adds_is_information(flight):
    """Its factors make nothing less known: the covariance falls by a positive semi-definite matrix."""
    plain, seen = solved(flight.window), solved(flight.window, request(flight.truth, sigma_px=0.7))
    states, n = seen.solution.states, plain.assembly.problem.n_frames
    alone = replace(states, poses=states.poses[:n])
    before = covariances(plain.assembly.problem, alone)
    after = covariances(seen.assembly.problem, states)
    assert before.poses.shape == after.poses.shape == (n, 6, 6)
    for a, b in zip(before.poses[1:], after.poses[1:]):
        assert np.linalg.eigvalsh(a - b).min() > -1e-6 * np.linalg.eigvalsh(a).max()


def test_the_covariance_is_the_marginal_one_of_the_dense_problem(flight):
    turn = solved(flight.window, request(flight.truth, sigma_px=0.7))
    (found,), states = turn.relocalizations, turn.solution.states
    problem = replace(turn.assembly.problem, initial=states)
    J, _, linearizer = dense.jacobian(problem)
    scale = 1 / np.linalg.norm(J, axis=0)
    hold = np.zeros((4, J.shape[1]))
    hold[:3, :3] = np.eye(3)
    hold[3, 3:6] = so3.rotate(so3.inverse(states.poses[0, 3:]), np.array([0.0, 0.0, 1.0]))
    R = np.linalg.qr(np.concatenate([J, 1e6 * hold]) * scale, mode="r")
    A, D, h, match = np.zeros((6, J.shape[1])), linearizer.layout.size, 1e-6, problem.n_frames

    def relative(at):
        return poses.between(at.poses[match], at.poses[QUERY])

    for k in range(D):
        d = np.zeros(D)
        d[k] = h
        up, down = (relative(linearizer.retract(states, s * d, np.zeros(J.shape[1] - D))) for s in (1, -1))
        A[:, k] = difference_poses(up[None], down[None])[0] / (2 * h)
    half = np.linalg.solve(R.T, (A * scale).T)
    expected = half.T @ half
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-3)


def test_the_normal_equations_are_those_of_the_dense_problem(flight):
    problem = solved(flight.window, request(flight.truth), request(flight.truth, query=5)).assembly.problem
    assert (problem.n_frames, problem.n_places) == (11, 2)
    J, r, linearizer = dense.jacobian(problem)
    system, D = linearizer.linearize(problem.initial), linearizer.layout.size
    A, scale = J.T @ J, 1 / np.linalg.norm(J, axis=0)
    P = linearizer.layout.visual
    for ours, expected, s in (
        (system.H, A[:D, :D], np.outer(scale[:D], scale[:D])),
        (system.W, A[D:, :P], np.outer(scale[D:], scale[:P])),
        (system.g, J[:, :D].T @ r, scale[:D]),
    ):
        np.testing.assert_allclose(ours * s, expected * s, atol=1e-6 * np.abs(expected * s).max())


@pytest.mark.parametrize("change", [{"frame": 7}, None])
def test_without_a_request_about_the_window_the_bits_are_the_same(flight, change):
    requests = () if change is None else (replace(request(flight.truth), **change),)
    assert differences(solve_window(PARAMS, CALIBRATION, flight.window, {}), solved(flight.window, *requests)) == []


def test_too_few_landmarks_give_no_pose_and_leave_the_window_alone(flight):
    asked = request(flight.truth)
    few = replace(asked, track_ids=asked.track_ids[: MIN_FACTORS - 1], rays=asked.rays[: MIN_FACTORS - 1])
    turn = solved(flight.window, few)
    (found,) = turn.relocalizations
    assert found.covariance is None and np.isnan(found.error_px).all() and found.n_factors == MIN_FACTORS - 1
    np.testing.assert_allclose(found.T_w_match, few.T_w_match, atol=1e-12)
    assert differences(replace(turn, relocalizations=()), solved(flight.window)) == []


def test_several_places_find_what_each_finds_alone(exact):
    asked = [request(exact.truth, query=slot, match=slot) for slot in (4, 6, 8)]
    few = replace(asked[1], track_ids=asked[1].track_ids[:2], rays=asked[1].rays[:2])
    together = solved(exact.window, asked[0], few, *asked[1:]).relocalizations
    assert [r.match for r in together] == [4, 6, 6, 8] and together[1].covariance is None
    for alone, found in zip(asked, (together[0], *together[2:])):
        (expected,) = solved(exact.window, alone).relocalizations
        np.testing.assert_array_equal(found.ids, expected.ids)
        np.testing.assert_allclose(found.T_match_query, expected.T_match_query, atol=1e-5)


def test_wrong_rays_of_a_place_accuse_no_landmark(flight):
    asked = request(flight.truth)
    rolled = replace(asked, rays=np.roll(asked.rays, 1, axis=0))
    plain, turn = solved(flight.window), solved(flight.window, rolled)
    assert turn.relocalizations[0].error_px_after > 20
    assert differences(plain.report.visual_slots, turn.report.visual_slots) == []
    assert turn.report.visual_slots.max() < len(flight.window.frames)
    for reason, ids in plain.rejected.items():
        np.testing.assert_array_equal(turn.rejected[reason], ids)


@pytest.mark.parametrize("is_keyframe", [True, False])
def test_a_place_is_never_marginalised(flight, is_keyframe):
    decision = KeyframeReport(is_keyframe, "", 20.0, 20.0, 100, 50, 5, ())
    done = estimate(PARAMS, CALIBRATION, flight.window, decision, None, {}, (request(flight.truth),))
    assert done.window is not None and len(done.relocalizations) == 1 and done.window.prior is not None
    frames = {f.frame for f in done.window.frames}
    assert {b.id for b in done.window.prior.blocks if b.kind != "extrinsic"} <= frames
    assert len(done.window_report.error_px) == len(done.window_report.frames) == len(flight.window.frames)


def test_ipopt_finds_the_same_place(flight):
    turn = solved(flight.window, request(flight.truth, sigma_px=0.7))
    problem, states = turn.assembly.problem, turn.solution.states
    away = states.poses.copy()
    away[-1] = retract_poses(away[-1:], np.array([[0.1, -0.1, 0.05, 0.05, 0.1, -0.05]]))[0]
    problem = replace(problem, initial=replace(states, poses=away))
    against = compare_optimum(problem, turn.solution, rules(PARAMS.solver).holds_gauge)
    assert abs(against.excess) < 1e-5
    assert len(against.p_m) == 12 and against.p_m[-1] < 1e-3 and against.rotation_deg[-1] < 1e-2


def test_the_report_stands_where_the_window_does(flight):
    """`unpack` puts the window back by yaw and position; the place goes with it."""
    turn = solved(flight.window, request(flight.truth, sigma_px=0.7))
    (found,) = turn.relocalizations
    later = turn.solved.frames[QUERY]
    T_w_query = poses.compose(found.T_w_match, found.T_match_query)
    np.testing.assert_allclose(T_w_query[:3], later.p_w_b, atol=1e-9)
    np.testing.assert_allclose(so3.difference(T_w_query[3:], later.q_w_b), 0, atol=1e-9)
