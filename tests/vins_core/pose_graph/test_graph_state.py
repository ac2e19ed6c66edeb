import numpy as np
import pytest
from pose_graph_world import append, laps, settings, trajectory

from vins_core.geometry import heading, poses, so3
from vins_core.pose_graph import graph as G
from vins_core.pose_graph.edges import active_edges, sequential_pairs
from vins_core.pose_graph.optimize import optimize

TRUTH = trajectory(40, 20)
NO_LOOPS = np.zeros((0, 2)), np.zeros((0, 7))


def grown(n: int = 5) -> G.PoseGraph:
    graph = G.PoseGraph()
    for k in range(n):
        graph = G.add_keyframe(graph, 3 * k, k, TRUTH[k, :3], TRUTH[k, 3:])
    return graph


def two_sessions(turn: float = 0.7, offset=(4.0, -3.0, 1.0)) -> G.PoseGraph:
    """The second session sees the same lap from a world of its own."""
    moved = np.append(offset, heading.about_gravity(turn))
    first = append(G.begin_session(G.PoseGraph()), TRUTH[:20], *NO_LOOPS)
    return append(G.begin_session(first), poses.compose(moved, TRUTH[20:]), *NO_LOOPS)


def loop(graph: G.PoseGraph, i: int, j: int, **changes) -> G.PoseGraph:
    """A loop that measures the truth."""
    T = poses.between(TRUTH[i], TRUTH[j])
    return G.add_loop(settings(**changes), graph, i, j, T[:3], T[3:])


def test_a_state_never_changes_when_later_ones_grow_from_it():
    past = grown(5)
    frames, T = past.frame.copy(), past.T_vio.copy()
    now = past
    for k in range(5, 200):
        now = G.add_keyframe(now, 3 * k, k, np.zeros(3), np.array([1.0, 0, 0, 0]))
    assert len(past) == 5 and len(now) == 200
    np.testing.assert_array_equal(past.frame, frames)
    np.testing.assert_array_equal(past.T_vio, T)


def test_a_fork_shares_the_past_and_appends_privately():
    past = grown(5)
    here = G.add_keyframe(past, 100, 0, np.zeros(3), np.array([1.0, 0, 0, 0]))
    fork = G.add_keyframe(past, 200, 0, np.ones(3), np.array([1.0, 0, 0, 0]))
    assert np.shares_memory(here.T_vio, past.T_vio)
    assert here.frame.tolist() == [0, 3, 6, 9, 12, 100]
    assert fork.frame.tolist() == [0, 3, 6, 9, 12, 200]
    assert G.add_keyframe(here, 101, 0, np.zeros(3), TRUTH[0, 3:]).frame.tolist()[-2:] == [100, 101]


def test_what_a_state_shows_cannot_be_written():
    graph = grown()
    for array in (graph.T_vio, graph.frame, graph.loops):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_every_keyframe_is_tied_to_the_previous_ones_of_its_session_only():
    graph = two_sessions()
    i, j = sequential_pairs(graph, 4)
    assert set(zip(i.tolist(), j.tolist(), strict=True)) == {
        (a, b) for b in range(40) for a in range(max(b - 4, 0), b) if (a < 20) == (b < 20)
    }


def test_ties_measure_what_the_odometry_said_even_after_an_optimisation():
    world = laps()
    optimized, _ = optimize(settings(), world.graph)
    edges = active_edges(settings(), optimized)
    ties = edges[~edges.is_loop]
    np.testing.assert_allclose(
        poses.compose(world.graph.T_vio[ties.i], ties.T_i_j)[:, :3], world.graph.T_vio[ties.j, :3], atol=1e-12
    )


def test_keyframes_after_an_optimisation_follow_by_the_drift_of_their_session():
    graph, _ = optimize(settings(), laps().graph)
    step = poses.between(graph.T_vio[-2], graph.T_vio[-1])
    T = poses.compose(graph.T_vio[-1], step)
    longer = G.add_keyframe(graph, 0, 0, T[:3], T[3:])
    np.testing.assert_allclose(
        poses.between(longer.T_corrected[-2], longer.T_corrected[-1])[:3],
        poses.between(graph.T_vio[-1], T)[:3],
        atol=1e-9,
    )
    assert np.linalg.norm(longer.T_corrected[-1, :3] - T[:3]) > 0.01


@pytest.mark.parametrize("dof", ["4", "6"])
def test_the_first_loop_to_another_session_moves_all_of_the_younger_one(dof):
    graph = loop(two_sessions(), 3, 25, dof=dof)
    np.testing.assert_allclose(graph.T_corrected[:, :3], TRUTH[:, :3], atol=1e-9)
    assert {s.group for s in graph.sessions} == {0}
    later = G.add_keyframe(graph, 0, 0, graph.T_vio[-1, :3], graph.T_vio[-1, 3:])
    np.testing.assert_allclose(later.T_corrected[-1], later.T_corrected[-2], atol=1e-12)


def test_a_second_loop_between_the_same_sessions_moves_nothing():
    once = loop(two_sessions(), 3, 25)
    wrong = G.add_loop(settings(), once, 4, 30, np.full(3, 9.0), TRUTH[0, 3:])
    np.testing.assert_array_equal(wrong.T_corrected, once.T_corrected)


def test_sessions_that_share_a_frame_move_together():
    third = append(G.begin_session(two_sessions()), TRUTH[:10], *NO_LOOPS)
    T = poses.between(TRUTH[30], TRUTH[5])
    joined = G.add_loop(settings(), third, 30, 45, T[:3], T[3:])  # third to second: a group of their own
    assert [s.group for s in joined.sessions] == [0, 1, 1]
    all_three = loop(joined, 2, 22)
    assert [s.group for s in all_three.sessions] == [0, 0, 0]
    np.testing.assert_allclose(all_three.T_corrected[:40, :3], TRUTH[:, :3], atol=1e-9)
    np.testing.assert_allclose(all_three.T_corrected[40:, :3], TRUTH[:10, :3], atol=1e-9)


def test_a_merge_with_four_degrees_of_freedom_keeps_roll_and_pitch():
    graph = two_sessions()
    tilted = so3.multiply(TRUTH[25, 3:], so3.exp(np.array([0.2, 0.1, 0])))
    T = poses.between(TRUTH[3], np.append(TRUTH[25, :3], tilted))
    merged = G.add_loop(settings(), graph, 3, 25, T[:3], T[3:])
    up = np.array([0, 0, 1.0])
    np.testing.assert_allclose(
        so3.rotate(so3.inverse(merged.T_corrected[:, 3:]), up),
        so3.rotate(so3.inverse(graph.T_vio[:, 3:]), up),
        atol=1e-12,
    )


def test_a_loop_needs_two_keyframes_that_exist_in_order():
    for pair in ((3, 3), (4, 2), (0, 40), (-1, 3)):
        with pytest.raises(ValueError, match="no loop between"):
            G.add_loop(settings(), two_sessions(), *pair, np.zeros(3), TRUTH[0, 3:])


def test_disabled_edges_are_left_out_and_forced_loops_marked():
    graph = loop(loop(two_sessions(), 3, 25), 5, 30)
    all_of_them = active_edges(settings(), graph)
    edges = active_edges(settings(), G.force(G.disable(G.disable(graph, 3, 25), 7, 8), 5, 30))
    assert len(edges) == len(all_of_them) - 2
    assert [tuple(p) for p in np.stack([edges.i, edges.j], 1)[edges.is_loop]] == [(5, 30)]
    assert edges.is_forced.tolist() == edges.is_loop.tolist()
    again = G.force(G.disable(G.disable(graph, 3, 25), 3, 25, off=False), 5, 30, on=False)
    assert len(active_edges(settings(), again)) == len(all_of_them) and not again.forced


def test_a_result_is_adopted_by_a_graph_that_has_grown():
    world = laps()
    optimized, _ = optimize(settings(), world.graph)
    grown_meanwhile = G.add_keyframe(world.graph, 0, 0, world.graph.T_vio[-1, :3], world.graph.T_vio[-1, 3:])
    adopted = G.adopt(grown_meanwhile, optimized)
    assert len(adopted) == len(world.graph) + 1
    np.testing.assert_array_equal(adopted.T_corrected[:-1], optimized.T_corrected)
    np.testing.assert_allclose(adopted.T_corrected[-1], optimized.T_corrected[-1], atol=1e-12)


def test_a_result_from_before_a_merge_is_not_adopted():
    before = loop(two_sessions(), 2, 15)
    optimized, _ = optimize(settings(), before)
    merged = loop(before, 3, 25)
    np.testing.assert_array_equal(G.adopt(merged, optimized).T_corrected, merged.T_corrected)
