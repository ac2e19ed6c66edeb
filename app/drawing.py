"""The render loop of one tab: draws the newest wish, skips what was overtaken, and sends what is small first.

A step is two messages: the panels, which the page shows as soon as they arrive, and after them the 3D view, for which
the page has to draw a whole picture.  When only parts of the page have changed, each of them is a message of its own,
in the order in which they were named.  The page says when it has painted a message; the next one waits for that, so
that nothing queues up in a slow page, and what is drawn next is what is wanted then.

A new panel needs nothing here, unless it shows something that is not in the report: then `_context` hands it over.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vins_core.errors import VinspectError
from vins_core.report import FrameReport
from vins_core.sensors import ImageRef

from .comparison import OtherRun
from .context import PanelContext, RunView
from .graph import GraphView
from .loops import LoopsView, has_loops
from .panel_view import PanelView
from .panels import depth
from .prior import DepartureView
from .scene.frame import SceneFrame, scene_unit
from .scene.view import TOGGLES

if TYPE_CHECKING:
    from .session import Session

log = logging.getLogger("vinspect")

PAINT_S = 0.5
"""The page is not waited for any longer: it may be in the background."""
SCENE_S = 0.2
"""The 3D view may fall behind so much while frames are scrubbed."""
SCENE = "scene"
"""Names the 3D view among the parts of the page; all others are KEYs of panels."""


class Drawing:
    def __init__(self, session: Session) -> None:
        self._session = session
        self.shown = -1
        """The frame that the page has; -1 before the first."""
        self._stale = True
        self._parts: list[str] | None = None  # what is stale; None: everything
        self._busy = False
        self._wake = asyncio.Event()
        self._paint = asyncio.Event()
        self._answers = False  # the page says when it has painted
        self._scene_s = 0.0  # when the 3D view was drawn
        self._closed = False
        self._fitted = 0  # poses that the viewpoint was chosen for; 0: none yet
        self._unit_m = 0.0
        self.task = asyncio.get_running_loop().create_task(self._loop())

    def wake(self) -> None:
        """The wanted frame may be another one."""
        self._wake.set()

    def refresh(self, *parts: str) -> None:
        """Draw the shown frame again: something beside the frame number changed.

        `parts` are KEYs of the panels concerned and SCENE, the most urgent first; without any, everything.
        """
        if not parts:
            self._parts = None
        elif self._parts is not None:
            self._parts += [part for part in parts if part not in self._parts]
        self._stale = True
        self._wake.set()

    def painted(self) -> None:
        """The page shows what was sent."""
        self._answers = True
        self._paint.set()

    def fit(self) -> None:
        """Choose the viewpoint anew."""
        self._fitted = 0
        self.refresh()

    def start_over(self) -> None:
        """Another run is shown."""
        self.shown, self._unit_m = -1, 0.0
        self.fit()

    @property
    def idle(self) -> bool:
        """Everything wished for is drawn."""
        cursor = self._session.cursor
        at_work = cursor.playing or self._stale or self._busy or self._wake.is_set()
        return not at_work and self.shown in (cursor.want, -1)

    def close(self) -> None:
        self._closed = True
        self._wake.set()

    async def _loop(self) -> None:
        cursor = self._session.cursor
        while not self._closed:
            try:
                await asyncio.wait_for(self._wake.wait(), cursor.pause_s)
            except TimeoutError:
                cursor.advance()
                self._stale |= not cursor.playing
            self._wake.clear()
            cursor.catch_up()
            if self._closed or (cursor.want == self.shown and not self._stale):
                continue
            self._stale, self._busy = False, True
            try:
                await self.draw(cursor.want)
            except Exception:
                log.exception("frame %d", cursor.want)
            self._busy = False

    async def draw(self, k: int) -> None:
        session = self._session
        session.controls.show_progress(session.opened)
        run = session.cursor.run
        if run is None:
            opened = session.opened
            for panel in session.workspace.panels.values():
                panel.say(opened.error or opened.doing or "This run has no frames.")
            return
        if not session.workspace.suits(run):
            session.use_layout(session.layout if session.offers(session.layout) else session.layouts[0])
        parts, self._parts = self._parts if k == self.shown else None, []
        self.shown = k
        ctx = self._context(run, k)
        session.workspace.name_view(f"run={session.opened.id}&frame={k}&layout={session.layout.name}")
        for panels in self._messages(parts):
            if self._closed:
                return
            self._paint.clear()
            with self._message():
                changed = [panel.render(ctx) for panel in panels]
            if self._answers and any(changed):
                await self._until_painted()
        if parts is None or SCENE in parts:
            self._draw_scene(ctx)

    async def _until_painted(self) -> None:
        with suppress(TimeoutError):
            await asyncio.wait_for(self._paint.wait(), PAINT_S)

    def _messages(self, parts: list[str] | None) -> Iterator[list[PanelView]]:
        """The panels to draw, by message."""
        workspace = self._session.workspace  # its panels may become others between two messages
        if parts is None:
            yield [panel for key, panel in workspace.panels.items() if key in workspace.visible]
            return
        for key in parts:
            if key in workspace.visible and key in workspace.panels:
                yield [workspace.panels[key]]

    @contextmanager
    def _message(self) -> Iterator[None]:
        """What is drawn inside arrives together, and at once: viser would collect for 1/60 s."""
        client = self._session.client
        with client.atomic():
            yield
        client.flush()

    # -- what panels see ---------------------------------------------------------------------------------------------

    def _context(self, run: RunView, k: int) -> PanelContext:
        session, answers, visible = self._session, self._session.answers, self._session.workspace.visible
        report = run.report(k)
        uri, note = self._image(report.image)
        second_uri, second_note = self._second_image(report)
        model = run.header.calibration.cameras[0].model
        experiment = answers.experiment.look(run, k, asking="what_if" in visible)
        loops = self._loops(run, k, experiment.changes)
        pair = self._pair_images(run, loops)
        return PanelContext(
            run=run,
            frame=k,
            report=report,
            ms=run.ms(k),
            selection=session.selection,
            image_uri=uri,
            image_note=note,
            second_uri=second_uri,
            second_note=second_note,
            width=model.width,
            height=model.height,
            playing=session.cursor.playing,
            progress=session.opened.error or session.opened.doing,
            signals=session.layout.signals,
            experiment=experiment,
            fork_frames=session.fork_frames,
            run_id=session.opened.id,
            runs=session.store.entries() if "runs" in visible else (),
            other=self.beside(run),
            optimum=answers.optimum.look(run, k),
            prior_side=session.prior_side,
            layers=tuple((name, title, session.scene.shows(name)) for name, title in TOGGLES.items()),
            loops=loops,
            graph=self._graph(run, k),
            pair_uris=(pair[0][0], pair[1][0]),
            pair_notes=(pair[0][1], pair[1][1]),
            depth_uri=self._depth_image(run, k),
            departure=self._departure(run, k),
        )

    def beside(self, run: RunView) -> OtherRun | None:
        """The run compared with."""
        session = self._session
        other = session.other
        return None if other is None else session.answers.comparer.look(run, other, session.store.name(other))

    def _loops(self, run: RunView, k: int, changes: dict[str, Any]) -> LoopsView | None:
        session = self._session
        asking = not session.workspace.visible.isdisjoint(("loops", "pair"))
        return session.answers.loops.look(run, k, session.selection, changes, asking=asking)

    def _graph(self, run: RunView, k: int) -> GraphView | None:
        session = self._session
        wanted = "graph" in session.workspace.visible or session.scene.shows("loops.graph")
        return session.answers.graph.look(run, k, session.edits) if wanted and has_loops(run) else None

    def _pair_images(self, run: RunView, loops: LoopsView | None) -> tuple[tuple[str, str], tuple[str, str]]:
        """Of the later keyframe and the earlier one, as `_image`."""
        pair = loops.pair if loops is not None and "pair" in self._session.workspace.visible else None
        rows = (pair.row, pair.earlier) if pair is not None else (None, None)
        later, earlier = (self._image(run.report(row.frame).image) if row else ("", "") for row in rows)
        return later, earlier

    def _departure(self, run: RunView, k: int) -> DepartureView | None:
        wanted = "prior" in self._session.workspace.visible and self._session.prior_side != "after"
        return self._session.answers.departure.look(run, k) if wanted else None

    def _second_image(self, report: FrameReport) -> tuple[str, str]:
        """Of the second camera, as `_image`."""
        if "stereo" not in self._session.workspace.visible:
            return "", ""
        ref = report.second_image
        return self._image(ref) if ref is not None else ("", "The second camera took no image with this one.")

    def _image(self, ref: ImageRef) -> tuple[str, str]:
        """(data URI, why there is none)."""
        try:
            return self._session.opened.images.uri(ref), ""
        except VinspectError as problem:
            return "", str(problem)

    def _depth_image(self, run: RunView, k: int) -> str:
        """`data:` URI, "" where there is none or nobody looks."""
        sensor = run.header.calibration.cameras[0].depth
        if sensor is None or depth.KEY not in self._session.workspace.visible:
            return ""
        with suppress(VinspectError):  # the picture says why it is not there
            ref = run.reader.packet(k).depth
            return self._session.opened.images.depth_uri(ref, sensor) if ref is not None else ""
        return ""

    # -- the 3D view -------------------------------------------------------------------------------------------------

    def scene_frame(self, k: int) -> SceneFrame | None:
        """What the layers draw from; None before the first frame."""
        session, run = self._session, self._session.cursor.run
        if run is None or k < 0:
            return None
        report = run.report(k)
        if report.landmarks is not None and not self._unit_m:
            self._unit_m = scene_unit(report)
        try:
            thumbnail = session.opened.images.thumbnail(report.image) if report.window is not None else None
        except VinspectError:
            thumbnail = None
        passed = session.opened.map.at(k)
        return SceneFrame(run, k, report, session.selection, thumbnail, passed, self._unit_m or scene_unit(report))

    def _draw_scene(self, ctx: PanelContext) -> None:
        session, now = self._session, time.monotonic()
        if self._closed or session.cursor.run is not ctx.run:
            return
        if session.cursor.want != ctx.frame and now < self._scene_s + SCENE_S:
            self.refresh(SCENE)  # after the panels of the frame that is wanted by now
            return
        self._scene_s = now
        frame = self.scene_frame(ctx.frame)
        if frame is None:
            return
        solved = ctx.experiment.solved if ctx.experiment else None
        known = session.answers.uncertainty.look(ctx.run, ctx.frame) if session.scene.shows("uncertainty") else None
        resolved = solved.after.window if solved else None
        frame = replace(frame, other=ctx.other, resolved=resolved, uncertainty=known, graph=ctx.graph, loops=ctx.loops)
        with self._message():
            session.scene.update(frame)
            self._aim(frame)

    def _aim(self, frame: SceneFrame) -> None:
        """Move the viewpoint: behind the camera when following; else once, when there is something to see."""
        session = self._session
        if session.following:
            session.scene.follow(frame)
        solved = int(np.isfinite(frame.series.p_w_b[:, 0]).sum())
        if not session.following and (self._fitted == 0 or (session.cursor.live and solved > 1.5 * self._fitted)):
            self._fitted = solved
            session.scene.fit(frame, aspect=session.workspace.canvas / session.workspace.page[1])
