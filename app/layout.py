"""Layouts: which panels stand where, which layers are drawn, which signals are plotted.  `layouts/<name>.json`.

Widths are shares of the page; a floating panel is given by its gaps to the edges of the 3D view, as in CSS.
"""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path
from typing import Literal

import msgspec

from vins_core.errors import OutputError, ParameterError

from .places import shipped

SCHEMA = "vinspect/layout@1"
PAIR_IMAGES = 2.02
"""Heights of the two images above each other, and of the gap between them."""
CAMERA_CHROME_PX = 145
"""Height of what stands above and below the image in the camera's panel."""
MAX_BYTES = 256 * 1024


class Float(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Gaps to the edges of the 3D view in CSS px; the panel spans from left to right and is as high as its content."""

    left: int = 12
    right: int = 12
    bottom: int = 12


class Panel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A window with tabs; the first tab is shown.  Exactly one of `dock`, `below` and `float` says where it stands."""

    tabs: tuple[str, ...]
    dock: Literal["left", "right", ""] = ""
    width: float = 0.0  # share of the page, when docked
    below: str = ""  # name of a docked panel
    floating: Float | None = msgspec.field(default=None, name="float")


class Layout(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    schema: str
    name: str
    title: str
    panels: dict[str, Panel]
    hotkey: str = ""  # "alt+1"
    layers: dict[str, bool] = {}  # layers of the 3D view that differ from their default
    signals: tuple[str, ...] = ()  # empty: all
    camera: Literal["fit", "follow"] = "fit"
    needs: Literal["", "loops", "gps"] = ""  # what a run must have for it


class Placement(msgspec.Struct, frozen=True):
    """Pixels of one panel on a page."""

    width: int
    x: int = 0
    y: int = 0


def read_layout(path: Path) -> Layout:
    """Raises ParameterError, naming the file and what is wrong in it."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ParameterError(f"layout {path} is larger than {MAX_BYTES} bytes; a layout is a small JSON file")
        layout = msgspec.json.decode(path.read_bytes(), type=Layout)
    except OSError as problem:
        raise ParameterError(f"layout {path} cannot be read: {problem.strerror}") from None
    except msgspec.MsgspecError as problem:
        raise ParameterError(f"layout {path} is not a layout: {problem}") from None
    if layout.schema != SCHEMA:
        raise ParameterError(f"layout {path} has schema {layout.schema!r}, expected {SCHEMA!r}")
    for name, panel in layout.panels.items():
        if [bool(panel.dock), bool(panel.below), panel.floating is not None].count(True) != 1 or not panel.tabs:
            raise ParameterError(f"layout {path}, panel {name!r}: needs tabs and one of dock, below and float")
        if panel.dock and not 0.05 <= panel.width <= 0.8:
            raise ParameterError(f"layout {path}, panel {name!r}: width must be 0.05 to 0.8 of the page")
        if panel.below and (panel.below not in layout.panels or not layout.panels[panel.below].dock):
            raise ParameterError(f"layout {path}, panel {name!r}: {panel.below!r} is not a docked panel")
    return layout


def shipped_layouts() -> list[Layout]:
    """The layouts that come with the program, by hotkey."""
    return sorted((read_layout(p) for p in sorted(shipped("layouts").glob("*.json"))), key=lambda layout: layout.hotkey)


def user_folder() -> Path:
    """`vinspect/layouts` in the user's configuration."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "vinspect" / "layouts"


def user_layouts() -> list[Layout]:
    """The layouts that the user saved, by name; those that are none any more are left out."""
    found = []
    for path in sorted(user_folder().glob("*.json")):
        with contextlib.suppress(ParameterError):
            found.append(msgspec.structs.replace(read_layout(path), name=path.stem, hotkey=""))
    return found


def save_layout(layout: Layout, title: str) -> Layout:
    """Keep a layout under a title of the user's; ParameterError when it names no file, OutputError when it fails."""
    title = " ".join(title.split())
    name = "-".join(re.findall(r"[a-z0-9]+", title.lower()))[:40]
    if not name or name in {known.name for known in shipped_layouts()}:
        raise ParameterError(f"a layout cannot be called {title!r}; give it a name of its own, in letters and digits")
    saved = msgspec.structs.replace(layout, name=name, title=title[:60], hotkey="")
    path = user_folder() / f"{name}.json"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(msgspec.json.format(msgspec.json.encode(saved), indent=2))
    except OSError as problem:
        raise OutputError(f"layout {path} cannot be written: {problem.strerror}") from None
    return saved


def place(
    layout: Layout, page: tuple[int, int], image_aspect: float = 1.5, canvas: int | None = None
) -> dict[str, Placement]:
    """Pixels of every panel that has some of its own.

    `page` is its (width, height); a docked panel is not made so wide that the camera's image would not fit above
    what is stacked below it.  `canvas` is the 3D view's width where the page has told it.
    """
    docked = _docked_widths(layout, page, image_aspect)
    placed = {name: Placement(width) for name, width in docked.items()}
    canvas = canvas_width(layout, page, image_aspect) if canvas is None else canvas
    for name, panel in layout.panels.items():
        if gaps := panel.floating:
            placed[name] = Placement(max(canvas - gaps.left - gaps.right, 260), gaps.left, -gaps.bottom)
    return placed


def canvas_width(layout: Layout, page: tuple[int, int], image_aspect: float = 1.5) -> int:
    """Width left for the 3D view between the docked panels, px."""
    return page[0] - sum(_docked_widths(layout, page, image_aspect).values())


def _docked_widths(layout: Layout, page: tuple[int, int], image_aspect: float) -> dict[str, int]:
    widths = {}
    for name, panel in layout.panels.items():
        if not panel.dock:
            continue
        widths[name] = round(panel.width * page[0])
        if "camera" in panel.tabs:
            stacked = (PAIR_IMAGES if panel.tabs[0] == "pair" else 1) + sum(
                other.below == name for other in layout.panels.values()
            )
            chrome = CAMERA_CHROME_PX / (stacked if panel.tabs[0] == "pair" else 1)
            fits = round((page[1] / stacked - chrome) * image_aspect)
            widths[name] = min(widths[name], max(fits, 320))
    return widths
