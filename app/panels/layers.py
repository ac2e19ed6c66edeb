"""What the 3D view draws: a switch a layer, with the mark it is drawn as."""

from __future__ import annotations

from ..context import PanelContext
from ..html import Html, muted, panel, swatch, tag
from ..palette import BAD, CANDIDATE, ESTIMATE, FORK, IMU, MUTED, OK, PRIOR, SELECTION, TRUTH

TITLE = "Layers"
ICON = "STACK_2"
KEY = "layers"

MARKS = {
    "trajectory.estimate": (ESTIMATE, "—"),
    "trajectory.truth": (TRUTH, "—"),
    "window.frustums": (ESTIMATE, "◁"),
    "imu.edges": (IMU, "—"),
    "landmarks.candidate": (CANDIDATE, "◆"),
    "landmarks.triangulated": (ESTIMATE, "●"),
    "landmarks.outlier": (BAD, "★"),
    "landmarks.marginalized": (PRIOR, "■"),
    "selection": (SELECTION, "●"),
    "compare.run": (FORK, "╌"),
    "what_if.window": (FORK, "◁"),
    "uncertainty": (PRIOR, "○"),
    "loops.accepted": (OK, "—"),
    "loops.refused": (BAD, "╌"),
    "loops.graph": (OK, "╌"),
    "loops.window": (SELECTION, "—"),
    "gps.fixes": (OK, "●"),
    "gps.trajectory": (OK, "∿"),
    "grid": (MUTED, "▦"),
    "axes": (MUTED, "┼"),
}
"""Colour and sign of every layer, as the 3D view has it."""


def render(ctx: PanelContext) -> str:
    return panel(KEY, tag("div", *(_switch(*layer) for layer in ctx.layers), cls="vi-layers"))


def _switch(name: str, title: str, on: bool) -> Html:
    colour, sign = MARKS[name]
    box = tag(
        "input",
        type="checkbox",
        checked="checked" if on else None,
        onchange=f"vi.send({{k:'layer',name:'{name}',on:this.checked}})",
    )
    return tag("label", box, swatch(colour, sign), tag("span", title) if on else muted(title), cls="vi-switch")
