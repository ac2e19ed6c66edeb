"""A session's rules, with a client that only takes notes: the latest wish wins, the user wins over the estimator."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from fake_run import FRAMES, SPIKE

from app.browser import GoTo, Page, Painted, Pick, Seek, Step
from app.context import PanelContext, Selection
from app.layout import shipped_layouts
from app.panel_view import PANELS, PanelView, playhead
from app.runs import OpenRun, open_path
from app.session import Session

Body = Callable[[Session], Coroutine[Any, Any, None]]


@pytest.fixture(scope="module")
def opened(run_folder: Path) -> OpenRun:
    return open_path(run_folder)


def client() -> MagicMock:
    stub = MagicMock()
    stub.gui.add_text.return_value._impl.uuid = "bridge"
    stub.camera.image_width, stub.camera.image_height, stub.camera.fov = 1600, 950, 1.3
    return stub


def run_session(opened: OpenRun, body: Body) -> Session:
    async def main() -> Session:
        session = Session(client(), opened, shipped_layouts())
        session.on_event(Page(("camera", "timeline"), 1600, 950, 640))
        await settle(session)
        await body(session)
        session.close()
        return session

    with ThreadPoolExecutor(1) as thread:  # a browser test leaves an event loop in the main one
        return thread.submit(asyncio.run, main()).result()


async def settle(session: Session) -> None:
    """Until everything wished for is drawn, however busy the machine is."""
    for _ in range(3000):
        await asyncio.sleep(0.01)
        if session.drawing.idle:
            return
    raise AssertionError("the session never came to rest")


def drawn_frames(session: Session) -> list[int]:
    """The frames drawn from now on, as they are drawn."""
    frames: list[int] = []
    draw = session.drawing.draw

    async def noted(k: int) -> None:
        frames.append(k)
        await draw(k)

    session.drawing.draw = noted  # type: ignore[method-assign]
    return frames


def test_only_the_last_of_many_wishes_is_drawn(opened: OpenRun) -> None:
    async def body(session: Session) -> None:
        frames = drawn_frames(session)
        for k in range(1, 30):
            session.on_event(GoTo(k))
        await settle(session)
        assert frames == [29]

    run_session(opened, body)


def test_wishes_beyond_the_run_end_at_its_ends(opened: OpenRun) -> None:
    async def body(session: Session) -> None:
        for event, frame in ((GoTo(10_000), FRAMES - 1), (GoTo(-7), 0), (Seek(7.0), FRAMES - 1), (Step(1), FRAMES - 1)):
            session.on_event(event)
            assert session.cursor.want == frame

    run_session(opened, body)


def test_a_step_ends_playing(opened: OpenRun) -> None:
    async def body(session: Session) -> None:
        session.play()
        assert session.cursor.playing
        session.on_event(Step(1))
        assert not session.cursor.playing

    run_session(opened, body)


def test_playing_ends_at_the_end_and_starts_over_from_there(opened: OpenRun) -> None:
    async def body(session: Session) -> None:
        session.go(FRAMES - 2)
        session.play()
        while session.cursor.playing:
            await asyncio.sleep(0.01)
        await settle(session)
        assert session.drawing.shown == FRAMES - 1
        session.play()
        assert session.cursor.playing and session.cursor.want == 0

    run_session(opened, body)


def test_keyframe_steps_visit_exactly_the_keyframes(opened: OpenRun) -> None:
    async def body(session: Session) -> None:
        assert opened.view is not None
        visited = [0]
        while True:
            session.step(1, keyframe=True)
            if session.cursor.want == visited[-1]:
                break
            visited.append(session.cursor.want)
        assert visited == opened.view.series.keyframes.tolist()
        session.step(-1, keyframe=True)
        assert session.cursor.want == visited[-2]

    run_session(opened, body)


def test_the_worst_cost_is_where_the_spike_is(opened: OpenRun) -> None:
    async def body(session: Session) -> None:
        session.go_to_worst()
        assert abs(session.cursor.want - SPIKE) <= 1

    run_session(opened, body)


def test_a_negative_pick_clears_the_selection(opened: OpenRun) -> None:
    async def body(session: Session) -> None:
        session.on_event(Pick("track", 5))
        assert session.selection == Selection("track", 5)
        session.on_event(Pick("track", -1))
        assert session.selection == Selection()

    run_session(opened, body)


def test_a_selection_of_an_unknown_kind_changes_nothing(opened: OpenRun) -> None:
    async def body(session: Session) -> None:
        session.on_event(Pick("everything", 5))
        assert session.selection == Selection()

    run_session(opened, body)


def test_the_newest_frame_is_shown_while_the_run_grows_until_the_user_takes_over(opened: OpenRun) -> None:
    growing = OpenRun("room", None)
    growing.view, growing.images, growing.growing = opened.view, opened.images, True

    async def body(session: Session) -> None:
        assert session.drawing.shown == FRAMES - 1
        session.on_event(Step(-1))
        session.refresh()
        await settle(session)
        assert session.drawing.shown == FRAMES - 2

    run_session(growing, body)


def test_only_panels_that_can_be_seen_are_rendered(opened: OpenRun, monkeypatch: pytest.MonkeyPatch) -> None:
    rendered: set[str] = set()
    original = PanelView.render
    monkeypatch.setattr(PanelView, "render", lambda self, ctx: (rendered.add(self.key), original(self, ctx))[1])

    async def body(session: Session) -> None:
        assert rendered == {"camera", "timeline"}
        session.on_event(Page(("gates", "timeline"), 1600, 950, 640))
        rendered.clear()
        await settle(session)
        assert rendered == {"gates"}  # the timeline is drawn already
        session.go(3)
        rendered.clear()
        await settle(session)
        assert rendered == {"gates", "timeline"}

    run_session(opened, body)


def scene_updates(session: Session, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The frames of which the 3D view is drawn from now on."""
    drawn: list[int] = []
    monkeypatch.setattr(session.scene, "update", lambda frame: drawn.append(frame.frame))
    return drawn


def test_the_3d_view_is_drawn_once_the_page_has_painted_the_panels(
    opened: OpenRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.drawing.PAINT_S", 60.0)

    async def body(session: Session) -> None:
        session.on_event(Painted())  # a page that says so
        drawn = scene_updates(session, monkeypatch)
        session.go(5)
        while 'data-frame="5"' not in session.workspace.panels["timeline"].content:
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.05)
        assert drawn == [] and not session.drawing.idle
        session.on_event(Painted())
        await settle(session)
        assert drawn == [5]

    run_session(opened, body)


def test_a_page_in_the_background_is_not_waited_for(opened: OpenRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.drawing.PAINT_S", 0.02)

    async def body(session: Session) -> None:
        session.on_event(Painted())
        drawn = scene_updates(session, monkeypatch)
        session.go(5)
        await settle(session)
        assert drawn == [5]

    run_session(opened, body)


def test_a_run_that_grows_beside_the_one_shown_draws_only_what_is_about_it(
    opened: OpenRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    fork = OpenRun("fork", None)
    fork.growing = True

    async def body(session: Session) -> None:
        wishes: list[tuple[str, ...]] = []
        monkeypatch.setattr(session.drawing, "refresh", lambda *parts: wishes.append(parts))
        session.grown({fork})
        session.grown({fork})  # at once again: not worth a look
        assert wishes == [("runs",)]
        session.other, fork.growing = fork, False
        session.grown({fork})  # its end always is
        assert wishes[1:] == [("runs", "signals", "scene")]
        session.grown({opened})
        assert wishes[2:] == [()]

    run_session(opened, body)


def test_a_panel_that_fails_says_so_and_the_others_are_drawn(
    opened: OpenRun, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(ctx: PanelContext) -> str:
        raise ZeroDivisionError

    monkeypatch.setattr(PANELS["camera"], "render", fail)

    async def body(session: Session) -> None:
        session.go(7)
        await settle(session)
        assert "failed at frame 7" in session.workspace.panels["camera"].content
        assert 'data-frame="7"' in session.workspace.panels["timeline"].content

    run_session(opened, body)
    assert "camera" in caplog.text


def test_a_run_without_frames_says_why_in_every_panel() -> None:
    empty = OpenRun("room.bag", None, error="/data/room.bag: it is <not> a bag")

    async def body(session: Session) -> None:
        for panel in session.workspace.panels.values():
            assert "it is &lt;not&gt; a bag" in panel.content

    run_session(empty, body)


def test_a_backdrop_is_sent_once_and_the_playhead_moves_without_it(opened: OpenRun) -> None:
    assert opened.view is not None
    sent: list[int] = []

    class Plot(ModuleType):
        KEY = "plot"
        backdrop = staticmethod(lambda ctx: sent.append(ctx.frame) or "plots")
        render = staticmethod(lambda ctx: f"value at {ctx.frame}")

    panel = PanelView(MagicMock(), Plot("plot"))
    for k in (3, 4, 5):
        report = opened.view.report(k)
        panel.render(PanelContext(opened.view, k, report, {}, Selection(), "", "", 1, 1))
        assert panel.content == playhead(k, FRAMES) + f"value at {k}"
    assert sent == [3]


def test_the_playhead_runs_from_0_to_1() -> None:
    shares = [float(playhead(k, 60).partition('data-head="')[2].partition('"')[0]) for k in range(60)]
    np.testing.assert_allclose(shares, np.linspace(0, 1, 60), atol=1e-5)
    assert 'data-head="0.0' in playhead(0, 1)
