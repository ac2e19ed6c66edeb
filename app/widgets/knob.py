"""A parameter as a control, from its declaration: a slider with a number, a switch, or a choice.

    pixel_sigma      ------o-----------   1.5   px460  ↺

Drawn by ourselves because sliders over decades are logarithmic here, and because all seventy cost the page less than
a handful of ready-made ones.  `data-*` tells knobs.js how a place on the slider becomes a value; what the user chooses
arrives as the event `set`.  A knob that differs from the run's value is marked, and ↺ puts it back.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from vins_core.params import DECLARATIONS, Declaration, Params, get

from ..html import Html, tag, text, unit
from ..tooltips import parameter_tip

STEPS = 1000
"""Places on a slider."""
_DECADES = 2.0
"""A range that spans more is logarithmic."""
_BELOW_DEFAULT = 1e-4
"""Where the logarithmic part begins of a range that starts at zero, as a share of the default."""


def figures(value: Any) -> str:
    """A value as it is typed: `1.5`, `1e-06`, `on`, `cauchy`."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:.10g}" if isinstance(value, int | float) else str(value)


def scale_of(declared: Declaration) -> tuple[str, float]:
    """("log" | "linear", lowest value of the slider's continuous part).

    A logarithmic slider whose range begins at zero has zero at its left end.
    """
    low, high = declared.low, declared.high
    assert low is not None and high is not None
    if low > 0:
        return ("log" if math.log10(high / low) > _DECADES and declared.type is float else "linear"), low
    if declared.type is float and 0 < declared.default < high * 1e-3:
        return "log", declared.default * _BELOW_DEFAULT
    return "linear", low


def place(declared: Declaration, value: float) -> int:
    """Where the slider stands for a value, 0..STEPS; knobs.js has the inverse."""
    scale, low = scale_of(declared)
    high = declared.high
    assert high is not None
    if scale == "log":
        share = math.log(value / low) / math.log(high / low) if value > low else 0.0
    else:
        share = (value - low) / (high - low)
    return round(STEPS * min(max(share, 0.0), 1.0))


def knob(declared: Declaration, value: Any, reference: Any) -> Html:
    """One row; `reference` is the run's own value."""
    name = declared.key.split(".")[1]
    if declared.type is bool:
        control = _switch(declared, bool(value))
    elif declared.choices:
        control = _choice(declared, str(value))
    else:
        control = _slider(declared, value)
    return tag(
        "div",
        tag("span", name, cls="vi-term vi-kname", data_tip=parameter_tip(declared.key)),
        control,
        tag("span", unit(declared.unit), cls="vi-kunit"),
        tag("button", "↺", cls="vi-undo", title=f"back to {figures(reference)}", onclick="vi.unset(this)"),
        cls="vi-knobrow" + ("" if value == reference else " vi-changed"),
        data_knob=declared.key,
        data_reference=figures(reference),
        data_words=f"{declared.key} {declared.doc}".lower(),
    )


def _slider(declared: Declaration, value: float) -> Html:
    scale, low = scale_of(declared)
    shown, span = figures(value), f"{figures(declared.low)} to {figures(declared.high)}"
    slide = tag(
        "input",
        type="range",
        min="0",
        max=str(STEPS),
        value=str(place(declared, value)),
        aria_label=declared.key,
        title=span,
        data_low=repr(low),
        data_high=repr(declared.high),
        data_zero="1" if scale == "log" and declared.low == 0 else "",
        data_scale=scale,
        data_whole="1" if declared.type is int else "",
        oninput="vi.slide(this)",
        onchange="vi.slide(this,true)",
    )
    box = tag("input", type="text", inputmode="decimal", value=shown, cls="vi-num", onchange="vi.typed(this)")
    return text((slide, box))


def _switch(declared: Declaration, on: bool) -> Html:
    box = tag(
        "input",
        type="checkbox",
        aria_label=declared.key,
        checked="checked" if on else None,
        onchange="vi.picked(this)",
    )
    return tag("label", box, tag("span", figures(on)), cls="vi-switch")


def _choice(declared: Declaration, value: str) -> Html:
    options = (tag("option", c, value=c, selected="selected" if c == value else None) for c in declared.choices)
    return tag("select", *options, aria_label=declared.key, onchange="vi.picked(this)")


def knobs(params: Params, reference: Params, opened: Iterable[str] = ()) -> Html:
    """Every parameter, grouped by stage; the stages in `opened` and those with changes are unfolded."""
    stages: dict[str, list[Declaration]] = {}
    for declared in DECLARATIONS.values():
        stages.setdefault(declared.key.split(".")[0], []).append(declared)
    unfolded, groups = set(opened), []
    for stage, members in stages.items():
        n = sum(get(params, d.key) != get(reference, d.key) for d in members)
        rows = (knob(d, get(params, d.key), get(reference, d.key)) for d in members)
        title = tag("summary", tag("b", stage), tag("span", len(members), cls="vi-muted"))
        is_open = "open" if n or stage in unfolded else None
        groups.append(tag("details", title, *rows, cls="vi-stageknobs", data_stage=stage, open=is_open))
    return tag("div", *groups, cls="vi-knobs")
