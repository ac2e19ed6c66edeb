"""The one place that reaches into the page: the boot fragment, and events from html back to the session.

viser's `add_html` runs no scripts, so one invisible image whose `onerror` fires when it is mounted installs
page.js and the style sheet.  Events come back as JSON in a hidden text input and are checked here; anything that is
not one of the events below is ignored.
"""

from __future__ import annotations

import html
import json
from collections.abc import Callable
from importlib import resources
from typing import Literal

import msgspec
import viser

from .style import CSS
from .tooltips import page_tips


class Seek(msgspec.Struct, tag_field="k", tag="seek"):
    f: float  # share of the run, 0..1


class GoTo(msgspec.Struct, tag_field="k", tag="frame"):
    i: int


class Step(msgspec.Struct, tag_field="k", tag="step"):
    d: int  # +1 or -1
    kf: bool = False  # to the next keyframe


class Play(msgspec.Struct, tag_field="k", tag="play"):
    pass


class Pick(msgspec.Struct, tag_field="k", tag="pick"):
    t: str  # "track", "frame", "loop" or "fix"
    i: int  # -1 clears
    j: int = -1  # a second frame, or the earlier keyframe of a loop; -1: the best there is


class Knob(msgspec.Struct, tag_field="k", tag="knob"):
    key: str  # "section.name" of a parameter; the page goes there itself when the layout has the knobs


class Set(msgspec.Struct, tag_field="k", tag="set"):
    key: str  # "section.name" of a parameter
    v: bool | float | str | None  # None: as in the run


class Apply(msgspec.Struct, tag_field="k", tag="apply"):
    changes: dict[str, bool | float | str]  # knobs to move together


class Loops(msgspec.Struct, tag_field="k", tag="loops"):
    show: Literal["all", "accepted", "refused", "missed", "wrong", "gained", "lost"]  # rows of the table


class Edge(msgspec.Struct, tag_field="k", tag="edge"):
    """Switch an edge of the pose graph off or force it, and back; without keyframes, all as it was."""

    do: Literal["disable", "force", "reset"]
    i: int = -1  # the earlier keyframe
    j: int = -1


class Reset(msgspec.Struct, tag_field="k", tag="reset"):
    """Every knob back to the run's value."""


class FrontEnd(msgspec.Struct, tag_field="k", tag="frontend"):
    on: bool  # what-ifs run the front end again


class Save(msgspec.Struct, tag_field="k", tag="save"):
    """Give the changed parameters to the browser as a file."""


class Load(msgspec.Struct, tag_field="k", tag="load"):
    text: str  # of a parameter file; empty when it is too large
    name: str


class Span(msgspec.Struct, tag_field="k", tag="span"):
    frames: int  # that a fork computes; 0: to the end


class Fork(msgspec.Struct, tag_field="k", tag="fork"):
    """Repeat the run with the knobs as they stand."""

    at: int = -1  # from this frame on; -1: from the one shown


class Open(msgspec.Struct, tag_field="k", tag="open"):
    id: str  # of a run


class Compare(msgspec.Struct, tag_field="k", tag="compare"):
    id: str  # of a run; empty: with none


class Rename(msgspec.Struct, tag_field="k", tag="rename"):
    id: str
    name: str


class Keep(msgspec.Struct, tag_field="k", tag="keep"):
    id: str
    on: bool


class Stop(msgspec.Struct, tag_field="k", tag="stop"):
    id: str  # of a run that grows


class AskOptimum(msgspec.Struct, tag_field="k", tag="optimum"):
    """Is the solution of the frame shown the optimum of its window?"""


class Side(msgspec.Struct, tag_field="k", tag="side"):
    name: Literal["after", "before", "fill-in"]  # of marginalisation


class Layer(msgspec.Struct, tag_field="k", tag="layer"):
    name: str  # of a toggle of the 3D view
    on: bool


class Link(msgspec.Struct, tag_field="k", tag="link"):
    """The address of the page names a view."""

    run: str = ""  # id
    frame: int = -1
    layout: str = ""


class Page(msgspec.Struct, tag_field="k", tag="page"):
    panels: tuple[str, ...]  # KEYs of the panels that can be seen
    width: int  # of the page, CSS px
    height: int
    canvas: int  # width of the 3D view


class Painted(msgspec.Struct, tag_field="k", tag="painted"):
    """What was sent last can be seen now."""


Event = (
    Seek | GoTo | Step | Play | Pick | Knob | Set | Reset | FrontEnd | Save | Load | Span | Fork
    | Apply | Loops | Edge | Open | Compare | Rename | Keep | Stop | AskOptimum | Side | Layer | Link | Page | Painted
)  # fmt: skip
SCRIPTS = ("page.js", "knobs.js", "loops.js")
_DECODER: msgspec.json.Decoder[Event] = msgspec.json.Decoder(Event)


def decode(text: str) -> Event | None:
    """The event in `text`, None when it is none of ours."""
    try:
        return _DECODER.decode(text)
    except msgspec.MsgspecError:
        return None


def boot_fragment(bridge: str) -> str:
    """Html that installs page.js, style sheet and tooltips once it is mounted; `bridge` is the hidden input's id."""
    script = "\n".join(resources.files("app").joinpath(name).read_text("utf-8") for name in SCRIPTS)
    for name, value in (("__BRIDGE__", bridge), ("__CSS__", CSS), ("__TIPS__", page_tips())):
        script = script.replace(name, json.dumps(value))
    return f'<img alt="" src="data:," style="display:none" onerror="{html.escape(script)}">'


class Bridge:
    """Events from one page, in order.  `on_event` runs on the server's event loop."""

    def __init__(self, gui: viser.GuiApi, on_event: Callable[[Event], None]) -> None:
        self._gui = gui
        self._box = gui.add_text("events", "", visible=False)

        @self._box.on_update
        async def _(_: viser.GuiEvent) -> None:
            event = decode(self._box.value)
            if event is not None:
                on_event(event)

    def install(self) -> None:
        """Add the boot fragment here: a place that the page mounts at once, not a hidden tab or a minimised panel."""
        self._gui.add_html(boot_fragment(self._box._impl.uuid))
