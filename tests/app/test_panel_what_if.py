"""What-if on an estimated run, without a browser: which questions are asked, and what the panel says of the answers."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_reports import context, parse

from app.context import RunView
from app.experiment import Experiment, ExperimentView, parse_parameters
from app.html import number
from app.panels import camera, what_if
from app.views import track_changes
from vins_core.errors import ParameterError
from vins_core.record.reader import RunReader

FRAME = 25


@pytest.fixture(scope="module")
def run(sample_run: Path) -> RunView:
    return RunView(RunReader(sample_run))


def experiment(
    run: RunView,
    body: Callable[[Experiment], Coroutine[Any, Any, None]],
    refresh: Callable[..., None] = lambda *_: None,
) -> None:
    async def main() -> None:
        knobs = Experiment(refresh)
        knobs.use(run)
        await body(knobs)
        knobs.close()

    with ThreadPoolExecutor(1) as thread:  # a browser test leaves an event loop in the main one
        thread.submit(asyncio.run, main()).result()


async def answered(knobs: Experiment, run: RunView, frame: int = FRAME) -> ExperimentView:
    """What is known once nothing is left to work out."""
    for _ in range(2000):
        view = knobs.look(run, frame, asking=True)
        if view.solved is not None or view.problem or not view.changes:
            return view
        await asyncio.sleep(0.01)
    raise AssertionError("no answer came")


def shown(run: RunView, view: ExperimentView, frame: int = FRAME):
    return parse(what_if.render(context(frame, run=run, experiment=view)))


def test_without_changes_nothing_is_asked(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        view = knobs.look(run, FRAME, asking=True)
        assert knobs.idle and view.changes == {}
        assert "Every parameter stands as in this run" in shown(run, view).text

    experiment(run, body)


def test_the_answer_belongs_to_the_last_of_many_questions(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        for sigma in (0.5, 1.0, 2.0, 3.0):
            knobs.set("window.pixel_sigma", sigma)
            knobs.look(run, FRAME, asking=True)
            await asyncio.sleep(0.02)
        view = await answered(knobs, run)
        assert view.solved is not None and view.solved.params_after.window.pixel_sigma == 3.0
        assert knobs.look(run, FRAME + 1, asking=False).solved is None

    experiment(run, body)


def test_a_knob_cannot_leave_its_range_and_is_drawn_where_it_stands(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        before = knobs.look(run, FRAME, asking=False).revision
        with pytest.raises(ParameterError):
            knobs.set("window.pixel_sigma", 1e9)
        view = knobs.look(run, FRAME, asking=False)
        assert view.changes == {} and view.revision > before

    experiment(run, body)


def test_put_back_a_knob_is_no_change(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        knobs.set("window.loss", "none")
        knobs.set("window.loss", None)
        assert knobs.changes == {}

    experiment(run, body)


def test_the_front_end_runs_again_when_one_of_its_parameters_moves(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        knobs.set("window.pixel_sigma", 2.0)
        assert not knobs.rerun
        knobs.set("frontend.max_cnt", 60)
        assert knobs.rerun
        view = await answered(knobs, run)
        assert view.solved is not None and view.solved.reran_frontend
        changes = track_changes(view.solved.before.tracks, view.solved.after.tracks)
        html = parse(camera.render(context(FRAME, run=run, experiment=view)))
        assert len(html.all(data_changes="1")) == 1
        assert [int(e.attributes["data-gone"]) for e in html.all("g") if "data-gone" in e.attributes] == list(
            changes.gone_ids
        )
        knobs.run_front_end(False)
        again = await answered(knobs, run)
        assert again.solved is not None and not again.solved.reran_frontend

    experiment(run, body)


def test_only_what_an_answer_changes_is_drawn_again(run: RunView) -> None:
    drawn: list[tuple[str, ...]] = []

    async def body(knobs: Experiment) -> None:
        for key, value, parts in (
            ("window.pixel_sigma", 2.0, {"what_if", "scene"}),
            ("frontend.max_cnt", 60, {"what_if", "camera", "scene"}),  # other tracks in the image
            ("frontend.max_cnt", None, {"what_if", "camera", "scene"}),  # and those gone again
            ("window.pixel_sigma", 3.0, {"what_if", "scene"}),
        ):
            drawn.clear()
            knobs.set(key, value)
            await answered(knobs, run)
            assert set().union(*drawn) == parts

    experiment(run, body, lambda *parts: drawn.append(parts))


def test_gates_are_drawn_at_once_and_before_the_solve(run: RunView) -> None:
    drawn: list[tuple[str, ...]] = []

    async def body(knobs: Experiment) -> None:
        knobs.set("window.keyframe_parallax", 15.0)
        await answered(knobs, run)  # the gates are read
        drawn.clear()
        knobs.set("window.keyframe_parallax", 20.0)
        knobs.ask(run, FRAME)
        knobs.show()
        assert drawn == [("what_if",)]
        view = knobs.look(run, FRAME, asking=False)
        assert view.judged is not None and view.solved is None and view.busy
        drawn.clear()
        knobs.set("window.keyframe_parallax", None)
        knobs.set("window.pixel_sigma", 4.0)  # no gate depends on it: its answer is what is waited for
        knobs.ask(run, FRAME)
        knobs.show()
        assert drawn == []

    experiment(run, body, lambda *parts: drawn.append(parts))


def test_what_the_new_prior_would_know_of_the_gauge_stands_beside_what_it_knows(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        knobs.set("marginalization.first_estimates", True)
        view = await answered(knobs, run)
        assert view.solved is not None and view.solved.after.marginalization is not None
        leak = view.solved.after.marginalization.gauge_information[3]
        assert leak != view.solved.before.marginalization.gauge_information[3]
        page = shown(run, view)
        assert "known of yaw" in page.text and number(float(leak)) in page.text

    experiment(run, body)


def test_counts_are_those_of_the_record_and_labelled_so(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        knobs.set("window.keyframe_parallax", 60.0)
        page = shown(run, await answered(knobs, run))
        assert "given the recorded trajectory" in page.text
        was = [k for k in range(len(run)) if (r := run.report(k).keyframe) and r.gates and r.is_keyframe]
        flips = page.all(cls="vi-flips")[0]
        assert flips.text.startswith("keyframe") and str(len(was)) in flips.text

    experiment(run, body)


def test_parameters_that_no_gate_knows_are_named(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        knobs.set("window.loss_scale", 2.0)
        assert "No recorded gate depends on window.loss_scale" in shown(run, await answered(knobs, run)).text

    experiment(run, body)


def test_frames_that_are_not_solved_say_so(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        knobs.set("window.pixel_sigma", 2.0)
        page = shown(run, await answered(knobs, run, 4), 4)
        assert "recorded: filling the window" in page.text

    experiment(run, body)


def test_every_panel_line_is_well_formed(run: RunView) -> None:
    async def body(knobs: Experiment) -> None:
        knobs.set("window.pixel_sigma", 0.5)
        view = await answered(knobs, run)
        page = shown(run, view)
        assert len(page.all("tr")) > 20
        assert parse(what_if.backdrop(context(FRAME, run=run, experiment=view))).one(cls="vi-changed")

    experiment(run, body)


def test_tracks_are_compared_by_id_and_place(run: RunView) -> None:
    tracks = run.report(FRAME).tracks
    same = track_changes(tracks, tracks)
    assert not len(same.moved) and not len(same.gone) and not len(same.come)
    uv = tracks.uv_px.copy()
    uv[0] += 1.0
    uv[1] += 50.0
    changed = track_changes(tracks, dataclasses.replace(tracks, uv_px=uv))
    assert changed.moved_ids.tolist() == [tracks.ids[0]]
    assert changed.gone_ids.tolist() == changed.come_ids.tolist() == [tracks.ids[1]]
    np.testing.assert_array_equal(changed.come[0], uv[1])


def test_loaded_parameters_are_checked_and_the_file_named() -> None:
    assert parse_parameters("window:\n  loss: none\n", "a.yaml") == {"window.loss": "none"}
    for text in ("", "window: 3\n", "window:\n  loss: soft\n", "!!python/object/apply:os.system ['true']"):
        with pytest.raises(ParameterError, match=r"b\.yaml") as problem:
            parse_parameters(text, "b.yaml")
        assert "/" not in str(problem.value).split("b.yaml")[0]
