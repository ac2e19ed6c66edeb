"""The switches of the 3D view's layers."""

from __future__ import annotations

from fake_reports import context, parse

from app.browser import Layer, decode
from app.panels import layers
from app.scene.view import TOGGLES


def test_every_layer_has_a_switch_that_stands_as_it_is_drawn() -> None:
    shown = tuple((name, title, k % 2 == 0) for k, (name, title) in enumerate(TOGGLES.items()))
    page = parse(layers.render(context(20, layers=shown)))
    boxes = page.all("input")
    assert len(boxes) == len(TOGGLES)
    assert ["checked" in box.attributes for box in boxes] == [on for _, _, on in shown]
    for title in TOGGLES.values():
        assert title in page.text


def test_every_layer_has_a_mark_of_its_own() -> None:
    assert set(layers.MARKS) == set(TOGGLES)
    assert len(set(layers.MARKS.values())) == len(TOGGLES)


def test_a_switch_is_an_event() -> None:
    assert decode('{"k": "layer", "name": "grid", "on": false, "n": 3}') == Layer("grid", False)
    assert decode('{"k": "layer", "name": "grid", "on": "maybe"}') is None
