"""The gate widget says value, limit, verdict, margin and parameter of any gate."""

import math
import re

import pytest
from fake_reports import parse
from hypothesis import given
from hypothesis import strategies as st

from app.tooltips import TIPS, gate_tip
from app.widgets.gate import gate_list, margin_words, meter
from vins_core.params import DECLARATIONS
from vins_core.report import Gate

OPS = st.sampled_from([">=", ">", "<=", "<"])
NUMBERS = st.floats(-1e6, 1e6)


def label(gate: Gate, **how: bool) -> str:
    (icon,) = parse(gate_list([gate], **how)).all("svg")
    return icon.attributes["aria-label"]


def test_verdict_has_a_shape_for_every_case():
    assert label(Gate("a", 3, ">=", 2)) == "passed"
    assert label(Gate("a", 1, ">=", 2)) == "failed"
    assert label(Gate("a", 1, ">=", 2, decides=False)) == "failed, advisory"
    assert label(Gate("a", None, ">=", 2)) == "not computed"
    assert label(Gate("a", math.nan, ">=", 2)) == "not computed"
    shapes = {gate_list([g]).split("<svg", 1)[1].split("</svg>")[0] for g in (
        Gate("a", 3, ">=", 2), Gate("a", 1, ">=", 2), Gate("a", 1, ">=", 2, decides=False), Gate("a", None, ">=", 2)
    )}  # fmt: skip
    assert len({re.sub("#[0-9A-F]{6}", "", s) for s in shapes}) == 4  # different without colour, too


def test_a_switch_is_neither_right_nor_wrong():
    moved, still = Gate("parallax", 14.2, "<", 10, unit="px460"), Gate("parallax", 4.2, "<", 10, unit="px460")
    assert label(moved, switch=True) == "triggered"
    assert label(still, switch=True) == "not triggered"
    for gate in (moved, still):
        assert "vi-bad" not in gate_list([gate], switch=True)


@pytest.mark.parametrize(
    ("gate", "words"),
    [
        (Gate("matches", 13, ">=", 20), "7 short"),
        (Gate("matches", 25, ">=", 20), "5 to spare"),
        (Gate("turn", 0.87, "<=", 0.5, unit="deg"), "0.37 over"),
        (Gate("jump", 0.25, "<=", 5, unit="m"), "4.75 to spare"),
        (Gate("matches", 20, ">", 20), "just at the limit"),
        (Gate("matches", None, ">", 20), ""),
        (Gate("cost", math.inf, "<=", 1.0), "no margin"),
    ],
)
def test_margin_is_said_in_words(gate, words):
    assert margin_words(gate) == words


@given(NUMBERS, OPS, NUMBERS)
def test_meter_shows_the_value_on_the_side_of_the_limit_it_is_on(value, op, limit):
    page = parse(meter(Gate("a", value, op, limit), "#fff"))

    def percent(element, name):
        return float(re.search(rf"{name}:([\d.]+)%", element.attributes["style"])[1])

    fill, tick, tint = page.one(cls="vi-fill"), page.one("u"), page.one(cls="vi-pass")
    for part in (fill, tint):
        assert -0.01 <= percent(part, "left") <= percent(part, "left") + percent(part, "width") <= 101
    end = percent(fill, "left") + percent(fill, "width") if value >= 0 else percent(fill, "left")
    slack = 1.0  # percent: a fill is never thinner than it can be seen
    if value > limit:
        assert end >= percent(tick, "left") - slack
    elif value < limit:
        assert end <= percent(tick, "left") + slack
    above = percent(tint, "left") + percent(tint, "width") > 99.9
    below = percent(tint, "left") < 0.1
    assert above if op.startswith(">") else below


def test_what_could_not_be_computed_has_no_bar():
    page = parse(gate_list([Gate("points", None, ">=", 10, "init.min_pnp_points")]))
    assert not page.all(cls="vi-fill")
    assert "not computed" in page.text


def test_the_parameter_is_a_link_to_its_slider():
    knob = parse(gate_list([Gate("matches", 13, ">", 20, "init.min_matches")])).one(cls="vi-knob")
    assert knob.text == "init.min_matches"
    assert knob.attributes["onclick"] == 'vi.send({"k":"knob","key":"init.min_matches"})'
    assert knob.attributes["data-tip"] in TIPS


def test_a_gate_without_parameter_has_no_link():
    assert not parse(gate_list([Gate("scale", 1.2, ">", 0)])).all(cls="vi-knob")


def test_gates_of_a_decision_share_one_grid():
    page = parse(gate_list([Gate("a", 1, ">", 0), Gate("b", 1, ">", 2), Gate("c", None, "<", 2)]))
    assert len(page.one(cls="vi-gates").children) == 3 * 7 + 2  # seven cells a gate, a rule between two
    assert [e.attributes["data-gate"] for e in page.all("span") if "data-gate" in e.attributes] == ["a", "b", "c"]
    failed = parse(gate_list([Gate("a", 1, ">", 0), Gate("b", 1, ">", 2)], failed_first=True))
    assert [e.attributes["data-gate"] for e in failed.all("span") if "data-gate" in e.attributes] == ["b", "a"]


def test_every_parameter_explains_the_gate_it_sets():
    for key in DECLARATIONS:
        assert gate_tip(Gate("anything", 1.0, ">", 0.0, key)) in TIPS
    assert gate_tip(Gate("scale", 1.0, ">", 0.0)) == "gate.scale"
    assert gate_tip(Gate("never heard of", 1.0, ">", 0.0, "no.such")) == ""
