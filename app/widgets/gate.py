"""The gate widget: one comparison that decided something, drawn the same way everywhere.

    x  matches              13   [######   |   ]
       init.min_matches          > 20    8 short

Verdict as shape and colour, name, value, a meter with the limit marked and the passing side tinted, the comparison,
the margin in words, and the parameter behind the limit as a link to its slider (event `knob`).
Initialisation, keyframe choice, track loss and failure detection all use it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from vins_core.report import Gate

from ..html import Html, brief, number, send, tag, term, text, unit
from ..palette import BAD, CANDIDATE, ESTIMATE, GROUND, OK
from ..tooltips import gate_tip, parameter_tip

OPS = {">=": "≥", ">": ">", "<=": "≤", "<": "<"}


def _icon(body: str, title: str) -> Html:
    return Html(f'<svg width="14" height="14" viewBox="0 0 14 14" role="img" aria-label="{title}">{body}</svg>')


_STROKE = f'fill="none" stroke="{GROUND}" stroke-width="1.8" stroke-linecap="round" stroke-linejoin="round"'
PASSED = _icon(f'<circle cx="7" cy="7" r="6.5" fill="{OK}"/><path d="M4 7.3l2.2 2.2L10.2 5" {_STROKE}/>', "passed")
FAILED = _icon(
    f'<rect x=".5" y=".5" width="13" height="13" rx="3" fill="{BAD}"/><path d="M4.3 4.3l5.4 5.4M9.7 4.3l-5.4 5.4" '
    f"{_STROKE}/>",
    "failed",
)
WARNED = _icon(
    f'<path d="M7 1.2L13.2 12.6H.8z" fill="none" stroke="{BAD}" stroke-width="1.5" stroke-linejoin="round"/>'
    f'<path d="M7 5.2v3.4M7 10.6v.1" stroke="{BAD}" stroke-width="1.5" stroke-linecap="round"/>',
    "failed, advisory",
)
UNKNOWN = _icon(
    f'<circle cx="7" cy="7" r="5.8" fill="none" stroke="{CANDIDATE}" stroke-width="1.5" stroke-dasharray="2.4 2"/>',
    "not computed",
)
SWITCHED = _icon(f'<path d="M7 .6L13.4 7 7 13.4.6 7z" fill="{ESTIMATE}"/>', "triggered")
IDLE = _icon(
    f'<path d="M7 2L12 7 7 12 2 7z" fill="none" stroke="{CANDIDATE}" stroke-width="1.5"/>', "not triggered"
)  # fmt: skip


def verdict(gate: Gate, *, switch: bool = False) -> Html:
    """The icon of a gate.  A `switch` chooses between two things of which neither is bad (keyframe or not)."""
    if gate.value is None or math.isnan(gate.value):
        return UNKNOWN
    if switch:
        return IDLE if gate.passed else SWITCHED
    return PASSED if gate.passed else FAILED if gate.decides else WARNED


def quantity(value: float | None, unit_name: str = "") -> Html:
    """`12.3 px` with the unit small; whole numbers without decimals."""
    if value is None:
        return tag("span", "not computed", cls="vi-unit")
    return text((number(value), unit(unit_name)))


def margin_words(gate: Gate, *, switch: bool = False) -> str:
    """In the gate's unit: `7 short`, `0.4 over`, `5 to spare`; of a switch `3.1 away` or `4 beyond`."""
    margin = gate.margin
    if margin is None or not math.isfinite(margin):
        return "" if gate.value is None else "no margin"
    if margin == 0:
        return "just at the limit"
    if switch:
        side = "away" if margin > 0 else "beyond"
    else:
        side = "to spare" if margin > 0 else "short" if gate.op.startswith(">") else "over"
    return f"{brief(abs(margin))} {side}"


def meter(gate: Gate, colour: str) -> Html:
    """A bar up to the value with the limit marked; the side on which the gate passes is tinted."""
    if gate.value is None or not math.isfinite(gate.value):
        return tag("div", cls="vi-meter vi-none")
    low, high = _span(gate.value, gate.limit)

    def place(v: float) -> float:
        return abs(100 * min(max((v - low) / (high - low), 0.0), 1.0))  # never -0

    zero, value, limit = place(0.0), place(gate.value), place(gate.limit)
    passing = (limit, 100.0) if gate.op.startswith(">") else (0.0, limit)
    start, end = min(zero, value), max(zero, value)
    return Html(
        '<div class="vi-meter">'
        f'<i class="vi-pass" style="left:{passing[0]:.1f}%;width:{passing[1] - passing[0]:.1f}%"></i>'
        f'<i class="vi-fill" style="left:{start:.1f}%;width:{max(end - start, 0.8):.1f}%;background:{colour}"></i>'
        f'<u style="left:{limit:.1f}%"></u></div>'
    )


def _span(value: float, limit: float) -> tuple[float, float]:
    """Ends of a meter: zero, the limit and the value, unless the value is so far out that the limit would vanish."""
    reach = abs(limit) or abs(value) or 1.0
    value = min(max(value, -4 * reach), 4 * reach)
    low, high = min(0.0, value, limit), max(0.0, value, limit)
    room = 0.18 * (high - low)
    if high == low:
        return 0.0, reach
    return low - room if low < 0 else 0.0, high + room


def gate_rows(gate: Gate, *, switch: bool = False) -> Html:
    """Two lines of the gate grid, see `gate_list`."""
    if switch:
        colour = CANDIDATE if gate.passed else ESTIMATE
    else:
        colour = OK if gate.passed else BAD
    words = margin_words(gate, switch=switch)
    tone = "" if gate.passed or switch else "vi-bad"
    name = gate.name.replace("_", " ")
    tip = gate_tip(gate)
    knob = (
        tag("span", gate.knob, cls="vi-knob", onclick=send(k="knob", key=gate.knob), data_tip=parameter_tip(gate.knob))
        if gate.knob
        else None
    )
    advisory = None if gate.decides else tag("span", "advisory", cls="vi-unit", title="shown, but decides nothing")
    limit = tag("span", OPS.get(gate.op, gate.op), " ", brief(gate.limit), unit(gate.unit))
    return text(
        (
            tag("span", verdict(gate, switch=switch), data_gate=gate.name),
            term(name, tip),
            tag("span", quantity(gate.value, gate.unit), cls="vi-val"),
            meter(gate, colour),
            Html("<span></span>"),
            tag("span", knob, advisory, cls="vi-behind"),
            tag("span", limit, tag("span", words, cls=tone), cls="vi-lim"),
        )
    )


def gate_list(gates: Iterable[Gate], *, switch: bool = False, failed_first: bool = False) -> Html:
    """All gates of a decision in one grid, so that their columns line up."""
    ordered = sorted(gates, key=lambda g: g.passed) if failed_first else list(gates)
    rule = Html('<div class="vi-rule"></div>')
    parts = [part for gate in ordered for part in (rule, gate_rows(gate, switch=switch))]
    return tag("div", *parts[1:], cls="vi-gates")


def gate_lines(gates: Iterable[Gate]) -> Html:
    """One line a gate, for decisions that took many: its limit is the link to the parameter behind it."""
    return tag("div", *(_line(gate) for gate in gates), cls="vi-gatelines")


def _line(gate: Gate) -> Html:
    limit = text((OPS.get(gate.op, gate.op), " ", brief(gate.limit), unit(gate.unit)))
    if gate.knob:
        click, tip = send(k="knob", key=gate.knob), parameter_tip(gate.knob)
        limit = tag("span", limit, cls="vi-knob", onclick=click, data_tip=tip)
    known = gate.value is not None and not math.isnan(gate.value)
    aside = "" if gate.decides else " vi-aside"
    return tag(
        "div",
        verdict(gate),
        term(gate.name.replace("_", " "), gate_tip(gate)),
        tag("span", quantity(gate.value if known else None, gate.unit), cls="vi-val"),
        tag("span", meter(gate, OK if gate.passed else BAD), title=margin_words(gate) if known else ""),
        tag("span", limit),
        cls=f"vi-gateline{aside}" + ("" if gate.passed or not known or not gate.decides else " vi-failed"),
        title="" if gate.decides else "shown, but decides nothing here",
        data_gate=gate.name,
    )
