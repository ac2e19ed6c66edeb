"""One browser tab: its cursor, its selection, its panels and its 3D view.  The only mutable object of the interface.

Everything it adds is client-scoped, so tabs do not disturb each other.  Events only move `want`; one render loop
draws the newest wish and skips what was overtaken.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import viser

from vins_core.errors import VinspectError
from vins_core.io.params_yaml import params_yaml
from vins_core.params import DECLARATIONS, Params, get
from vins_core.sensors import ImageRef

from .browser import (
    AskOptimum,
    Bridge,
    Compare,
    Event,
    Fork,
    FrontEnd,
    GoTo,
    Keep,
    Knob,
    Link,
    Load,
    Open,
    Page,
    Pick,
    Play,
    Rename,
    Reset,
    Save,
    Seek,
    Set,
    Side,
    Span,
    Step,
    Stop,
)
from .comparison import Comparer, OtherRun, same_instants
from .context import PanelContext, RunView, Selection
from .experiment import Experiment, parse_parameters
from .html import tag
from .latest import Latest
from .layout import Layout, Panel, Placement, canvas_width, place, save_layout
from .optimum import Optimum
from .panel_view import PANELS, PanelView
from .prior import DepartureView, departure_view
from .runs import OpenRun
from .scene.frame import SceneFrame, scene_unit
from .scene.pick import pick
from .scene.view import OFF, TOGGLES, SceneView
from .store import RunStore
from .uncertainty import uncertainty

log = logging.getLogger("vinspect")

REST_S = 0.01
"""Between two renders, so that events and other tabs get their turn."""
PLAY_S = (0.03, 0.5)
"""Shortest and longest time a frame is shown while playing."""


class Session:
    def __init__(self, client: viser.ClientHandle, runs: RunStore | OpenRun, layouts: list[Layout]) -> None:
        self.store = runs if isinstance(runs, RunStore) else RunStore(runs)
        self.opened = opened = self.store.first
        self.experiment = Experiment(lambda: self.refresh("what_if", "camera", "scene"))
        self.comparer = Comparer(self.refresh)
        self.uncertainty = Latest(uncertainty, lambda: self.refresh("scene"))
        self.prior_side = "after"
        self.departure = Latest(departure_view, lambda: self.refresh("prior"))
        self.optimum = Optimum(lambda: self.refresh("inspect"))
        self.fork_frames = 0  # 0: to the end
        self.want, self.shown = 0, -1
        self.selection = Selection()
        self.playing = self.following = False
        self.live = opened.growing  # show the newest frame until the user takes over
        self.client = client
        self._layouts = layouts
        self._visible: set[str] = set()
        self._stale, self._closed = True, False
        self._parts: set[str] | None = None  # what is stale; None: everything
        self._wake = asyncio.Event()
        self._fitted = 0
        self._unit_m = 0.0
        self.panels: dict[str, PanelView] = {}
        self._windows: dict[str, viser.PanelHandle] = {}
        self._boxes: dict[str, viser.GuiCheckboxHandle] = {}
        self._page = int(client.camera.image_width), int(client.camera.image_height)
        self._canvas = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self.other: OpenRun | None = None
        """The run compared with."""
        self.scene = SceneView(client)
        self._build()
        self.drawing = asyncio.get_running_loop().create_task(self._loop())

    # -- what the user can do ----------------------------------------------------------------------------------------

    def go(self, frame: int) -> None:
        self.live = False
        self.want = max(0, min(frame, self._length - 1))
        self._wake.set()

    def step(self, by: int, keyframe: bool = False) -> None:
        self.playing = False
        self.go(self._next_keyframe(by) if keyframe else self.want + by)

    def play(self) -> None:
        if not self.playing and self.want >= self._length - 1 and not self.opened.growing:
            self.want = 0
        self.playing = not self.playing
        self.refresh()

    def select(self, selection: Selection) -> None:
        self.selection = selection
        self.refresh()

    def go_to_worst(self) -> None:
        """The frame whose solve left the highest cost."""
        if self._run is not None and np.isfinite(cost := self._run.series.cost.sum(1)).any():
            self.go(int(np.nanargmax(cost)))

    def follow(self) -> None:
        self.following = not self.following
        self.refresh()

    def fit(self) -> None:
        self._fitted = 0
        self.following = False
        self.refresh()

    def fork(self) -> None:
        """Repeat the run from the frame shown with the knobs as they stand."""
        if self._run is None:
            return
        try:
            self.other = self.store.fork(self.opened, self.want, self.experiment.changes, self.fork_frames or None)
        except VinspectError as problem:
            self._tell("No fork", str(problem))
            return
        self.refresh()

    def use_run(self, id: str) -> None:
        """Show another run, at the same instant where it has one."""
        run = self.store.get(id)
        if run is None or run is self.opened or run.view is None:
            return
        before, self.opened = self.opened, run
        if self.other is run:
            self.other = before
        there = same_instants(before.view, run.view) if before.view is not None else np.zeros(0, int)
        k = int(there[self.want]) if 0 <= self.want < len(there) else -1
        self.live = False
        self.want, self.shown, self._fitted, self._unit_m = max(k, 0), -1, 0, 0.0
        self.refresh()

    def compare_with(self, id: str) -> None:
        """Draw another run beside this one; "" for none."""
        run = self.store.get(id)
        self.other = run if run is not self.opened else None
        self.refresh()

    def set_knob(self, key: str, value: bool | float | str | None) -> None:
        try:
            self.experiment.set(key, value)
        except VinspectError as problem:
            self._tell(key, str(problem))
        self.refresh("what_if")

    def save_parameters(self) -> None:
        """Give the changed parameters to the browser as a file for `--params`."""
        content = params_yaml(self.experiment.params, Params())
        self.client.send_file_download("vinspect-parameters.yaml", content.encode(), save_immediately=True)

    def load_parameters(self, text: str, name: str) -> None:
        try:
            self.experiment.load(parse_parameters(text, name))
        except VinspectError as problem:
            self._tell("Not loaded", str(problem))
        self.refresh()

    def refresh(self, *parts: str) -> None:
        """Draw the shown frame again: something beside the frame number changed.

        `parts` are KEYs of the panels concerned and "scene"; without any, everything.
        """
        if not parts:
            self._parts = None
        elif self._parts is not None:
            self._parts |= set(parts)
        self._stale = True
        self._wake.set()

    @property
    def idle(self) -> bool:
        """Everything wished for is drawn."""
        return not (self.playing or self._stale or self._wake.is_set()) and self.shown in (self.want, -1)

    def close(self) -> None:
        """End the render loop; the page is gone."""
        self._closed = True
        self.experiment.close()
        self.comparer.close()
        self.optimum.close()
        self.uncertainty.close()
        self.departure.close()
        self._wake.set()

    # -- the page ----------------------------------------------------------------------------------------------------

    def _build(self) -> None:
        gui = self.client.gui
        gui.set_panel_label("vinspect")
        with gui.add_folder("Session"):
            self._bridge = Bridge(gui, self._on_event)
            self._layout_menu = gui.add_dropdown("layout", [layout.title for layout in self._layouts])
            self._follow_box = gui.add_checkbox("follow", False)
            self._progress = gui.add_progress_bar(0.0, visible=False, animated=True)
            self._layout_name = gui.add_text("name", "", hint="a name for your own layout")
            save = gui.add_button("Save this layout", icon=viser.Icon.DEVICE_FLOPPY)
            self._cancel = gui.add_button("Stop the estimator", visible=False, icon=viser.Icon.PLAYER_STOP)

        @self._layout_menu.on_update
        async def _(_: viser.GuiEvent) -> None:
            self.use_layout(next(x for x in self._layouts if x.title == self._layout_menu.value))

        @save.on_click
        async def _(_: viser.GuiEvent) -> None:
            self.save_layout(self._layout_name.value)

        @self._follow_box.on_update
        async def _(_: viser.GuiEvent) -> None:
            self.following = self._follow_box.value
            self.refresh()

        @self._cancel.on_click
        async def _(_: viser.GuiEvent) -> None:
            if self.opened.job is not None:
                self.opened.job.cancel()

        @self.client.scene.on_click()  # type: ignore[arg-type]
        async def _(event: viser.SceneClickEvent) -> None:  # async, so that events keep their order
            frame = self._scene_frame(self.shown)
            if frame is not None:
                self.select(pick(frame, np.array(event.ray_origin), np.array(event.ray_direction)))

        self._add_commands()
        gui.main_panel.float(x=12, y=12, width=240)
        if not self.opened.growing:
            gui.main_panel.minimize()
        self.use_layout(self._layouts[0])

    def _add_commands(self) -> None:
        def add(label: str, key: str, modifier: str | None, action: Callable[[], None]) -> None:
            command = self.client.gui.add_command(label, hotkey=key, modifier=modifier)  # type: ignore[arg-type]

            @command.on_trigger
            async def _(_: object) -> None:
                action()

        add("Next frame  (or →)", "L", None, lambda: self.step(1))
        add("Previous frame  (or ←)", "J", None, lambda: self.step(-1))
        add("Next keyframe  (or Shift →)", "L", "shift", lambda: self.step(1, keyframe=True))
        add("Previous keyframe  (or Shift ←)", "J", "shift", lambda: self.step(-1, keyframe=True))
        add("Play or pause", "space", None, self.play)
        add("First frame", "home", None, lambda: self.go(0))
        add("Newest frame", "end", None, lambda: self.go(self._length - 1))
        add("Go to the worst cost", "G", None, self.go_to_worst)
        add("Follow the camera, on or off", "F", None, self.follow)
        add("Show the whole run", "V", None, self.fit)
        add("Fork the run from here", "enter", "cmd/ctrl", self.fork)
        add("Clear the selection", "escape", None, lambda: self.select(Selection()))
        for layout in self._layouts:
            modifier, _, key = layout.hotkey.rpartition("+")
            add(f"Layout: {layout.title}", key.upper(), modifier or None, lambda layout=layout: self.use_layout(layout))  # type: ignore[misc]

    def use_layout(self, layout: Layout) -> None:
        """Build the panels of a layout in place of those that are there."""
        self.layout = layout
        with self.client.atomic():
            for window in self._windows.values():
                window.remove()
            self.panels, self._windows, self._boxes = {}, {}, {}
            for name, spec in layout.panels.items():
                window = self._windows[name] = self.client.gui.add_panel()
                for key in spec.tabs:
                    self._add_tab(window, key)
            self._place()
            for toggle, box in self._boxes.items():
                set_value(box, layout.layers.get(toggle, toggle not in OFF))
            for toggle in TOGGLES:
                self.scene.show(toggle, layout.layers.get(toggle, toggle not in OFF))
            self.following = layout.camera == "follow"
            set_value(self._follow_box, self.following)
            set_value(self._layout_menu, layout.title)
        self._fitted = 0
        self.refresh()

    def save_layout(self, title: str) -> None:
        """Keep panels, layers and signals as they are now under a name of the user's."""
        layers = {toggle: box.value for toggle, box in self._boxes.items()} or self.layout.layers
        panels = {name: shown_first(spec, self._visible) for name, spec in self.layout.panels.items()}
        camera = "follow" if self.following else "fit"
        layout = msgspec.structs.replace(self.layout, panels=panels, layers=layers, camera=camera)
        try:
            saved = save_layout(layout, title)
        except VinspectError as problem:
            self._tell("Not saved", str(problem))
            return
        self._layouts = [x for x in self._layouts if x.name != saved.name] + [saved]
        self._layout_menu.options = [x.title for x in self._layouts]
        self.use_layout(saved)
        self._tell("Layout saved", f"{saved.title} is in the menu from now on.")

    def reproduce(self, run: str, frame: int, layout: str) -> None:
        """The view that a link names; what is not there stays as it is."""
        if run and run != self.opened.id and self.store.get(run) is None:

            def again() -> None:
                self.reproduce(run if self.store.get(run) is not None else "", frame, layout)

            self._background(self.store.scan, again)
            return
        self.use_run(run)
        for known in self._layouts:
            if known.name == layout and known is not self.layout:
                self.use_layout(known)
        if frame >= 0:
            self.go(frame)

    def _add_tab(self, window: viser.PanelHandle, key: str) -> None:
        if key == "layers":
            with window.add_tab("Layers", viser.Icon.STACK_2):
                self.client.gui.add_html(str(tag("div", cls="vi", data_vip=key)))
                for toggle, title in TOGGLES.items():
                    self._add_layer_box(toggle, title)
            return
        module = PANELS.get(key)
        if module is None:  # a layout saved by another version
            return
        with window.add_tab(module.TITLE, getattr(viser.Icon, module.ICON)):
            if not self.panels:
                self._bridge.install()
                self._link = self.client.gui.add_html("")
            self.panels[key] = PanelView(self.client.gui, module)

    def _add_layer_box(self, toggle: str, title: str) -> None:
        box = self._boxes[toggle] = self.client.gui.add_checkbox(title, True)

        @box.on_update
        async def _(_: viser.GuiEvent) -> None:
            self.scene.show(toggle, box.value)
            self.refresh("scene")

    def _place(self) -> None:
        """Put every panel where the layout says, as wide as the page allows."""
        self._canvas = canvas_width(self.layout, self._page, self._image_aspect)
        for name, at in self._placements().items():
            spec, window = self.layout.panels[name], self._windows[name]
            if spec.dock:
                window.dock_left() if spec.dock == "left" else window.dock_right()
                window.set_width(at.width)
            else:
                window.float(x=at.x, y=at.y, width=at.width)
        for name, spec in self.layout.panels.items():
            if spec.below:
                self._windows[name].dock_below(self._windows[spec.below])

    def _follow_canvas(self, canvas: int) -> None:
        """Keep floating panels as wide as the 3D view, which the user may have made wider or narrower."""
        if canvas and canvas != self._canvas:
            self._canvas = canvas
            for name, at in self._placements().items():
                if self.layout.panels[name].floating:
                    self._windows[name].float(x=at.x, y=at.y, width=at.width)

    def _placements(self) -> dict[str, Placement]:
        return place(self.layout, self._page, self._image_aspect, self._canvas)

    @property
    def _image_aspect(self) -> float:
        if self._run is None:
            return 1.5
        model = self._run.header.calibration.cameras[0].model
        return model.width / model.height

    def _on_event(self, event: Event) -> None:
        match event:
            case Seek(f):
                self.go(round(f * (self._length - 1)))
            case GoTo(i):
                self.go(i)
            case Step(d, kf):
                self.step(d, kf)
            case Play():
                self.play()
            case Pick("track" | "frame" as kind, i, j):
                self.select(Selection(kind, i, j) if i >= 0 else Selection())
            case Knob(key):
                self._explain(key)
            case Set(key, v):
                self.set_knob(key, v)
            case Reset():
                self.experiment.reset()
                self.refresh()
            case FrontEnd(on):
                self.experiment.run_front_end(on)
                self.refresh()
            case Save():
                self.save_parameters()
            case Load(text, name):
                self.load_parameters(text, name)
            case Span(frames):
                self.fork_frames = max(frames, 0)
                self.refresh()
            case Fork():
                self.fork()
            case AskOptimum() if self._run is not None:
                self.optimum.ask(self._run, self.want)
                self.refresh()
            case Side(name):
                self.prior_side = name
                self.refresh("prior")
            case Open(id):
                self.use_run(id)
            case Compare(id):
                self.compare_with(id)
            case Rename(id, name) if named := self.store.get(id):
                self.store.rename(named, name)
                self.refresh()
            case Keep(id, on) if kept := self.store.get(id):
                self.store.keep(kept, on)
                self.refresh()
            case Stop(id) if (stopped := self.store.get(id)) and stopped.job is not None:
                stopped.job.cancel()
            case Link(run, frame, layout):
                self.reproduce(run, frame, layout)
            case Page(panels, width, height, canvas):
                if (width, height) != self._page:
                    self._page = width, height
                    self._place()
                else:
                    self._follow_canvas(canvas)
                if set(panels) != self._visible:
                    if "runs" in set(panels) - self._visible:
                        self._background(self.store.scan)
                    self._visible = set(panels)
                    self.refresh()

    def _background(self, work: Callable[[], object], then: Callable[[], object] = lambda: None) -> None:
        """Do something slow in a thread, then the rest here, and draw again."""

        async def wait() -> None:
            try:
                await asyncio.to_thread(work)
            except VinspectError as problem:
                log.info("%s", problem)
                return
            then()
            self.refresh()

        task = asyncio.get_running_loop().create_task(wait())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _explain(self, key: str) -> None:
        """Say what a parameter was in this run, where that came from, and how to run with another."""
        declared = DECLARATIONS.get(key)
        if declared is None or self._run is None:
            return
        header = self._run.header
        origin = {"config": ", from the configuration file", "set": ", set for this run"}
        value = f"{get(header.params, key)} {declared.unit}".rstrip() + origin.get(header.origins.get(key, ""), "")
        self._tell(
            key, f"{declared.doc}: {value} (default {declared.default}). To change it, run with --set {key}=VALUE"
        )

    def _tell(self, title: str, body: str) -> None:
        self.client.add_notification(title, body, auto_close_seconds=8)

    # -- drawing -----------------------------------------------------------------------------------------------------

    async def _loop(self) -> None:
        while not self._closed:
            try:
                await asyncio.wait_for(self._wake.wait(), self._pause() if self.playing else None)
            except TimeoutError:
                if self.want < self._length - 1:
                    self.want += 1
                elif not self.opened.growing:
                    self.playing, self._stale = False, True
            self._wake.clear()
            if self.live:
                self.want = max(self._length - 1, 0)
            if self._closed or (self.want == self.shown and not self._stale):
                continue
            self._stale = False
            try:
                self._render(self.want)
            except Exception:
                log.exception("frame %d", self.want)
            await asyncio.sleep(REST_S)

    def _render(self, k: int) -> None:
        with self.client.atomic():
            self._show_progress()
            run = self._run
            if run is None:
                for panel in self.panels.values():
                    panel.say(self.opened.error or self.opened.doing or "This run has no frames.")
                return
            parts, self._parts = self._parts if k == self.shown else None, set()
            self.shown = k
            ctx = self._context(run, k)
            link = f"run={self.opened.id}&frame={k}&layout={self.layout.name}"
            set_content(self._link, str(tag("i", hidden="hidden", data_link=link)))
            for panel in self.panels.values():
                if panel.key in self._visible and (parts is None or panel.key in parts):
                    panel.render(ctx)
            frame = self._scene_frame(k) if parts is None or "scene" in parts else None
            if frame is not None:
                solved = ctx.experiment.solved if ctx.experiment else None
                known = self.uncertainty.look(run, k) if self.scene.shows("uncertainty") else None
                resolved = solved.after.window if solved else None
                frame = replace(frame, other=ctx.other, resolved=resolved, uncertainty=known)
                self.scene.update(frame)
                self._aim(frame)

    def _context(self, run: RunView, k: int) -> PanelContext:
        report = run.report(k)
        uri, note = self._image(report.images[-1])
        model = run.header.calibration.cameras[report.images[-1].camera].model
        return PanelContext(
            run=run,
            frame=k,
            report=report,
            ms=run.ms(k),
            selection=self.selection,
            image_uri=uri,
            image_note=note,
            width=model.width,
            height=model.height,
            playing=self.playing,
            progress=self.opened.error or self.opened.doing,
            signals=self.layout.signals,
            experiment=self.experiment.look(run, k, asking="what_if" in self._visible),
            fork_frames=self.fork_frames,
            run_id=self.opened.id,
            runs=self.store.entries() if "runs" in self._visible else (),
            other=self._beside(run),
            optimum=self.optimum.look(run, k),
            prior_side=self.prior_side,
            departure=self._departure(run, k),
        )

    def _departure(self, run: RunView, k: int) -> DepartureView | None:
        wanted = "prior" in self._visible and self.prior_side != "after"
        return self.departure.look(run, k) if wanted else None

    def _beside(self, run: RunView) -> OtherRun | None:
        return None if self.other is None else self.comparer.look(run, self.other, self.store.name(self.other))

    def _scene_frame(self, k: int) -> SceneFrame | None:
        run = self._run
        if run is None or k < 0:
            return None
        report = run.report(k)
        if report.landmarks is not None and not self._unit_m:
            self._unit_m = scene_unit(report)
        try:
            thumbnail = self.opened.images.thumbnail(report.images[-1]) if report.window is not None else None
        except VinspectError:
            thumbnail = None
        passed = self.opened.map.at(k)
        return SceneFrame(run, k, report, self.selection, thumbnail, passed, self._unit_m or scene_unit(report))

    def _aim(self, frame: SceneFrame) -> None:
        """Move the viewpoint: behind the camera when following; else once, when there is something to see."""
        if self.following:
            self.scene.follow(frame)
        solved = int(np.isfinite(frame.series.p_w_b[:, 0]).sum())
        if not self.following and (self._fitted == 0 or (self.live and solved > 1.5 * self._fitted)):
            self._fitted = solved
            self.scene.fit(frame, aspect=self._canvas / self._page[1])

    def _show_progress(self) -> None:
        growing, share = self.opened.growing, self.opened.progress
        if self._progress.visible != growing:
            self._progress.visible = self._cancel.visible = growing
            if not growing:
                self.client.gui.main_panel.minimize()
        if share is not None:
            set_value(self._progress, 100 * share)

    def _image(self, ref: ImageRef) -> tuple[str, str]:
        """(data URI, why there is none)."""
        try:
            return self.opened.images.uri(ref), ""
        except VinspectError as problem:
            return "", str(problem)

    # -- the run -----------------------------------------------------------------------------------------------------

    @property
    def _run(self) -> RunView | None:
        return self.opened.view

    @property
    def _length(self) -> int:
        return len(self._run) if self._run is not None else 0

    def _next_keyframe(self, by: int) -> int:
        keyframes = self._run.series.keyframes if self._run is not None else np.zeros(0, int)
        later = keyframes[keyframes > self.want] if by > 0 else keyframes[keyframes < self.want][::-1]
        return int(later[0]) if len(later) else self.want

    def _pause(self) -> float:
        """Seconds the wanted frame is shown while playing: as long as it lasted, within limits."""
        if self._run is None or self.want >= self._length - 1:
            return PLAY_S[1]
        t_s = self._run.series.t_s
        return float(np.clip(t_s[self.want + 1] - t_s[self.want], *PLAY_S))


def shown_first(panel: Panel, visible: set[str]) -> Panel:
    """The panel with the tab that is open in front."""
    return msgspec.structs.replace(panel, tabs=tuple(sorted(panel.tabs, key=lambda key: key not in visible)))


def set_content(handle: viser.GuiHtmlHandle, content: str) -> None:
    if handle.content != content:
        handle.content = content


def set_value(handle: Any, value: object) -> None:
    """Send a widget's value if it changed (viser's handles look read-only to a type checker)."""
    if handle.value != value:
        handle.value = value
