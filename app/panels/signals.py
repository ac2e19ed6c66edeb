"""Every quantity over the whole run, one strip each, with its value at the playhead beside it; a click seeks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vins_core import params as parameters

from ..context import PanelContext, RunView
from ..html import Html, brief, empty, key_cap, number, panel, tag, term, unit
from ..palette import BAD, ESTIMATE, FORK, IMU, OK, PRIOR
from ..prior import FREE
from ..series import RunSeries
from ..style import FACTOR_COLOURS
from ..widgets.plot import WIDTH, line, svg, top_of

TITLE = "Signals"
ICON = "CHART_LINE"
KEY = "signals"

HEIGHT, GAP = 34, 3
PLAIN = "#B4BDC9"  # a curve whose colour says nothing


@dataclass(frozen=True)
class Signal:
    """One strip.  Layouts name it by `key`; `limit` names the parameter drawn as a dashed line."""

    key: str
    name: str
    tip: str
    colour: str
    values: Callable[[RunSeries], np.ndarray]
    unit: str = ""
    limit: str = ""
    least: float = 0.0  # smallest upper end of the axis: below it there is nothing to see


def _norm(rows: np.ndarray) -> np.ndarray:
    return np.linalg.norm(rows, axis=1)


def _unless_zero(values: np.ndarray) -> np.ndarray:
    """Nothing where there is never any."""
    return values if np.nansum(values) > 0 else np.full(len(values), np.nan)


SIGNALS = (
    Signal("ate", "ATE", "ate", ESTIMATE, lambda s: 100 * s.ate_m, "cm"),
    Signal("cost", "total cost", "cost", PLAIN, lambda s: s.cost.sum(1)),
    Signal("visual", "visual cost", "cost.visual", FACTOR_COLOURS["visual"], lambda s: s.cost[:, 0]),
    Signal("imu", "IMU cost", "cost.imu", IMU, lambda s: s.cost[:, 1]),
    Signal("prior", "prior cost", "cost.prior", PRIOR, lambda s: s.cost[:, 2]),
    Signal("depth", "depth cost", "cost.depth", FACTOR_COLOURS["depth"], lambda s: _unless_zero(s.cost[:, 3])),
    Signal("tracks", "tracks", "tracks", PLAIN, lambda s: s.tracks.astype(float)),
    Signal("parallax", "parallax", "parallax", PLAIN, lambda s: s.parallax_px, "px460", "window.keyframe_parallax"),
    Signal("solve", "solve", "ms", PLAIN, lambda s: s.ms.get("solve", np.full(len(s), np.nan)), "ms"),
    Signal("b_a", "|b_a|", "b_a", IMU, lambda s: _norm(s.b_a), "m/s^2"),
    Signal("b_g", "|b_g|", "b_g", IMU, lambda s: _norm(s.b_g), "rad/s"),
    Signal("leak.yaw", "yaw leak", "prior.yaw", PRIOR, lambda s: s.yaw_leak, "1/rad²", least=FREE),
    Signal("drift.graph", "graph drift", "drift.graph", OK, lambda s: 100 * s.moved_m[:, 0], "cm"),
    Signal("drift.fast", "loop drift", "drift.fast", FORK, lambda s: 100 * s.moved_m[:, 1], "cm"),
    Signal("drift.apart", "difference", "drift.apart", PLAIN, lambda s: 100 * s.corrections_apart_m, "cm"),
    Signal("gps.sigma", "GPS yaw σ", "gps.yaw", OK, lambda s: s.gps.yaw_sigma_deg, "deg", "gps.max_yaw_sigma_deg"),
    Signal("gps.outage", "GPS outage", "gps.outage", IMU, lambda s: s.gps.outage_s, "s", "gps.max_outage_s"),
    Signal("speed", "speed", "speed", PLAIN, lambda s: _norm(s.v_w_b), "m/s"),
)


def present(ctx: PanelContext) -> list[tuple[Signal, np.ndarray]]:
    """The signals that the layout wants and of which this run has any value."""
    wanted = [signal for signal in SIGNALS if not ctx.signals or signal.key in ctx.signals]
    known = [(signal, signal.values(ctx.run.series)) for signal in wanted]
    return [(signal, values) for signal, values in known if np.isfinite(values).any()]


def backdrop(ctx: PanelContext) -> str:
    """Names, curves and the playhead; the column on the right is left free for `render`."""
    shown = []
    for signal, values in present(ctx):
        other = None if ctx.other is None else ctx.other.on_clock(signal.values(ctx.other.run.series))
        shown.append((signal, values, other, *_axis(ctx.run, signal, values, other)))
    names = (_name(signal, values, top) for signal, values, _, top, _ in shown)
    strips = (_strip(signal, values, other, top, limit) for signal, values, other, top, limit in shown)
    lane = tag(
        "div",
        *strips,
        tag("i", cls="vi-head"),
        cls="vi-lane",
        onpointerdown="vi.scrub(event,this)",
        onpointermove="vi.scrub(event,this)",
    )
    return tag("div", tag("div", *names, cls="vi-names"), lane, tag("div", cls="vi-values"), cls="vi vi-plots")


def render(ctx: PanelContext) -> str:
    shown = present(ctx)
    if not shown:
        return panel(KEY, empty("Nothing has been estimated yet.", "Press ", key_cap("→"), " to step."))
    values = (
        tag("div", tag("span", number(float(v[ctx.frame])), unit(signal.unit)), _other_value(ctx, signal),
            cls="vi-value", style=_TALL, data_signal=signal.key)
        for signal, v in shown
    )  # fmt: skip
    column = tag("div", *values, cls="vi-values", style=f"top:{-len(shown) * (HEIGHT + GAP)}px")
    return tag("div", tag("div", column, cls="vi-over"), cls="vi vi-tight", data_vip=KEY)


def _other_value(ctx: PanelContext, signal: Signal) -> Html | None:
    """What the run compared with has at this instant."""
    k = ctx.other.at(ctx.frame) if ctx.other is not None else None
    if ctx.other is None or k is None:
        return None
    return tag("span", number(float(signal.values(ctx.other.run.series)[k])), cls="vi-otherval")


_TALL = f"height:{HEIGHT}px;margin-bottom:{GAP}px"


def _axis(run: RunView, signal: Signal, values: np.ndarray, other: np.ndarray | None) -> tuple[float, float | None]:
    """(upper end, limit to draw); the run compared with may stretch the axis, but not flatten the run shown."""
    limit = float(parameters.get(run.header.params, signal.limit)) if signal.limit else None
    top = max(top_of(values), signal.least)
    if other is not None and np.isfinite(other).any():
        top = max(top, min(top_of(other), 3 * top))
    return max(top, 1.15 * (limit or 0.0)), limit


def _name(signal: Signal, values: np.ndarray, top: float) -> Html:
    highest = float(np.nanmax(values))
    note = f"max {brief(highest)}"
    cut = f"higher than {brief(top)} is cut" if highest > top else ""
    return tag(
        "div",
        tag("span", term(signal.name, signal.tip), style=f"color:{signal.colour}"),
        tag("span", note, "…" if cut else "", cls="vi-max", title=cut),
        cls="vi-name",
        style=_TALL,
    )


def _strip(signal: Signal, values: np.ndarray, other: np.ndarray | None, top: float, limit: float | None) -> Html:
    curve = line(values, top, HEIGHT, signal.colour)
    beside = line(other, top, HEIGHT, FORK) if other is not None else Html("")
    rule = _rule(HEIGHT - limit / top * (HEIGHT - 2) - 1) if limit is not None else Html("")
    return tag("div", svg(HEIGHT, rule, beside, curve), cls="vi-strip", style=_TALL)


def _rule(y: float) -> Html:
    return Html(
        f'<path d="M0,{y:.1f}H{WIDTH}" stroke="{BAD}" stroke-opacity=".7" stroke-dasharray="4 4" '
        'vector-effect="non-scaling-stroke"/>'
    )
