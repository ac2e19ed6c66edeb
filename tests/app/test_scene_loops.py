"""Loops in the 3D view, as arrays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

from app.context import RunView, Selection
from app.graph import EdgeRow, Edits, GraphView
from app.loops import LoopsView
from app.pairs import PairView, Wish
from app.scene.frame import SceneFrame, scene_unit
from app.scene.loops import LoopLayer, accepted, chosen, refused, seen_again, sessions
from vins_core.mapping.study import LoopRow
from vins_core.record.reader import RunReader
from vins_core.report import LoopCandidate, LoopOutcome, LoopReport

N = 8


def edge(earlier: int, later: int, weight: float = 1.0) -> EdgeRow:
    return EdgeRow((earlier, later), (0.1, 0.01), (1.0, 0.1), weight)


@pytest.fixture
def graph() -> GraphView:
    p = np.arange(3.0 * N).reshape(N, 3)
    edges = (edge(0, 5), edge(1, 6, 0.2), edge(2, 7))
    return GraphView(40, Edits(), p, p + 100, np.repeat([0, 1], 4), np.arange(N) < 4, edges, None)


@pytest.fixture(scope="module")
def run(looping_run: Path) -> RunView:
    return RunView(RunReader(looping_run))


def frame(run: RunView, k: int, graph: GraphView | None = None, loops: LoopsView | None = None) -> SceneFrame:
    report = run.report(k)
    return SceneFrame(run, k, report, Selection(), None, np.zeros((0, 3)), scene_unit(report), graph=graph, loops=loops)


def looked_at(run: RunView, earlier: int, later: int, outcome: LoopOutcome) -> LoopsView:
    candidate = LoopCandidate(later, earlier, 0.1, (), outcome)
    row = LoopRow(later, 0, 1, 0, outcome, -1, 1)
    report = LoopReport(later, 0, 0, 9, 9, None, (), (candidate,), outcome)
    return LoopsView(Wish(run, 0, later), pair=PairView(row, report, candidate, None), refused=((0, 4), (3, 12)))


def test_sessions_are_lines_of_their_own(graph: GraphView) -> None:
    assert len(sessions(graph.after, graph.session)) == N - 2
    assert len(sessions(graph.after, np.where(graph.base, -1, graph.session))) == 3


def test_an_edge_that_hardly_counts_is_drawn_thinner_and_one_switched_off_not_at_all(graph: GraphView) -> None:
    firm, doubted = accepted(graph)
    np.testing.assert_array_equal(firm[0], graph.after[[0, 5]])
    np.testing.assert_array_equal(doubted, graph.after[[[1, 6]]])
    assert len(accepted(replace(graph, edits=Edits().switched((0, 5))))[0]) == len(firm) - 1


def test_edges_follow_the_graph_that_the_user_made(graph: GraphView) -> None:
    moved = graph.after + 1.0
    np.testing.assert_array_equal(accepted(replace(graph, edited=moved))[1], moved[[[1, 6]]])


def test_refused_pairs_of_keyframes_that_are_still_to_come_are_not_drawn(run: RunView, graph: GraphView) -> None:
    at = frame(run, 40, graph, looked_at(run, 1, 6, LoopOutcome.ACCEPTED))
    dashes = refused(graph, at)
    np.testing.assert_allclose(dashes[0, 0], graph.after[0])
    np.testing.assert_allclose(dashes[-1, 1], graph.after[4])


def test_the_pair_looked_at_is_one_line_when_it_is_a_loop_and_dashed_when_not(run: RunView, graph: GraphView) -> None:
    closed, not_closed = (
        chosen(graph, frame(run, 40, graph, looked_at(run, 1, 6, outcome)))
        for outcome in (LoopOutcome.ACCEPTED, LoopOutcome.HEADING)
    )
    assert len(closed) == 1 and len(not_closed) > 1
    np.testing.assert_allclose(not_closed[-1, 1], closed[0, 1])
    later = looked_at(run, 1, N, LoopOutcome.ACCEPTED)
    assert not len(chosen(graph, frame(run, 40, graph, later)))


def test_what_the_window_sees_again_stands_where_it_placed_it(run: RunView) -> None:
    k = next(s.frame for s in run.summaries if run.report(s.frame).relocalizations)
    at = frame(run, k)
    body = run.report(k).relocalizations[0].T_w_match[:3]
    T_b_c = run.header.calibration.cameras[0].T_b_c
    tips = seen_again(at)
    assert np.linalg.norm(tips - body, axis=2).min() <= np.linalg.norm(T_b_c[:3, 3]) + 1e-6


def test_the_layer_has_few_nodes_and_keeps_the_last_graph_while_another_is_worked_out(
    run: RunView, graph: GraphView
) -> None:
    scene = MagicMock()
    scene.add_point_cloud.return_value = MagicMock(points=np.zeros((1, 3)), visible=False)
    scene.add_line_segments.side_effect = lambda *_, **given: MagicMock(
        points=np.zeros((1, 2, 3)), visible=given["visible"]
    )
    layer = LoopLayer(scene)
    assert scene.add_line_segments.call_count < 12
    layer.update(frame(run, 40, graph))
    assert layer._after._node.visible
    layer.update(frame(run, 41))
    assert layer._after._node.visible
    layer.show("loops.graph", False)
    assert layer._accepted._node.visible
    assert layer._after._node.visible is False
