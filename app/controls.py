"""What viser itself offers as controls: the folder above the 3D view, and commands with their keys (Ctrl-K lists them).

The arrow keys are taken by page.js, because the 3D view would take them first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import viser

from .context import Selection
from .layout import Layout
from .runs import OpenRun

if TYPE_CHECKING:
    from .session import Session


class Controls:
    """The folder: layouts, following the camera, the estimator's progress.

    viser calls `on_update` for a value set from here too; only what differs from the session's state is a wish.
    """

    def __init__(self, client: viser.ClientHandle, session: Session) -> None:
        gui = client.gui
        self._main = gui.main_panel
        gui.set_panel_label("vinspect")
        with gui.add_folder("Session"):
            self._menu = gui.add_dropdown("layout", [layout.title for layout in session.layouts])
            self._follow = gui.add_checkbox("follow", False)
            self._progress = gui.add_progress_bar(0.0, visible=False, animated=True)
            self._name = gui.add_text("name", "", hint="a name for your own layout")
            save = gui.add_button("Save this layout", icon=viser.Icon.DEVICE_FLOPPY)
            self._cancel = gui.add_button("Stop the estimator", visible=False, icon=viser.Icon.PLAYER_STOP)

        @self._menu.on_update
        async def _(_: viser.GuiEvent) -> None:
            if self._menu.value != session.layout.title:
                session.use_layout(next(x for x in session.layouts if x.title == self._menu.value))

        @save.on_click
        async def _(_: viser.GuiEvent) -> None:
            session.save_layout(self._name.value)

        @self._follow.on_update
        async def _(_: viser.GuiEvent) -> None:
            if self._follow.value != session.following:
                session.follow(self._follow.value)

        @self._cancel.on_click
        async def _(_: viser.GuiEvent) -> None:
            session.stop_estimator()

        add_commands(client.gui, session)

    def stand(self, growing: bool) -> None:
        """In a corner of the 3D view; a finished run needs it rarely."""
        self._main.float(x=12, y=12, width=240)
        if not growing:
            self._main.minimize()

    def list_layouts(self, layouts: Sequence[Layout]) -> None:
        titles = tuple(layout.title for layout in layouts)
        if self._menu.options != titles:
            self._menu.options = titles

    def show_layout(self, layout: Layout) -> None:
        set_value(self._menu, layout.title)

    def show_following(self, following: bool) -> None:
        set_value(self._follow, following)

    def show_progress(self, opened: OpenRun) -> None:
        if self._progress.visible != opened.growing:
            self._progress.visible = self._cancel.visible = opened.growing
            if not opened.growing:
                self._main.minimize()
        if opened.progress is not None:
            set_value(self._progress, 100 * opened.progress)


def add_commands(gui: viser.GuiApi, session: Session) -> None:
    """Every command: a new key is one line here."""

    def add(label: str, key: str, modifier: str | None, action: Callable[[], None]) -> None:
        command = gui.add_command(label, hotkey=key, modifier=modifier)  # type: ignore[arg-type]

        @command.on_trigger
        async def _(_: object) -> None:  # async, so that keys keep their order
            action()

    add("Next frame  (or →)", "L", None, lambda: session.step(1))
    add("Previous frame  (or ←)", "J", None, lambda: session.step(-1))
    add("Next keyframe  (or Shift →)", "L", "shift", lambda: session.step(1, keyframe=True))
    add("Previous keyframe  (or Shift ←)", "J", "shift", lambda: session.step(-1, keyframe=True))
    add("Play or pause", "space", None, session.play)
    add("First frame", "home", None, lambda: session.go(0))
    add("Newest frame", "end", None, lambda: session.go(session.cursor.length - 1))
    add("Next loop candidate", "N", None, lambda: session.step_loop(1))
    add("Previous loop candidate", "N", "shift", lambda: session.step_loop(-1))
    add("Go to the worst cost", "G", None, session.go_to_worst)
    add("Follow the camera, on or off", "F", None, lambda: session.follow(not session.following))
    add("Show the whole run", "V", None, session.fit)
    add("Fork the run from here", "enter", "cmd/ctrl", session.fork)
    add("Clear the selection", "escape", None, lambda: session.select(Selection()))
    for layout in session.layouts:
        modifier, _, key = layout.hotkey.rpartition("+")
        add(f"Layout: {layout.title}", key.upper(), modifier or None, lambda layout=layout: session.use_layout(layout))  # type: ignore[misc]


def set_value(handle: Any, value: object) -> None:
    """Send a widget's value if it changed (viser's handles look read-only to a type checker)."""
    if handle.value != value:
        handle.value = value
