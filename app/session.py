"""One browser tab: what its user can do.  The only mutable object of the interface.

    cursor.py     which frame of which run is wanted
    answers.py    what is worked out in threads: what-ifs, comparisons, uncertainty
    workspace.py  the windows and panels
    drawing.py    the render loop, which brings all of them into the page
    events.py, controls.py   from events, keys and buttons to the methods below

Everything it adds to the page is client-scoped, so tabs do not disturb each other.  Methods only change what is wanted
and say what has to be drawn again; none of them draws.

A new panel is one file in `panels/`.  What else it may need: an event (browser.py, events.py), a key (controls.py), a
slow answer (answers.py) and a field of `PanelContext` (context.py, filled in drawing.py), a layer (scene/view.py).
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable

import numpy as np
import viser

from vins_core.errors import VinspectError
from vins_core.io.params_yaml import params_yaml
from vins_core.params import DECLARATIONS, Params, get

from .answers import Answers
from .browser import Bridge, Event
from .comparison import same_instants
from .context import Selection
from .controls import Controls
from .cursor import Cursor
from .drawing import SCENE, Drawing
from .events import handle
from .experiment import Experiment, parse_parameters
from .graph import Edits
from .layout import Layout, save_layout
from .loops import has_loops, next_candidate
from .panels import gps
from .runs import OpenRun
from .scene.pick import pick
from .scene.view import TOGGLES, SceneView
from .store import RunStore
from .workspace import Workspace

log = logging.getLogger("vinspect")

LACKING = {
    "loops": "This run closes no loops; make one with --loops on.",
    "gps": "This run fuses no GPS fixes; `vinspect info` says what its recording lacks for that.",
}
"""Why a layout cannot be had, by what it needs."""
GROWN_S = 1.0
"""Between two looks at runs that grow beside the one shown."""


class Session:
    def __init__(self, client: viser.ClientHandle, runs: RunStore | OpenRun, layouts: list[Layout]) -> None:
        self.client = client
        self.store = runs if isinstance(runs, RunStore) else RunStore(runs)
        self.layouts = layouts
        self.cursor = Cursor(self.store.first)
        self.other: OpenRun | None = None
        """The run compared with."""
        self.selection = Selection()
        self.following = False
        self.prior_side = "after"
        self.edits = Edits()
        """Edges of the pose graph that the user switched off or forced."""
        self.fork_frames = 0
        """How many frames a fork computes; 0: to the end."""
        self._grown_s = 0.0  # when growing runs were drawn
        self._tasks: set[asyncio.Task[None]] = set()
        self.answers = Answers(self.refresh)
        self.scene = SceneView(client)
        self.drawing = Drawing(self)
        self.controls = Controls(client, self)
        self.workspace = Workspace(client, Bridge(client.gui, self.on_event), layouts[0])
        self.controls.stand(self.opened.growing)
        self.use_layout(layouts[0])

        @client.scene.on_click()  # type: ignore[arg-type]
        async def _(event: viser.SceneClickEvent) -> None:  # async, so that events keep their order
            frame = self.drawing.scene_frame(self.drawing.shown)
            if frame is not None:
                self.select(pick(frame, np.array(event.ray_origin), np.array(event.ray_direction)))

    @property
    def opened(self) -> OpenRun:
        """The run shown."""
        return self.cursor.opened

    @property
    def experiment(self) -> Experiment:
        return self.answers.experiment

    @property
    def layout(self) -> Layout:
        return self.workspace.layout

    def refresh(self, *parts: str) -> None:
        """See Drawing.refresh."""
        self.drawing.refresh(*parts)

    def grown(self, runs: set[OpenRun]) -> None:
        """The estimator has written more of these runs; those beside the one shown are drawn now and then."""
        if self.opened in runs:
            self.refresh()
            return
        now = time.monotonic()
        if now >= self._grown_s + GROWN_S or not all(run.growing for run in runs):
            self._grown_s = now
            self.refresh("runs", *(("signals", SCENE) if self.other in runs else ()))

    def on_event(self, event: Event) -> None:
        handle(self, event)

    def close(self) -> None:
        """The page is gone."""
        self.answers.close()
        self.drawing.close()

    # -- frames ------------------------------------------------------------------------------------------------------

    def go(self, frame: int) -> None:
        self.cursor.go(frame)
        self.drawing.wake()

    def step(self, by: int, keyframe: bool = False) -> None:
        self.cursor.step(by, keyframe)
        self.drawing.wake()

    def play(self) -> None:
        self.cursor.play()
        self.refresh()

    def go_to_worst(self) -> None:
        worst = self.cursor.worst_cost()
        if worst is not None:
            self.go(worst)

    # -- what is looked at -------------------------------------------------------------------------------------------

    def select(self, selection: Selection) -> None:
        self.selection = selection
        self.refresh()

    def follow(self, following: bool) -> None:
        self.following = following
        self.controls.show_following(following)
        self.refresh()

    def fit(self) -> None:
        """See the whole run."""
        self.follow(False)
        self.drawing.fit()

    def show_layer(self, toggle: str, on: bool) -> None:
        if toggle in TOGGLES:
            self.scene.show(toggle, on)
            self.refresh("layers", SCENE)

    def show_prior(self, side: str) -> None:
        self.prior_side = side
        self.refresh("prior")

    def see(self, panels: set[str], page: tuple[int, int], canvas: int) -> None:
        """The page says which panels can be seen, its size, and the width of its 3D view."""
        self.workspace.fit_to(page, canvas)
        new, self.workspace.visible = panels - self.workspace.visible, panels
        if "runs" in new:
            self._background(self.store.scan)
        if new:
            self.refresh(*new)

    def explain(self, key: str) -> None:
        """Say what a parameter was in this run, where that came from, and how to run with another."""
        declared = DECLARATIONS.get(key)
        if declared is None or self.cursor.run is None:
            return
        header = self.cursor.run.header
        origin = {"config": ", from the configuration file", "set": ", set for this run"}
        value = f"{get(header.params, key)} {declared.unit}".rstrip() + origin.get(header.origins.get(key, ""), "")
        self._tell(
            key, f"{declared.doc}: {value} (default {declared.default}). To change it, run with --set {key}=VALUE"
        )

    # -- loops -------------------------------------------------------------------------------------------------------

    def look_at_loop(self, later: int, earlier: int = -1) -> None:
        """Select two keyframes, or one and the best there is for it, and go to where the later one was judged."""
        if self.cursor.run is None or later < 0:
            self.select(Selection())
            return
        later, earlier = max(later, earlier), min(later, earlier)
        loops = self.cursor.run.series.loops
        there = np.flatnonzero(loops.keyframe == later)
        if later == earlier or not len(there):
            known = loops.keyframe[loops.keyframe >= 0]
            own = f"its own are {known[0]} to {known[-1]}" if len(known) else "it has none yet"
            self._tell("No such pair", f"This run has no keyframe {later} to hold against {earlier}; {own}.")
            return
        self.select(Selection("loop", later, earlier))
        self.go(int(loops.frame[there[0]]))

    def step_loop(self, by: int) -> None:
        """To the next keyframe, or the previous one, for which an earlier one was looked at."""
        if self.cursor.run is None or (there := next_candidate(self.cursor.run, self.cursor.want, by)) is None:
            self._tell("No more loops", f"There is no {'later' if by > 0 else 'earlier'} candidate in this run.")
            return
        self.look_at_loop(there[1])

    def show_loops(self, show: str) -> None:
        """Narrow the table of loops."""
        self.answers.loops.show = show
        self.refresh("loops")

    def edit_edge(self, do: str, earlier: int, later: int) -> None:
        """Switch an edge of the pose graph off or force it, or back; nothing of the run changes."""
        match do:
            case "disable":
                self.edits = self.edits.switched((earlier, later))
            case "force":
                self.edits = self.edits.pressed((earlier, later))
            case _:
                self.edits = Edits()
        self.refresh("graph", SCENE)

    # -- GPS ---------------------------------------------------------------------------------------------------------

    def look_at_fix(self, row: int) -> None:
        """Select a fix and go to where it was judged; -1 for none."""
        if self.cursor.run is None or not 0 <= row < len(self.cursor.run.series.gps):
            self.select(Selection())
            return
        self.select(Selection("fix", row))
        self.go(int(self.cursor.run.series.gps.frame[row]))

    # -- layouts -----------------------------------------------------------------------------------------------------

    def offers(self, layout: Layout) -> bool:
        """Whether the run shown has what a layout is for."""
        run = self.cursor.run
        match layout.needs:
            case "loops":
                return run is not None and has_loops(run)
            case "gps":
                return run is not None and gps.exists(run)
        return True

    def use_layout(self, layout: Layout) -> None:
        if not self.offers(layout):
            self._tell(layout.title, LACKING[layout.needs])
            return
        if (run := self.cursor.run) is not None:
            model = run.header.calibration.cameras[0].model
            self.workspace.image_aspect = model.width / model.height
        with self.client.atomic():
            self.workspace.use(layout, self.cursor.run)
            self.controls.list_layouts([x for x in self.layouts if self.offers(x)])
            for toggle in TOGGLES:
                self.scene.show(toggle, self.workspace.draws(toggle))
            self.follow(layout.camera == "follow")
            self.controls.show_layout(layout)
        self.drawing.fit()

    def save_layout(self, title: str) -> None:
        """Keep panels, layers and signals as they are now under a name of the user's."""
        try:
            layers = {toggle: self.scene.shows(toggle) for toggle in TOGGLES}
            saved = save_layout(self.workspace.as_it_is(layers, "follow" if self.following else "fit"), title)
        except VinspectError as problem:
            self._tell("Not saved", str(problem))
            return
        self.layouts = [x for x in self.layouts if x.name != saved.name] + [saved]
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
        for known in self.layouts:
            if known.name == layout and known is not self.layout:
                self.use_layout(known)
        if frame >= 0:
            self.go(frame)

    # -- knobs -------------------------------------------------------------------------------------------------------

    def set_knob(self, key: str, value: bool | float | str | None) -> None:
        try:
            self.experiment.set(key, value)
        except VinspectError as problem:
            self._tell(key, str(problem))
            self.refresh("what_if")
            return
        self.workspace.forget_knobs()
        if self.cursor.run is not None and "what_if" in self.workspace.visible:
            self.experiment.ask(self.cursor.run, self.cursor.want)
            self.experiment.show()
        self.refresh("loops", "pair")

    def apply_knobs(self, changes: dict[str, bool | float | str]) -> None:
        """Move several knobs at once."""
        try:
            self.experiment.load({**self.experiment.changes, **changes})
        except VinspectError as problem:
            self._tell("Not set", str(problem))
        self.refresh()

    def reset_knobs(self) -> None:
        self.experiment.reset()
        self.refresh()

    def run_front_end(self, on: bool) -> None:
        self.experiment.run_front_end(on)
        self.refresh()

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

    def ask_optimum(self) -> None:
        """Is the solution of the frame shown the optimum of its window?"""
        if self.cursor.run is not None:
            self.answers.optimum.ask(self.cursor.run, self.cursor.want)
            self.refresh("inspect")

    # -- runs and forks ----------------------------------------------------------------------------------------------

    def set_span(self, frames: int) -> None:
        self.fork_frames = max(frames, 0)
        self.refresh("what_if")

    def fork(self, at: int = -1) -> None:
        """Repeat the run from a frame, by default the one shown, with the knobs as they stand."""
        if self.cursor.run is None:
            return
        at, changes = at if at >= 0 else self.cursor.want, self.experiment.changes
        try:
            self.other = self.store.fork(self.opened, at, changes, self.fork_frames or None)
        except VinspectError as problem:
            self._tell("No fork", str(problem))
            return
        self.refresh()

    def use_run(self, id: str) -> None:
        """Show another run, at the same instant where it has one."""
        run = self.store.get(id)
        if run is None or run is self.opened or run.view is None:
            return
        before = self.opened
        if self.other is run:
            self.other = before
        there = same_instants(before.view, run.view) if before.view is not None else np.zeros(0, int)
        here = self.cursor.want
        self.cursor.use(run, int(there[here]) if 0 <= here < len(there) else 0)
        self.drawing.start_over()

    def compare_with(self, id: str) -> None:
        """Draw another run beside this one; "" for none."""
        run = self.store.get(id)
        self.other = run if run is not self.opened else None
        self.refresh()

    def rename(self, id: str, name: str) -> None:
        if run := self.store.get(id):
            self.store.rename(run, name)
            self.refresh()

    def keep(self, id: str, on: bool) -> None:
        if run := self.store.get(id):
            self.store.keep(run, on)
            self.refresh("runs")

    def stop(self, id: str) -> None:
        """End a run that grows, where it is."""
        run = self.store.get(id)
        if run is not None and run.job is not None:
            run.job.cancel()

    def stop_estimator(self) -> None:
        """Of the run shown, which may not have an id yet."""
        if self.opened.job is not None:
            self.opened.job.cancel()

    # -- helpers -----------------------------------------------------------------------------------------------------

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

    def _tell(self, title: str, body: str) -> None:
        self.client.add_notification(title, body, auto_close_seconds=8)
