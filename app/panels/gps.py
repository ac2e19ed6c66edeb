"""GPS: the map of fixes and trajectories, every gate of a fix, the alignment of the odometry's world, outages."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vins_core import params as parameters
from vins_core.report import FixReport, FixVerdict, GpsReport, GpsStatus

from ..context import PanelContext, RunView
from ..gps import UNKNOWN, VERDICTS, GpsSeries
from ..html import (
    Html,
    chip,
    empty,
    fixed,
    frame_link,
    heading,
    key_cap,
    muted,
    number,
    panel,
    row,
    strong,
    table,
    table_row,
    tag,
    term,
    text,
    unit,
)
from ..palette import ESTIMATE, IMU, OK
from ..widgets.gate import gate_lines
from ..widgets.gps_map import MapPicture, gps_map, symbol
from ..widgets.plot import area, line, stretches, svg, ticks

TITLE = "GPS"
ICON = "SATELLITE"
KEY = "gps"

PLOT = 54
"""Height of the heading's plot, px."""
MOST_SIGMA_DEG = 5.0
"""Half the range of the heading's plot at most: a band that is wider is cut."""


def exists(run: RunView) -> bool:
    return len(run.series.gps) > 0


def selected_fix(ctx: PanelContext) -> int:
    """The fix that the user picked, or the last one judged so far; -1 for none."""
    gps = ctx.run.series.gps
    if ctx.selection.kind == "fix" and 0 <= ctx.selection.id < len(gps):
        return ctx.selection.id
    return int(np.searchsorted(gps.frame, ctx.frame, side="right")) - 1


# Over the run: the heading


def backdrop(ctx: PanelContext) -> str:
    """Yaw of the odometry's world on the earth with three standard deviations, and where no fix counts."""
    gps, n = ctx.run.series.gps, len(ctx.run)
    known = np.isfinite(gps.yaw_deg) & np.isfinite(gps.yaw_sigma_deg)
    if not known.any():
        return str(tag("div", cls="vi"))
    yaw = np.full(n, np.nan)
    yaw[known] = np.degrees(np.unwrap(np.radians(gps.yaw_deg[known])))
    centre = float(np.median(yaw[known]))
    sure = gps.fusing & known
    reach = 3 * float(np.max(gps.yaw_sigma_deg[sure])) if sure.any() else MOST_SIGMA_DEG
    reach = min(max(1.25 * reach, float(np.max(np.abs(yaw[sure] - centre), initial=0.0)) * 1.1, 0.2), MOST_SIGMA_DEG)
    low, high = (yaw - centre + side * 3 * gps.yaw_sigma_deg + reach for side in (-1, 1))
    band = area(np.clip(low, 0, 2 * reach), np.clip(high, 0, 2 * reach), 2 * reach, PLOT, "#1D3A4C")
    curve = line(yaw - centre + reach, 2 * reach, PLOT, ESTIMATE)
    begun = np.flatnonzero(np.diff(np.append(False, gps.fusing).astype(np.int8)) == 1)
    outages = stretches(silent(ctx.run), PLOT, IMU, 0.22, "no fix counts")
    lane = tag(
        "div",
        svg(PLOT, band, curve, outages, ticks(begun, n, 0, PLOT, OK, 1.6)),
        tag("i", cls="vi-head"),
        cls="vi-lane vi-sunken",
        style=f"height:{PLOT}px",
        onpointerdown="vi.scrub(event,this)",
        onpointermove="vi.scrub(event,this)",
        data_plot="yaw",
    )
    ends = tag(
        "div",
        *(tag("span", fixed(centre + side * reach, 1), unit("deg")) for side in (1, -1)),
        cls="vi-ends",
    )
    note = text(("±3σ · from ", tag("span", "▏", style=f"color:{OK}"), "on fixes count"))
    return str(
        tag(
            "div",
            heading("heading of the odometry on the earth", note, "gps.yaw"),
            tag("div", lane, ends, cls="vi-yaw"),
            cls="vi",
        )
    )


def silent(run: RunView) -> np.ndarray:
    """(n,) frames within an outage."""
    return run.series.gps.in_outage(float(parameters.get(run.header.params, "gps.max_outage_s")))


# At this frame


def render(ctx: PanelContext) -> str:
    gps = ctx.run.series.gps
    if not len(gps):
        return panel(KEY, empty("No fix has come yet.", "Press ", key_cap("→"), " to step."))
    parts = [*_status(ctx), gps_map(picture(ctx)), _legend(gps, ctx.frame)]
    return panel(KEY, *parts, *_fix(ctx), *_alignment(ctx.report.gps))


def picture(ctx: PanelContext) -> MapPicture:
    final = ctx.run.final
    if final is None or not len(final.t_ns):
        return MapPicture(ctx.run.series.gps, ctx.frame, selected_fix(ctx), np.zeros((0, 3)), np.zeros(0, bool))
    stamps = np.array([s.t_ns for s in ctx.run.summaries], np.int64)
    path = np.full((len(stamps), 3), np.nan)
    path[final.frame] = final.T_e_b[:, :3]
    used = np.sort(final.fix_t_ns[final.fix_used])
    limit_ns = 1e9 * float(parameters.get(ctx.run.header.params, "gps.max_outage_s"))
    return MapPicture(ctx.run.series.gps, ctx.frame, selected_fix(ctx), path, _far_from(stamps, used, limit_ns / 2))


def _far_from(t_ns: np.ndarray, used_ns: np.ndarray, reach_ns: float) -> np.ndarray:
    """(n,) further than `reach` from every fix that counts."""
    if not len(used_ns):
        return np.ones(len(t_ns), bool)
    after = np.clip(np.searchsorted(used_ns, t_ns), 0, len(used_ns) - 1)
    gap = np.minimum(np.abs(used_ns[after] - t_ns), np.abs(used_ns[np.maximum(after - 1, 0)] - t_ns))
    return gap > reach_ns


def _status(ctx: PanelContext) -> Iterator[Html]:
    report = ctx.report.gps
    yield heading("GPS", muted("at frame ", ctx.frame), "gps")
    if report is None:
        yield row(chip("no pose, so nothing to hold to the earth" if ctx.report.pose is None else "not fused here"))
        return
    tone = {GpsStatus.FUSING: "ok", GpsStatus.ALIGNING: "sel", GpsStatus.WAITING: ""}[report.status]
    chips = [chip(str(report.status), tone=tone, tip="gps.status")]
    if report.yaw_deg is not None and report.yaw_sigma_deg is not None:
        chips.append(
            chip(
                "yaw ", strong(fixed(report.yaw_deg, 2)), muted("±"), strong(fixed(3 * report.yaw_sigma_deg, 2)),
                unit("deg"), tip="gps.yaw",
            )
        )  # fmt: skip
    if report.covariance is not None:
        sigma = float(np.sqrt(np.linalg.eigvalsh(report.covariance[:2, :2])[-1]))
        chips.append(chip("position σ ", strong(number(sigma)), unit("m"), tip="gps.position"))
    if report.scale is not None and report.scale_sigma:
        word = "too short by " if report.scale >= 0 else "too long by "
        values = (strong(fixed(100 * abs(report.scale), 2)), muted("±"), fixed(300 * report.scale_sigma, 2))
        chips.append(chip(word, *values, unit("percent"), tip="gps.scale"))
    outage = next((g for g in report.gates if g.name == "outage_s"), None)
    if outage is not None and not outage.passed and outage.value is not None:
        chips.append(
            chip("no fix counts for ", strong(fixed(outage.value, 1)), unit("s"), tone="imu", tip="gps.outage")
        )
    yield row(*chips)
    if report.outcome:
        yield tag("div", report.outcome, cls="vi-outcome vi-plain")


def _legend(gps: GpsSeries, frame: int) -> Html:
    now = gps.verdicts(frame)
    items = [
        tag("span", symbol(verdict), term(_NAMES[verdict], f"gps.fix.{_NAMES[verdict]}"), " ", strong(count),
            data_fixes=_NAMES[verdict], data_count=count)
        for k, verdict in enumerate(VERDICTS)
        if (count := int((now == k).sum())) or verdict is FixVerdict.USED
    ]  # fmt: skip
    to_come = int((now == UNKNOWN).sum())
    lines = [
        tag("span", tag("span", "—", style=f"color:{OK}"), " ", term("final", "gps.final")),
        tag("span", tag("span", "—", style=f"color:{ESTIMATE}"), " ", term("live", "gps.live")),
    ]
    later = [muted(f"{to_come} to come")] if to_come else []
    return text((tag("div", *items, *later, cls="vi-legend"), tag("div", *lines, _HINT, cls="vi-legend")))


_NAMES = {FixVerdict.USED: "used", FixVerdict.GATED: "gated", FixVerdict.OPEN: "open"}
_HINT = muted("wheel zooms · drag pans · click a fix for its gates")


# One fix


def _fix(ctx: PanelContext) -> Iterator[Html]:
    gps, k = ctx.run.series.gps, selected_fix(ctx)
    if k < 0:
        yield heading("fix", "none has come yet", "gps.fix")
        return
    report = _report_of(ctx, k)
    picked = ctx.selection.kind == "fix"
    judged = text(("judged in frame ", frame_link(int(gps.frame[k]), int(gps.frame[k]))))
    yield heading(text(("selected fix " if picked else "fix ", strong(k))), judged, "gps.fix")
    if report is None:
        yield muted("Its frame has no report of it.")
        return
    yield row(*_verdicts(ctx, k))
    yield from _numbers(ctx, k, report)
    yield gate_lines(report.gates)


def _report_of(ctx: PanelContext, k: int) -> FixReport | None:
    gps = ctx.run.series.gps
    frame = int(gps.frame[k])
    report = ctx.report if frame == ctx.frame else ctx.run.report(frame)
    place = k - int(np.searchsorted(gps.frame, frame))
    return report.gps.fixes[place] if report.gps is not None and place < len(report.gps.fixes) else None


def _verdicts(ctx: PanelContext, k: int) -> Iterator[Html]:
    """When it was judged, every change since, and the last word."""
    tones = {FixVerdict.USED: "ok", FixVerdict.GATED: "bad", FixVerdict.OPEN: ""}
    for number_of, (frame, verdict) in enumerate(ctx.run.series.gps.history(k)):
        since = text((" since ", frame_link(frame, frame))) if number_of else None
        yield chip(str(verdict), since, tone=tones[verdict], tip=f"gps.fix.{_NAMES[verdict]}")
    final = ctx.run.final
    if final is not None and ctx.run.series.gps.t_ns[k] in final.fix_t_ns:
        used = bool(final.fix_used[final.fix_t_ns == ctx.run.series.gps.t_ns[k]][0])
        yield chip("in the end ", "used" if used else "gated", tone="ok" if used else "bad", tip="gps.final")


def _numbers(ctx: PanelContext, k: int, report: FixReport) -> Iterator[Html]:
    if report.z_e is None or report.covariance is None:
        return
    sigma = np.sqrt(np.maximum(np.diag(report.covariance), 0))
    columns = [("", ""), *((axis, "n") for axis in ("east", "north", "up"))]
    kinds = [kind for _, kind in columns]

    def line_of(name: str, tip: str, values: np.ndarray) -> Html:
        return table_row((term(name, tip), *(text((fixed(float(v), 2), unit("m"))) for v in values)), kinds)

    rows = [line_of("antenna", "gps.antenna", report.z_e), line_of("σ", "gps.sigma", sigma)]
    if report.innovation_m is not None and report.innovation_covariance is not None:
        rows.append(line_of("innovation", "gps.innovation", report.innovation_m))
        rows.append(line_of("its σ", "gps.innovation", np.sqrt(np.diag(report.innovation_covariance))))
    yield table(columns, rows)


# The alignment


def _alignment(report: GpsReport | None) -> Iterator[Html]:
    if report is None or not report.gates:
        return
    done = report.status is GpsStatus.FUSING
    note = f"{report.n_window} moments open" + (f" · {report.iterations} iterations" if report.iterations else "")
    yield heading("alignment" if not done else "what holds it", note, "gps.alignment")
    yield gate_lines(report.gates)
    if report.origin is not None:
        place = ", ".join(f"{v:.6f}°" for v in report.origin[:2].tolist())
        yield tag("div", muted("origin of east, north, up: ", place, f", {report.origin[2]:.1f} m"), cls="vi-p")
