"""The whole run in lanes, and this frame in one line of chips."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from vins_core.report import FixVerdict, Status

from .. import views
from ..context import PanelContext
from ..gps import VERDICTS, GpsSeries
from ..html import Html, chip, empty, fixed, key_cap, muted, number, panel, row, strong, tag, term, text, unit
from ..palette import BAD, CANDIDATE, ESTIMATE, IMU, LINE, OK, RAISED, TEXT
from ..series import LoopSeries, RunSeries
from ..style import FACTOR_COLOURS
from ..widgets.plot import area, mark, nice_step, svg, ticks, top_of, x_of

TITLE = "Timeline"
ICON = "TIMELINE"
KEY = "timeline"

STATUS_COLOURS = {
    Status.FILLING: RAISED,
    Status.INITIALIZING: CANDIDATE,
    Status.TRACKING: "#2F6F92",
    Status.FAILED: BAD,
}
_GAP = 4


@dataclass(frozen=True)
class Lane:
    """A row of the timeline; `body` is drawn in 0..height."""

    name: str
    tip: str
    height: int
    body: Html


def backdrop(ctx: PanelContext) -> str:
    series = ctx.run.series
    if not len(series):
        return tag("div", cls="vi")
    lanes = _lanes(series)
    starts = np.cumsum([0, *(lane.height + _GAP for lane in lanes)]).tolist()
    height = starts[-1] - _GAP
    seconds = _seconds(series)
    grid = ticks(np.array([frame for frame, _ in seconds]), len(series), 0, height, LINE, 1.0)
    bodies = (Html(f'<g transform="translate(0,{y})">{lane.body}</g>') for lane, y in zip(lanes, starts))
    names = (
        tag("span", term(lane.name, lane.tip), style=f"top:{y + lane.height / 2 - 5:g}px")
        for lane, y in zip(lanes, starts)
    )
    clock = (tag("span", label, style=f"left:{100 * frame / max(len(series) - 1, 1):.2f}%") for frame, label in seconds)
    lane = tag(
        "div",
        svg(height, grid, *bodies),
        tag("i", cls="vi-head"),
        cls="vi-lane vi-sunken",
        style=f"height:{height}px",
        onpointerdown="vi.scrub(event,this)",
        onpointermove="vi.scrub(event,this)",
        data_lanes=" ".join(lane.name for lane in lanes),
    )
    body = tag("div", lane, tag("div", *clock, cls="vi-clock"), cls="vi-grow")
    return tag("div", tag("div", tag("div", *names, cls="vi-lanes"), body, cls="vi-time"), cls="vi")


def _lanes(series: RunSeries) -> list[Lane]:
    """Only lanes in which something happened."""
    n = len(series)
    lanes = []
    if np.isfinite(series.cost).any():
        lanes.append(Lane("cost", "cost", 26, _costs(series, 26)))
    if len(series.keyframes):
        lanes.append(Lane("keyframes", "keyframe", 9, ticks(series.keyframes, n, 0, 9, ESTIMATE)))
    if series.loops.candidate.any():
        lanes.append(Lane("loops", "loops", 15, _loops(series.loops, n)))
    if len(series.gps):
        lanes.append(Lane("GPS", "gps.fix", 13, _fixes(series.gps, n)))
    for name, tip, kinds in (
        ("init", "attempts", ("attempt", "initialized", "restart")),
        ("motion", "motion", ("degenerate",)),
        ("anomalies", "anomaly", ("anomaly",)),
    ):
        events = [e for e in series.events if e.kind in kinds]
        if events:
            marks = (
                mark(e.frame, n, 0, 9, _EVENT_COLOURS[e.kind], f"frame {e.frame}: {e.text}", _EVENT_WIDTHS[e.kind])
                for e in events
            )
            lanes.append(Lane(name, tip, 9, text(marks)))
    lanes.append(Lane("status", "status", 6, _bands(series, 6)))
    return lanes


def _loops(loops: LoopSeries, n: int) -> Html:
    """Accepted ones above, below them candidates that were refused."""
    refused = loops.candidate & ~loops.accepted
    return text((ticks(loops.frame[loops.accepted], n, 0, 7, OK, 1.6), ticks(loops.frame[refused], n, 8, 15, BAD, 1.6)))


def _fixes(gps: GpsSeries, n: int) -> Html:
    """Fixes that count in the end above, below them those that do not."""
    last = gps.final_verdicts
    used, gated = (np.unique(gps.frame[last == VERDICTS.index(v)]) for v in (FixVerdict.USED, FixVerdict.GATED))
    return text((ticks(used, n, 0, 6, OK, 1.2), ticks(gated, n, 7, 13, BAD, 1.6)))


_EVENT_COLOURS = {"attempt": BAD, "initialized": OK, "restart": "#FFFFFF", "anomaly": TEXT, "degenerate": IMU}
_EVENT_WIDTHS = {"attempt": 2.0, "initialized": 4.0, "restart": 4.0, "anomaly": 2.5, "degenerate": 2.0}


def _costs(series: RunSeries, height: int) -> Html:
    """The costs stacked."""
    levels = np.concatenate([np.zeros((len(series), 1)), np.cumsum(series.cost, 1)], 1)
    top = top_of(levels[:, -1])
    names = (*views.FACTORS, "depth") if np.nansum(series.cost[:, 3]) > 0 else views.FACTORS
    return text(area(levels[:, k], levels[:, k + 1], top, height, FACTOR_COLOURS[name]) for k, name in enumerate(names))


def _bands(series: RunSeries, height: int) -> Html:
    n, parts, start = len(series), [], 0
    for status, group in groupby(series.status):
        end = start + sum(1 for _ in group)
        x0, x1 = (float(x_of(min(max(k - 0.5, 0), n - 1), n)) for k in (start, end))
        label = tag("title", f"{status}: frames {start} to {end - 1}")
        parts.append(
            tag("rect", label, x=f"{x0:.1f}", y=0, width=f"{max(x1 - x0, 1):.1f}", height=height,
                fill=STATUS_COLOURS[status])
        )  # fmt: skip
        start = end
    return text(parts)


def _seconds(series: RunSeries) -> list[tuple[float, str]]:
    """(fractional frame, label) of round seconds, at most about ten."""
    last = float(series.t_s[-1])
    if last <= 0:
        return []
    step = nice_step(last, 10)
    at = np.arange(0, last + 1e-9, step)
    frames = np.interp(at, series.t_s, np.arange(len(series)))
    return [(float(f), f"{t:g} s") for f, t in zip(frames, at)]


def render(ctx: PanelContext) -> str:
    series, report, k = ctx.run.series, ctx.report, ctx.frame
    if not len(series):
        return panel(KEY, empty("The estimator has not finished its first frame yet.", ctx.progress))
    tracks, solve = report.tracks, report.solve
    chips = [
        chip(strong(views.run_name(ctx.run)), title=ctx.run.header.recording),
        chip("frame ", tag("b", k, data_frame=k), muted(f"/ {len(series) - 1}"), title=f"stamp {report.t_ns} ns"),
        chip("t ", strong(fixed(float(series.t_s[k]), 2)), unit("s")),
    ]
    if report.status is not Status.TRACKING:
        chips.append(chip(str(report.status), tone="bad" if report.status is Status.FAILED else "sel", tip="status"))
    if report.keyframe is not None:
        kept, kind = report.keyframe.is_keyframe, report.marginalization
        chips.append(
            chip(
                "KEYFRAME " if kept else "no keyframe ",
                k - 1,
                f" → {kind.kind}" if kind and kind.kind != "none" else None,
                tone="est" if kept else "",
                tip="keyframe",
            )
        )
    chips.append(
        chip(
            "tracks ", strong(len(tracks.ids)), tag("span", f"+{tracks.n_new}", cls="vi-ok"),
            tag("span", f"−{len(tracks.lost_ids)}", cls="vi-bad"), tip="tracks",
        )
    )  # fmt: skip
    if solve is not None:
        after = [f"{len(solve.iterations)} it"]
        if "solve" in ctx.ms:
            after.append(f"{ctx.ms['solve']:.0f} ms")
        chips.append(
            chip(
                "cost ", strong(number(solve.before.total), " → ", number(solve.after.total)),
                muted(" · ".join(after)), tip="cost",
            )
        )  # fmt: skip
    if np.isfinite(series.ate_m[k]):
        chips.append(chip("ATE ", strong(number(100 * float(series.ate_m[k]))), unit("cm"), tip="ate"))
    for anomaly in report.anomalies:
        where = f"{anomaly.topic}: " if anomaly.topic else ""
        chips.append(chip(where, anomaly.kind.replace("_", " "), tone="bad", title=anomaly.message))
    if ctx.progress:
        chips.append(chip(ctx.progress, tone="imu"))
    keys = (*_KEYS[:-1], ("N", "loop"), _KEYS[-1]) if series.loops.candidate.any() else _KEYS
    hints = tag(
        "span",
        strong("playing" if ctx.playing else "paused"),
        *(part for cap, does in keys for part in (" ", key_cap(cap), f" {does}")),
        cls="vi-keys",
    )
    return panel(KEY, row(*chips, hints))


_KEYS = (("←", ""), ("→", "step"), ("⇧", "keyframe"), ("space", "play"), ("G", "worst cost"), ("Ctrl K", "all"))
