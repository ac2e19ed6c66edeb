"""Why loops close and do not: what a tab is told, and what its panels make of it."""

from __future__ import annotations

import asyncio
import dataclasses
import re
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from fake_reports import Markup, context, parse, shared_view

from app.context import RunView, Selection
from app.experiment import ExperimentView
from app.graph import Edits, graph_view
from app.loops import Loops, LoopsView, has_loops, next_candidate
from app.panels import loops as panel
from app.panels import pair as pair_panel
from app.panels import pose_graph
from app.tooltips import TIPS
from vins_core import params as parameters
from vins_core.mapping.truth import Place
from vins_core.record.reader import RunReader
from vins_core.report import MATCH_STAGES, Gate, LoopOutcome, MatchStage

T = TypeVar("T")

ELEMENTS = {
    "", "div", "span", "b", "i", "u", "a", "kbd", "img", "code", "table", "thead", "tbody", "tr", "th", "td", "button",
    "svg", "g", "path", "rect", "circle", "polyline", "title",
}  # fmt: skip
REFUSED, CLOSED, LATEST = 10, 30, 38
"""Keyframes: one that faces another way than everything before, two that close loops."""


@pytest.fixture(scope="module")
def run(looping_run: Path) -> RunView:
    return RunView(RunReader(looping_run))


def in_a_loop(coroutine: Coroutine[Any, Any, T]) -> T:
    """Its result; in a thread, because a browser test leaves an event loop in the main one."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, coroutine).result()


def ask(run: RunView, selection: Selection, changes: dict[str, Any] | None = None, show: str = "all") -> LoopsView:
    """What a tab is told in the end."""
    changes = changes or {}

    async def wait() -> LoopsView:
        loops = Loops(lambda: None)
        loops.show = show
        loops.look(run, len(run) - 1, selection, changes, asking=True)
        while not loops.idle:
            await asyncio.sleep(0.005)
        seen = loops.look(run, len(run) - 1, selection, changes, asking=True)
        assert seen is not None and loops.idle
        return seen

    return in_a_loop(wait())


def drawn(module: Any, run: RunView, seen: LoopsView, **more: Any) -> Markup:
    changed = parameters.replace(run.header.params, dict(seen.wish.changes))
    knobs = ExperimentView(changed, run.header.params, 1, False)
    more = {"experiment": knobs, "loops": seen, "pair_uris": ("data:a", "data:b"), **more}
    return parse(module.render(context(len(run) - 1, run=run, **more)))


def loop(query: int, match: int = -1) -> Selection:
    return Selection("loop", query, match)


# What a tab is told


def test_gates_after_the_first_failure_are_judged_too(run: RunView) -> None:
    pair = ask(run, loop(REFUSED)).pair
    assert pair is not None and pair.candidate is not None
    assert pair.candidate.outcome is LoopOutcome.HEADING
    names = [g.name for g in pair.candidate.gates]
    assert names.index("distance") > names.index("heading")
    assert {"drift", "agreement"} <= set(names)


def test_without_a_selection_the_newest_keyframe_is_explained(run: RunView) -> None:
    pair = ask(run, Selection()).pair
    assert pair is not None and pair.row.number == LATEST


def test_any_two_keyframes_can_be_asked_about(run: RunView) -> None:
    pair = ask(run, loop(CLOSED, 1)).pair
    assert pair is not None and pair.candidate is not None and pair.picture is not None
    assert (pair.candidate.query, pair.candidate.match) == (CLOSED, 1)
    assert not next(g for g in pair.candidate.gates if g.name == "rank").passed


@pytest.mark.parametrize("selection", [loop(5, 9), loop(99), loop(-1)], ids=str)
def test_a_pair_that_does_not_exist_is_no_pair(run: RunView, selection: Selection) -> None:
    assert ask(run, selection).pair is None


def test_a_remedy_accepts_what_it_promises(run: RunView) -> None:
    seen = ask(run, loop(REFUSED))
    assert seen.remedy is not None and seen.remedy.changes
    again = ask(run, loop(REFUSED), dict(seen.remedy.changes))
    assert again.prediction is not None and again.pair is not None and again.pair.candidate is not None
    assert again.pair.candidate.accepted == seen.remedy.accepts
    assert len(again.prediction.gained) == len(seen.remedy.prediction.gained)


def test_moving_a_limit_changes_funnel_table_and_lists(run: RunView) -> None:
    before, after = ask(run, loop(REFUSED)), ask(run, loop(REFUSED), {"loop.max_heading_deg": 90.0}, "gained")
    assert before.prediction is None and after.prediction is not None
    assert {p.query for p in after.prediction.gained} == {r.row.number for r in after.table} >= {9, REFUSED}
    more = len(after.prediction.gained) - len(after.prediction.lost)
    assert after.counts["accepted"] == before.counts["accepted"] + more
    assert after.prediction.funnel[-1].count == after.funnel[-1].count + more


def test_filters_count_what_they_show(run: RunView) -> None:
    for show in ("accepted", "lost"):
        seen = ask(run, loop(CLOSED), {"loop.min_inliers": 110}, show)
        assert all(r.among(show) for r in seen.table)
        assert len(seen.table) == min(seen.counts[show], 31)


def test_an_answer_to_another_question_is_never_shown(run: RunView) -> None:
    async def body() -> None:
        loops = Loops(lambda: None)
        loops.look(run, 60, loop(CLOSED), {}, asking=True)
        while not loops.idle:
            await asyncio.sleep(0.005)
        other = loops.look(run, 60, loop(REFUSED), {}, asking=False)
        assert other is not None and other.busy and other.pair is None and not other.remedy_known

    in_a_loop(body())


def test_the_next_candidate_is_one_that_was_looked_at(run: RunView) -> None:
    assert next_candidate(run, 0, 1) == (30, 9)
    assert next_candidate(run, 30, 1) == (32, 10)
    assert next_candidate(run, 32, -1) == (30, 9)
    assert next_candidate(run, 30, -1) is None and next_candidate(run, len(run), 1) is None


def test_a_run_without_loops_has_none() -> None:
    assert not has_loops(shared_view())
    assert "no loops" in parse(panel.render(context(30))).text


# Two images


def test_the_pose_sees_inliers_where_they_were_matched(run: RunView) -> None:
    pair = ask(run, loop(CLOSED)).pair
    assert pair is not None and pair.picture is not None
    picture, camera = pair.picture, run.header.calibration.cameras[0].model
    inlier = picture.matches.stage == MATCH_STAGES.index(MatchStage.INLIER)
    off = np.linalg.norm(picture.reprojected_px - picture.uv_px[1], axis=1)[inlier]
    assert inlier.sum() >= 20
    assert off.max() < 1.2 * run.header.params.loop.pnp_px * camera.width / 460  # a little more at the rim
    assert np.median(off) < 2


@pytest.mark.parametrize("side", [0, 1], ids=["in the later image", "in the earlier image"])
def test_a_true_match_lies_on_its_epipolar_line(run: RunView, side: int) -> None:
    pair = ask(run, loop(CLOSED)).pair
    assert pair is not None and pair.picture is not None
    picture = pair.picture
    for k in np.flatnonzero(picture.matches.stage == MATCH_STAGES.index(MatchStage.INLIER)):
        line = picture.epipolar_px[side, k]
        a, b = line[:-1], line[1:]
        known = np.isfinite(a + b).all(1)
        if known.sum() < 2:
            continue
        along = np.clip(np.sum((picture.uv_px[side, k] - a) * (b - a), 1) / np.sum((b - a) ** 2, 1), 0, 1)
        apart = np.linalg.norm(a + along[:, None] * (b - a) - picture.uv_px[side, k], axis=1)[known]
        assert apart.min() < 8


def test_every_match_is_drawn_once_and_the_legend_counts_them(run: RunView) -> None:
    seen = ask(run, loop(CLOSED))
    assert seen.pair is not None and seen.pair.picture is not None
    page = drawn(pair_panel, run, seen)
    assert len(page.all("g", cls="vi-match")) == len(seen.pair.picture.matches.row)
    counts = {e.attributes["data-fate"]: int(e.text.split()[-1]) for e in page.all("span", cls="vi-fate")}
    stage = seen.pair.picture.matches.stage
    assert counts == {str(s): n for k, s in enumerate(MATCH_STAGES) if (n := int((stage == k).sum()))}


def test_resting_on_a_match_tells_its_bits(run: RunView) -> None:
    seen = ask(run, loop(CLOSED))
    assert seen.pair is not None and seen.pair.picture is not None
    titles = [e.text for e in drawn(pair_panel, run, seen).all("title")]
    assert all(re.search(r"\d+ of 256 bits differ", t) for t in titles)


# Panels


def test_the_panel_names_every_gate_with_the_parameter_behind_it(run: RunView) -> None:
    seen = ask(run, loop(REFUSED))
    page = drawn(panel, run, seen)
    lines = {e.attributes["data-gate"]: e for e in page.all("div", cls="vi-gateline")}
    assert {"score", "matches", "pose inliers", "heading", "distance", "drift", "agreement"} <= set(lines)
    knob = next(e for e in lines["heading"].walk() if "vi-knob" in e.attributes.get("class", ""))
    assert "loop.max_heading_deg" in knob.attributes["onclick"]
    assert "35" in knob.text


def test_the_remedy_says_what_else_it_lets_in(run: RunView) -> None:
    said = drawn(panel, run, ask(run, loop(REFUSED))).one("div", data_remedy="limits").text
    assert re.search(r"heading ≤ [\d.]+ deg; accepts \d+ more", said)


def test_where_no_limit_helps_the_page_says_why(run: RunView) -> None:
    seen = ask(run, loop(REFUSED))
    pair = seen.pair
    assert pair is not None and pair.candidate is not None
    candidate = pair.candidate

    def said(value: float | None) -> str:
        gate = Gate("drift", value, "<=", 6.0, "loop.max_drift", "sigma")
        forged = dataclasses.replace(pair, candidate=dataclasses.replace(candidate, gates=(gate,)))
        view = dataclasses.replace(seen, pair=forged, remedy=None)
        return drawn(panel, run, view).one("div", data_remedy="none").text

    assert "drift is 137, and loop.max_drift ends at 100" in said(137.0)
    assert "drift cannot be computed" in said(None)


def test_a_loop_that_closed_needs_no_remedy(run: RunView) -> None:
    assert drawn(panel, run, ask(run, loop(CLOSED))).one("div", data_remedy="closed")


def test_the_page_says_how_far_a_prediction_is_exact(run: RunView) -> None:
    seen = ask(run, loop(CLOSED), {"loop.max_heading_deg": 90.0})
    assert seen.prediction is not None
    page = drawn(panel, run, seen)
    assert f"Exact up to keyframe {seen.prediction.exact_until}" in page.text
    fork = next(e for e in page.all("button") if e.text.startswith("Fork"))
    assert f'"at":{seen.prediction.fork_at}' in fork.attributes["onclick"]
    assert f"+{len(seen.prediction.gained)}" in page.one("div", data_list="accepted").text


def test_truth_is_said_where_there_is_one(run: RunView) -> None:
    seen = ask(run, loop(CLOSED))
    assert seen.pair is not None and seen.pair.truth is not None
    assert str(Place.SAME) in drawn(panel, run, seen).text
    blind = dataclasses.replace(seen, pair=dataclasses.replace(seen.pair, truth=None))
    assert "vi-truth" not in drawn(pair_panel, run, blind).text


@pytest.mark.parametrize("changes", [{}, {"loop.max_heading_deg": 90.0}, {"loop.max_corners": 10}], ids=str)
@pytest.mark.parametrize("selection", [loop(REFUSED), loop(CLOSED), loop(CLOSED, 1), loop(3)], ids=str)
def test_every_tip_on_the_panels_exists(run: RunView, selection: Selection, changes: dict[str, Any]) -> None:
    seen = ask(run, selection, changes)
    graph = graph_view(run, len(run) - 1, Edits(frozenset({(28, 37)}), frozenset({(1, CLOSED)})))
    for module in (panel, pair_panel, pose_graph):
        page = drawn(module, run, seen, graph=graph)
        assert {e.attributes["data-tip"] for e in page.all() if "data-tip" in e.attributes} <= set(TIPS)


def test_hostile_text_stays_text(run: RunView) -> None:
    evil = """<img src=x onerror="alert('1')">'"`</div></svg><script>alert(2)</script>"""
    seen = ask(run, loop(REFUSED))
    assert seen.pair is not None and seen.pair.candidate is not None
    gates = tuple(dataclasses.replace(g, name=evil, knob=evil, unit=evil) for g in seen.pair.candidate.gates)
    candidate = dataclasses.replace(seen.pair.candidate, gates=gates)
    report = dataclasses.replace(seen.pair.report, gates=gates)
    seen = dataclasses.replace(seen, pair=dataclasses.replace(seen.pair, candidate=candidate, report=report))
    forged = {"pair_uris": (evil, ""), "pair_notes": (evil, evil)}
    for module in (panel, pair_panel, pose_graph):
        html = str(module.render(context(40, run=run, loops=seen, **forged)))  # type: ignore[arg-type]
        assert "<img src=x" not in html and "<script" not in html
        assert {e.name for e in parse(html).all()} <= ELEMENTS
    sentence = dataclasses.replace(seen, problem=evil)
    assert "<img" not in str(panel.render(context(40, run=run, loops=sentence)))


# The pose graph


def test_an_edge_switched_off_moves_the_graph_and_leaves_the_run_alone(run: RunView) -> None:
    end = len(run) - 1
    plain = graph_view(run, end, Edits())
    assert plain is not None and plain.edited is None and plain.ate_m is not None
    worst = max(plain.edges, key=lambda e: e.error_m[1]).pair
    off = graph_view(run, end, Edits().switched(worst))
    assert off is not None and off.edited is not None and off.edited_ate_m is not None and off.report is not None
    assert np.abs(off.edited - off.after).max() > 1e-6
    np.testing.assert_array_equal(off.after, plain.after)
    assert worst not in map(tuple, off.report.loops.tolist())


def test_a_refused_pair_can_be_forced_into_the_graph(run: RunView) -> None:
    pair = ask(run, loop(REFUSED)).pair
    assert pair is not None and pair.candidate is not None
    edge = (pair.candidate.match, pair.candidate.query)
    seen = graph_view(run, len(run) - 1, Edits().pressed(edge))
    assert seen is not None and seen.report is not None
    assert edge in map(tuple, seen.report.loops[seen.report.forced].tolist())


def test_edits_undo_themselves() -> None:
    assert not Edits().switched((1, 2)).switched((1, 2))
    assert not Edits().pressed((1, 2)).pressed((1, 2))
    assert Edits().switched((1, 2)).pressed((1, 2)) == Edits(forced=frozenset({(1, 2)}))


def test_the_graph_of_a_frame_holds_what_had_entered_by_then(run: RunView) -> None:
    early, late = (graph_view(run, k, Edits()) for k in (45, len(run) - 1))
    assert early is not None and late is not None
    assert len(early.after) < len(late.after)
    assert {e.pair for e in early.edges} < {e.pair for e in late.edges}
    assert graph_view(run, 3, Edits()) is None
