"""Every parameter is a control made from its declaration."""

from __future__ import annotations

import pytest
from fake_reports import Markup

from app.tooltips import TIPS
from app.widgets.knob import STEPS, figures, knob, knobs, place, scale_of
from vins_core.params import DECLARATIONS, Declaration, Params, replace

NUMBERS = [d for d in DECLARATIONS.values() if d.low is not None]


def test_every_parameter_appears_once_under_its_stage() -> None:
    html = Markup(knobs(Params(), Params()))
    assert [e.attributes["data-knob"] for e in html.all("div", cls="vi-knobrow")] == list(DECLARATIONS)
    for group in html.all("details"):
        stage = group.attributes["data-stage"]
        assert all(
            e.attributes["data-knob"].startswith(f"{stage}.") for e in group.walk() if "data-knob" in e.attributes
        )


@pytest.mark.parametrize("declared", DECLARATIONS.values(), ids=lambda d: d.key)
def test_a_knob_carries_unit_meaning_and_range(declared: Declaration) -> None:
    html = Markup(knob(declared, declared.default, declared.default))
    row = html.one("div", data_knob=declared.key)
    assert declared.doc.lower() in row.attributes["data-words"]
    assert html.one(cls="vi-kname").attributes["data-tip"] in TIPS
    control = next(e for e in html.root.walk() if e.attributes.get("aria-label") == declared.key)
    if declared.low is not None:
        assert control.attributes["title"] == f"{figures(declared.low)} to {figures(declared.high)}"
    elif declared.choices:
        assert [o.text for o in html.all("option")] == list(declared.choices)
    else:
        assert control.attributes["type"] == "checkbox"


@pytest.mark.parametrize("declared", NUMBERS, ids=lambda d: d.key)
def test_sliders_span_their_range(declared: Declaration) -> None:
    assert declared.low is not None and declared.high is not None
    assert (place(declared, declared.low), place(declared, declared.high)) == (0, STEPS)
    assert 0 < place(declared, (declared.low + declared.high) / 2) <= STEPS


@pytest.mark.parametrize("declared", NUMBERS, ids=lambda d: d.key)
def test_defaults_stand_where_a_step_changes_little(declared: Declaration) -> None:
    """A linear slider over many decades would keep the default at its left end."""
    scale, low = scale_of(declared)
    assert scale in ("log", "linear")
    if declared.default > low and declared.type is float and scale == "log":
        assert place(declared, declared.default) > STEPS / 20


def test_a_changed_knob_is_marked_and_its_stage_unfolded() -> None:
    changed = replace(Params(), {"solver.min_gain_ratio": 0.1})
    html = Markup(knobs(changed, Params()))
    (row,) = html.all("div", cls="vi-changed")
    assert row.attributes["data-knob"] == "solver.min_gain_ratio"
    assert row.attributes["data-reference"] == figures(Params().solver.min_gain_ratio)
    assert [g.attributes["data-stage"] for g in html.all("details") if "open" in g.attributes] == ["solver"]
