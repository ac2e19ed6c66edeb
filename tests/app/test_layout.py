"""Layouts name only what exists, fit common screens, and say what is wrong in a broken file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.layout import CAMERA_CHROME_PX, PAIR_IMAGES, Layout, canvas_width, place, read_layout, shipped_layouts
from app.panel_view import PANELS
from app.panels.signals import SIGNALS
from app.scene.view import TOGGLES
from vins_core.errors import ParameterError

PAGES = [(1440, 900), (1600, 950), (1920, 1080)]
EUROC, VGA = 752 / 480, 640 / 480
LAYOUTS = shipped_layouts()


def named(layout: Layout) -> str:
    return layout.name


def test_the_layouts_come_with_hotkeys_in_order() -> None:
    assert [(layout.name, layout.hotkey) for layout in LAYOUTS] == [
        ("default", "alt+1"),
        ("frontend", "alt+2"),
        ("init", "alt+3"),
        ("prior", "alt+4"),
        ("compare", "alt+5"),
        ("loops", "alt+6"),
        ("gps", "alt+7"),
    ]


@pytest.mark.parametrize("layout", LAYOUTS, ids=named)
def test_layouts_name_only_panels_layers_and_signals_that_exist(layout: Layout) -> None:
    assert {tab for panel in layout.panels.values() for tab in panel.tabs} <= {*PANELS, "layers"}
    assert set(layout.layers) <= set(TOGGLES)
    assert set(layout.signals) <= {signal.key for signal in SIGNALS}


@pytest.mark.parametrize("layout", LAYOUTS, ids=named)
def test_no_layout_shows_a_panel_twice(layout: Layout) -> None:
    tabs = [tab for panel in layout.panels.values() for tab in panel.tabs]
    assert len(tabs) == len(set(tabs))


def test_every_panel_is_in_some_layout() -> None:
    assert {tab for layout in LAYOUTS for panel in layout.panels.values() for tab in panel.tabs} == {*PANELS, "layers"}


@pytest.mark.parametrize("aspect", [EUROC, VGA])
@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("layout", LAYOUTS, ids=named)
def test_docks_leave_room_for_the_3d_view_and_the_image_fits_above_what_is_below_it(
    layout: Layout, page: tuple[int, int], aspect: float
) -> None:
    canvas = canvas_width(layout, page, aspect)
    assert canvas >= 380
    at = place(layout, page, aspect)
    assert at["timeline"].x + at["timeline"].width <= canvas
    stacked = 1 + sum(panel.below == "camera" for panel in layout.panels.values())
    images = PAIR_IMAGES if layout.panels["camera"].tabs[0] == "pair" else 1
    assert images * at["camera"].width / aspect + CAMERA_CHROME_PX <= page[1] / stacked + 2


def test_a_floating_panel_follows_the_width_of_the_3d_view() -> None:
    wide, narrow = (place(LAYOUTS[0], (1600, 950), EUROC, canvas)["timeline"].width for canvas in (900, 500))
    assert wide - narrow == 400


BROKEN = {
    "not json": ("{", "is not a layout"),
    "another schema": ({"schema": "vinspect/layout@9"}, "vinspect/layout@9"),
    "an unknown key": ({"colour": "red"}, "colour"),
    "a panel without a place": ({"panels": {"camera": {"tabs": ["camera"]}}}, "'camera'"),
    "a panel in two places": (
        {"panels": {"camera": {"tabs": ["camera"], "dock": "left", "width": 0.3, "float": {}}}},
        "'camera'",
    ),
    "a dock over the whole page": ({"panels": {"camera": {"tabs": ["camera"], "dock": "left", "width": 1.0}}}, "width"),
    "below what is not there": ({"panels": {"camera": {"tabs": ["camera"], "below": "signals"}}}, "'signals'"),
    "numbers for names": ({"name": 3}, "name"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_layout_is_told_with_its_file_and_what_is_wrong(case: str, tmp_path: Path) -> None:
    content, expected = BROKEN[case]
    path = tmp_path / "mine.json"
    whole = {"schema": "vinspect/layout@1", "name": "mine", "title": "Mine", "panels": {}}
    path.write_text(content if isinstance(content, str) else json.dumps(whole | content))
    with pytest.raises(ParameterError) as told:
        read_layout(path)
    assert str(path) in str(told.value) and expected in str(told.value)


def test_a_missing_layout_is_told(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"nowhere\.json cannot be read"):
        read_layout(tmp_path / "nowhere.json")
