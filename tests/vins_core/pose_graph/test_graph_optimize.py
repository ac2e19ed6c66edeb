from dataclasses import replace

import numpy as np
import pytest
from pose_graph_world import LEVEL, UPRIGHT, append, build, displaced, drifting, laps, settings, trajectory
from same import differences

from vins_core import params as P
from vins_core.geometry import heading, poses, so3
from vins_core.pose_graph import graph as G
from vins_core.pose_graph.optimize import evaluate, optimize
from vins_core.pose_graph.presets import PRESETS
from vins_core.pose_graph.problem import assemble

EXACT = {"step_m": 0.0, "turn_deg": 0.0, "loop_m": 0.0, "loop_deg": 0.0}
PATIENT = {"max_iterations": 60, "function_tolerance": 1e-12}
UP = np.array([0, 0, 1.0])
NO_LOOPS = np.zeros((0, 2)), np.zeros((0, 7))


def preset(name: str) -> P.PoseGraph:
    return P.replace(P.Params(), PRESETS[name]).pose_graph


@pytest.mark.parametrize("dof", ["4", "6"])
def test_a_known_graph_is_recovered_from_a_wrong_start(dof):
    world = laps(**EXACT)
    first, last = world.graph.loops.min(), world.graph.loops.max()
    start = displaced(world.graph, first, dof=int(dof))
    optimized, report = optimize(settings(dof=dof, loss="none", **PATIENT), start)
    assert world.error_m(start)[first + 1 : last].min() > 0.01
    np.testing.assert_allclose(optimized.T_corrected[:, :3], world.truth[:, :3], atol=1e-7)
    np.testing.assert_allclose(so3.difference(optimized.T_corrected[:, 3:], world.truth[:, 3:]), 0, atol=1e-7)
    assert report.after.total < 1e-12 < report.before.total


@pytest.mark.parametrize("dof", ["4", "6"])
def test_loops_take_out_most_of_the_drift(dof):
    world = laps(n=400, n_loops=120)
    optimized, _ = optimize(settings(dof=dof), world.graph)
    before, after = world.error_m(world.graph), world.error_m(optimized)
    assert np.sqrt(np.mean(after**2)) < 0.4 * np.sqrt(np.mean(before**2))


def test_the_earliest_looped_keyframe_and_all_before_it_stay():
    world = laps()
    first = world.graph.loops.min()
    optimized, report = optimize(settings(), world.graph)
    assert report.first_free == first + 1
    np.testing.assert_array_equal(optimized.T_corrected[: first + 1], world.graph.T_corrected[: first + 1])
    moved = np.linalg.norm(optimized.T_corrected[first + 1 :, :3] - world.graph.T_corrected[first + 1 :, :3], axis=1)
    assert moved.min() > 0


def test_a_graph_that_was_moved_as_a_whole_comes_out_moved_as_a_whole():
    world = laps()
    moved = np.append([5.0, -7, 2], heading.about_gravity(2.0))
    elsewhere = replace(world.graph, optimized=poses.compose(moved, world.graph.T_corrected))
    here, _ = optimize(settings(**PATIENT), world.graph)
    there, _ = optimize(settings(**PATIENT), elsewhere)
    np.testing.assert_allclose(there.T_corrected[:, :3], poses.compose(moved, here.T_corrected)[:, :3], atol=1e-6)


def test_four_degrees_of_freedom_keep_roll_and_pitch_and_six_do_not():
    world = laps(loop_deg=2.0)
    tilt = {}
    for dof in ("4", "6"):
        optimized, _ = optimize(settings(dof=dof), world.graph)
        seen = (so3.rotate(so3.inverse(T[:, 3:]), UP) for T in (optimized.T_corrected, world.graph.T_vio))
        tilt[dof] = np.abs(np.subtract(*seen)).max()
    assert tilt["4"] < 1e-12 and tilt["6"] > 1e-4


@pytest.mark.parametrize("dof", ["4", "6"])
def test_how_the_imu_is_mounted_changes_nothing(dof):
    """Not even an IMU whose Euler pitch is -90 degrees all the time (REFERENCE 23.1)."""
    level, upright = (optimize(settings(dof=dof), laps(mount=mount).graph)[0] for mount in (LEVEL, UPRIGHT))
    np.testing.assert_allclose(upright.T_corrected[:, :3], level.T_corrected[:, :3], atol=1e-7)
    expected = so3.multiply(level.T_corrected[:, 3:], UPRIGHT)
    np.testing.assert_allclose(so3.difference(upright.T_corrected[:, 3:], expected), 0, atol=1e-7)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_robust_loss_ignores_planted_wrong_loops(loss, seed):
    world = laps(n=300, n_loops=80, wrong=0.1, seed=seed)
    assert world.wrong.sum() >= 5
    right = ~world.wrong
    without, _ = optimize(settings(), build(world.graph.T_vio, world.graph.loops[right], world.graph.T_loops[right]))

    def harm(loss: str) -> tuple[float, np.ndarray]:
        """How far the wrong loops move a keyframe, and the weights of all loops."""
        optimized, report = optimize(settings(loss=loss, max_iterations=30), world.graph)
        moved = np.linalg.norm(optimized.T_corrected[:, :3] - without.T_corrected[:, :3], axis=1)
        return moved.max(), report.loop_weight[:, 1]

    moved, weight = harm(loss)
    assert moved < 0.15 * harm("none")[0]
    assert weight[world.wrong].max() < 0.2 and weight[world.wrong].max() < weight[right].min()


def test_a_disabled_edge_counts_as_if_it_had_never_been():
    world = laps()
    graph = world.graph
    i, j = graph.loops[7]
    without = build(graph.T_vio, np.delete(graph.loops, 7, 0), np.delete(graph.T_loops, 7, 0))
    expected, _ = optimize(settings(), without)
    optimized, report = optimize(settings(), G.disable(graph, int(i), int(j)))
    np.testing.assert_array_equal(optimized.T_corrected, expected.T_corrected)
    assert len(report.loops) == len(graph.loops) - 1
    again, _ = optimize(settings(), G.disable(G.disable(graph, int(i), int(j)), int(i), int(j), off=False))
    np.testing.assert_array_equal(again.T_corrected, optimize(settings(), graph)[0].T_corrected)


def test_a_forced_loop_pulls_in_full_where_the_robust_loss_would_let_go():
    world = laps(wrong=0.0)
    graph = append(world.graph, np.zeros((0, 7)), [[60, 150]], np.array([[4.0, 0, 0, 1, 0, 0, 0]]))
    _, ignored = optimize(settings(max_iterations=40), graph)
    _, forced = optimize(settings(max_iterations=40), G.force(graph, 60, 150))
    assert forced.forced[-1] and forced.loop_weight[-1].tolist() == [1, 1]
    assert ignored.loop_weight[-1, 1] < 0.1
    assert forced.loop_error_m[-1, 1] < 0.7 * ignored.loop_error_m[-1, 1]


def test_without_loops_nothing_moves():
    graph = laps().graph
    for i, j in graph.loops.tolist():
        graph = G.disable(graph, i, j)
    for one in (graph, build(graph.T_vio, *NO_LOOPS), G.PoseGraph()):
        optimized, report = optimize(settings(), one)
        assert optimized is one and report.termination == "not started: no loops" and report.n_free == 0


def test_keyframes_after_the_last_loop_follow_rigidly():
    graph = laps().graph
    graph = append(graph, poses.compose(graph.T_vio[-5:], np.array([1.0, 0, 0, 1, 0, 0, 0])), *NO_LOOPS)
    last = int(graph.loops.max())
    optimized, report = optimize(settings(), graph)
    drift = poses.correction(optimized.T_corrected[last:], graph.T_vio[last:])
    np.testing.assert_allclose(drift, np.broadcast_to(drift[0], drift.shape), atol=1e-9)
    np.testing.assert_allclose(report.drift, drift[0], atol=1e-12)
    np.testing.assert_array_equal(optimized.sessions[-1].drift, report.drift)


def test_what_only_follows_does_not_pull():
    """The ties between the last looped keyframe and those after it must not hold it back."""
    short = laps()
    last = int(short.graph.loops.max())
    cut = build(short.graph.T_vio[: last + 1], short.graph.loops, short.graph.T_loops)
    np.testing.assert_allclose(
        optimize(settings(), short.graph)[0].T_corrected[: last + 1],
        optimize(settings(), cut)[0].T_corrected,
        atol=1e-12,
    )


def test_one_heavy_loop_closes_a_long_chain():
    """A chain without noise shares an error in equal parts, as springs in a row do."""
    n = 200
    T = np.zeros((n, 7))
    T[:, 0], T[:, 3] = np.arange(n), 1.0
    loop = np.array([[n - 2.0, 0, 0, 1, 0, 0, 0]])  # one metre shorter than the odometry says
    optimized, _ = optimize(settings(loss="none", loop_weight=1000.0), build(T, [[0, n - 1]], loop))
    steps = np.diff(optimized.T_corrected[:, 0])
    assert optimized.T_corrected[-1, 0] == pytest.approx(n - 2, abs=1e-4)
    np.testing.assert_allclose(steps[10:-10], 1 - 1 / (n - 1), atol=1e-3)


def test_base_sessions_never_move_and_new_ones_move_towards_them():
    world = laps(n_loops=40)
    rng = np.random.default_rng(5)
    base = replace(world.graph, sessions=tuple(replace(s, base=True) for s in world.graph.sessions))
    base = replace(base, optimized=world.truth)
    truth = trajectory(80, 50)
    seen = poses.compose(np.append([3.0, 1, 0], heading.about_gravity(1.0)), drifting(truth, rng, 0.002, 0.1))
    graph = append(G.begin_session(base), seen, *NO_LOOPS)
    for k in range(0, 80, 4):
        T = poses.between(truth[k % 50], truth[k])
        graph = G.add_loop(settings(), graph, k % 50, 160 + k, T[:3], T[3:])
    optimized, report = optimize(settings(), graph)
    np.testing.assert_array_equal(optimized.T_corrected[:160], world.truth)
    assert report.first_free == 160 and report.n_free > 70
    before = np.linalg.norm(graph.T_corrected[160:, :3] - truth[:, :3], axis=1)
    after = np.linalg.norm(optimized.T_corrected[160:, :3] - truth[:, :3], axis=1)
    assert after.max() < 0.5 * before.max()


def test_sessions_that_never_met_are_optimised_each_by_itself():
    one, other = laps(seed=1), laps(seed=2)
    n = len(one.graph)
    both = append(G.begin_session(one.graph), other.graph.T_vio, other.graph.loops + n, other.graph.T_loops)
    optimized, _ = optimize(settings(**PATIENT), both)
    for part, world in ((slice(0, n), one), (slice(n, None), other)):
        alone, _ = optimize(settings(**PATIENT), world.graph)
        np.testing.assert_allclose(optimized.T_corrected[part, :3], alone.T_corrected[:, :3], atol=1e-7)


@pytest.mark.parametrize("loss_on", ["weighted", "unweighted"])
def test_costs_are_those_of_the_formulas(loss_on):
    """One loop that is 2 m and 3 degrees off."""
    T = np.zeros((2, 7))
    T[:, 3] = 1
    off = np.append([2.0, 0, 0], heading.about_gravity(np.deg2rad(3)))[None]
    s = settings(loop_weight=5.0, loop_rotation_weight=0.5, loss_on=loss_on, sigma_m=0.5, sigma_deg=2.0)
    said = evaluate(s, build(T, [[0, 1]], off))
    norm = np.hypot(2.0 / 0.5, 3.0 * 0.5 / 2.0)
    a = s.loss_scale
    cost = 0.5 * (2 * a * 5 * norm - a * a) if loss_on == "weighted" else 0.5 * 25 * (2 * a * norm - a * a)
    assert said.cost.loop == pytest.approx(cost, rel=1e-9) and said.cost.sequential == pytest.approx(0)
    assert said.error_m[-1] == pytest.approx(2) and said.error_deg[-1] == pytest.approx(3)
    assert said.weight[-1] == pytest.approx(a / (norm * (5 if loss_on == "weighted" else 1)))


def test_presets_weigh_edges_as_their_sources_say():
    graph = laps().graph
    deg = 180 / np.pi
    for name, ties, tie, loop in (
        ("parity", 4, (1, deg), (1, deg / 10)),
        ("seed", 5, (1, deg), (1, deg)),
        ("parity-6dof", 4, (10, 100), (10, 100)),
    ):
        s = preset(name)
        problem = assemble(s, graph)
        is_loop = problem.edges.is_loop
        assert problem.variant.dof == (6 if "6dof" in name else 4)
        assert np.bincount(problem.edges.j[~is_loop]).max() == ties
        np.testing.assert_allclose(problem.data[-2:, ~is_loop].T, np.broadcast_to(tie, (np.sum(~is_loop), 2)))
        np.testing.assert_allclose(problem.data[-2:, is_loop].T, np.broadcast_to(loop, (np.sum(is_loop), 2)))
        assert set(problem.outer[is_loop]) == ({5.0} if name == "seed" else {1.0})
        assert (problem.loss.kind, problem.loss.scale) == ("huber", 0.1)
        assert np.array_equal(problem.robust, is_loop)
        _, report = optimize(s, graph)
        assert len(report.iterations) <= 5 and report.after.total < report.before.total


def test_the_damping_of_ceres_takes_longer_to_share_an_error_along_a_chain():
    """Why its first radius is parity and no default."""
    n = 3000
    T = np.zeros((n, 7))
    T[:, 0], T[:, 3] = 0.1 * np.arange(n), 1.0
    graph = build(T, [[0, n - 1]], np.array([[0.1 * n - 3.0, 0, 0, 1, 0, 0, 0]]))
    reports = [
        optimize(settings(loss="none", max_iterations=50, initial_radius=radius, loop_weight=100.0), graph)[1]
        for radius in (1e4, 1e12)
    ]
    assert reports[0].after.total == pytest.approx(reports[1].after.total, rel=1e-4)
    assert len(reports[0].iterations) > 2 * len(reports[1].iterations)


def test_the_same_graph_gives_the_same_bits_and_a_fork_too():
    world = laps()
    first = optimize(settings(), world.graph)
    again = optimize(settings(), world.graph)
    assert not differences(first[1], again[1])
    np.testing.assert_array_equal(first[0].T_corrected, again[0].T_corrected)
    fork = build(world.graph.T_vio.copy(), world.graph.loops.copy(), world.graph.T_loops.copy())
    np.testing.assert_array_equal(first[0].T_corrected, optimize(settings(), fork)[0].T_corrected)


def test_a_second_optimisation_of_an_optimum_moves_nothing():
    once, _ = optimize(settings(**PATIENT), laps().graph)
    twice, report = optimize(settings(**PATIENT), once)
    np.testing.assert_allclose(twice.T_corrected[:, :3], once.T_corrected[:, :3], atol=1e-5)
    assert report.after.total == pytest.approx(report.before.total, rel=1e-9)


def test_a_drift_of_half_a_turn_is_closed_the_short_way():
    """Measured turns are compared modulo 360 degrees: a loop that says +179 and an odometry that says -179."""
    n = 60
    world = trajectory(n, 30)
    turned = heading.about_gravity(np.deg2rad(np.linspace(0, 358, n)))
    T_vio = np.concatenate([world[:, :3], so3.multiply(turned, world[:, 3:])], 1)
    loop = poses.between(world[0], world[-1])[None]
    _, report = optimize(settings(loss="none"), build(T_vio, [[0, n - 1]], loop))
    assert report.loop_error_deg[0, 0] == pytest.approx(2, abs=1e-6)
    assert report.loop_error_deg[0, 1] < 2
