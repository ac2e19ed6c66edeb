"""Markup that escapes by default.

`Html` is markup; a plain `str` is text from anywhere (a topic, a path, a gate's name) and is escaped by every
function here.  So nothing that comes from a file can become markup unless somebody writes `Html(...)` around it.
Class names start with `vi` so that they never meet those of viser's page; their rules are in style.py.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Sequence
from html import escape

from .palette import LINE

DASH = "–"  # what stands where a value does not exist


class Html(str):
    """Markup, safe to send to the page."""

    __slots__ = ()


Child = str | float | int | None | Iterable["Child"]


_SPECIAL = re.compile("""[&<>"']""")


def text(value: Child) -> Html:
    """Markup of `value`: `Html` as it is, text escaped, sequences joined, None nothing."""
    if isinstance(value, Html):
        return value
    if isinstance(value, str):
        return Html(escape(value) if _SPECIAL.search(value) else value)
    if value is None:
        return Html("")
    if isinstance(value, int | float):
        return text(str(value))
    return Html("".join([text(part) for part in value]))


_VOID = ("img", "br", "input")


def tag(name: str, *children: Child, **attributes: str | float | None) -> Html:
    """`<name attributes>children</name>`; `cls` is class, `data_x` is data-x, an attribute None or "" is left out."""
    head = name
    for key, value in attributes.items():
        if value is not None and value != "":
            head += f' {"class" if key == "cls" else key.replace("_", "-")}="{text(str(value))}"'
    if name in _VOID:
        return Html(f"<{head}>")
    return Html(f"<{head}>{''.join([text(child) for child in children])}</{name}>")


def panel(key: str, *children: Child) -> Html:
    """Root of a panel; the page reports a panel as visible while its `data-vip` is."""
    return tag("div", *children, cls="vi", data_vip=key)


# Events the page sends to Python (see browser.py)


def send(**message: str | float | bool) -> str:
    """JavaScript that sends `message`; put it into an attribute of `tag`, which escapes it."""
    return f"vi.send({json.dumps(message, separators=(',', ':'))})"


def frame_link(label: Child, frame: int) -> Html:
    return tag("a", label, cls="vi-link", onclick=send(k="frame", i=int(frame)), title=f"go to frame {int(frame)}")


def track_link(label: Child, track: int) -> Html:
    return tag(
        "a", label, cls="vi-link", onclick=send(k="pick", t="track", i=int(track)), title=f"select track {int(track)}"
    )


# Numbers


def number(value: float | None, digits: int = 3) -> str:
    """`value` with `digits` significant digits, never in more than 7 characters of figures: 0.0123, 12.3, 1.2e+06."""
    if value is None or not math.isfinite(value):
        return DASH if value is None or math.isnan(value) else "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    size = abs(value)
    if size >= 1e5 or size < 1e-4:
        mantissa, exponent = f"{value:.{max(digits - 2, 0)}e}".split("e")
        return f"{_minus(mantissa)}e{int(exponent)}"
    if float(value).is_integer():
        return _minus(f"{value:.0f}")
    decimals = max(digits - 1 - math.floor(math.log10(size)), 0)
    return _minus(f"{value:.{decimals}f}")


def brief(value: float | None, digits: int = 3) -> str:
    """`number` without trailing zeros: 0.25, 2.5, 20."""
    figures = number(value, digits)
    return figures.rstrip("0").rstrip(".") if "." in figures and "e" not in figures else figures


def fixed(value: float | None, decimals: int) -> str:
    """`value` with `decimals` places, for columns that line up."""
    if value is None or not math.isfinite(value):
        return DASH
    return _minus(f"{value:.{decimals}f}")


def _minus(figures: str) -> str:
    return figures.replace("-", "−") if float(figures.replace("−", "-")) else figures.lstrip("-")


UNITS = {"px460": "px₄₆₀", "m/s^2": "m/s²", "deg": "°", "sigma": "σ", "percent": "%"}


def unit(name: str) -> Html:
    """A unit as it is printed: small, after its number."""
    if not name:
        return Html("")
    return tag("span", ("" if name == "deg" else " ") + UNITS.get(name, name), cls="vi-unit")


# Pieces


def term(label: Child, tip: str) -> Html:
    """A name that explains itself: `tip` is a key of tooltips.TIPS."""
    return tag("span", label, cls="vi-term", data_tip=tip)


def chip(*content: Child, tone: str = "", tip: str = "", title: str = "") -> Html:
    """A small label; `tone` is "", "ok", "bad", "est", "imu", "prior" or "sel"."""
    return tag("span", *content, cls=f"vi-chip vi-{tone}" if tone else "vi-chip", data_tip=tip, title=title)


def row(*items: Child) -> Html:
    return tag("div", *items, cls="vi-row")


def heading(title: Child, note: Child = "", tip: str = "") -> Html:
    return tag("div", term(title, tip) if tip else tag("span", title), tag("span", note, cls="vi-note"), cls="vi-h")


def muted(*content: Child) -> Html:
    return tag("span", *content, cls="vi-muted")


def strong(*content: Child) -> Html:
    return tag("b", *content)


def key_cap(name: str) -> Html:
    return tag("kbd", name, cls="vi-key")


def empty(sentence: Child, *hint: Child) -> Html:
    """What stands where there is nothing to show: one sentence, and what to press."""
    return tag("div", tag("div", sentence), tag("div", *hint, cls="vi-muted") if hint else None, cls="vi-empty")


def swatch(colour: str, shape: str = "■") -> Html:
    return tag("span", shape, style=f"color:{colour}")


def bar(share: float, colour: str, title: str = "") -> Html:
    """A horizontal bar filled to `share`, 0..1."""
    share = min(max(share, 0.0), 1.0) if math.isfinite(share) else 0.0
    said = f' title="{text(title)}"' if title else ""
    return Html(f'<div class="vi-bar"{said}><i style="width:{share * 100:.1f}%;background:{text(colour)}"></i></div>')


def stacked_bar(parts: Sequence[tuple[str, float, str]], whole: float | None = None) -> Html:
    """(name, value, colour) parts side by side; `whole` (default their sum) is the full width."""
    whole = sum(v for _, v, _ in parts) if whole is None else whole
    cells = (
        tag("i", title=f"{name} {number(value)}", style=f"width:{100 * value / whole:.2f}%;background:{colour}")
        for name, value, colour in parts
        if whole > 0 and math.isfinite(value)
    )
    return tag("div", *cells, cls="vi-stack", style=f"background:{LINE}")


def table(head: Sequence[tuple[Child, str]], rows: Iterable[Html], *, cls: str = "") -> Html:
    """`head` names the columns with their class ("" left, "n" number); `rows` come from `table_row`."""
    names = tag("tr", *(tag("th", name, cls=f"vi-{kind}" if kind else "") for name, kind in head))
    return tag("table", tag("thead", names), tag("tbody", *rows), cls=f"vi-table {cls}".strip())


def table_row(cells: Iterable[Child], kinds: Sequence[str], *, click: str = "", cls: str = "", title: str = "") -> Html:
    """A row of `cells`, each of the class of its column; `click` is JavaScript."""
    columns = (tag("td", cell, cls=f"vi-{kind}" if kind else "") for cell, kind in zip(cells, kinds, strict=True))
    return tag("tr", *columns, cls=f"{'vi-click ' if click else ''}{cls}".strip(), onclick=click, title=title)


def facts(items: Iterable[tuple[Child, Child]]) -> Html:
    """Names and values in two aligned columns."""
    pairs = ((tag("dt", name), tag("dd", value)) for name, value in items)
    return tag("dl", *(part for pair in pairs for part in pair), cls="vi-facts")
