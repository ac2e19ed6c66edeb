"""Calibration while running: time offset and extrinsics over the run with three sigma, and what holds them."""

from __future__ import annotations

import numpy as np

from vins_core.report import CalibrationReport, all_pass

from ..calibration import CalibrationSeries, calibration_series, of_frame
from ..context import PanelContext, RunView
from ..html import (
    Html,
    chip,
    empty,
    fixed,
    heading,
    muted,
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
from ..palette import CANDIDATE, ESTIMATE, MUTED
from ..widgets.gate import gate_list
from ..widgets.plot import WIDTH, area, line, stretches, svg

TITLE = "Calibration"
ICON = "RULER_MEASURE"
KEY = "calibration"

TALL, LOW = 54, 38
"""Heights of the plots of the time offset, and of one axis of an extrinsic, px."""
BAND = "#1D3A4C"
AXES = "xyz"


def exists(run: RunView) -> bool:
    return bool(calibration_series(run).known.any())


# Over the run


def backdrop(ctx: PanelContext) -> str:
    series, cameras = calibration_series(ctx.run), ctx.run.header.calibration.cameras
    parts: list[Html] = []
    if series.estimates_td:
        parts += _offset(ctx, series)
    if series.estimates_extrinsics:
        for k, camera in enumerate(cameras):
            held = ~series.extrinsics_free & series.known
            turn, turn_sigma = (np.degrees(v[:, k]) for v in (series.turn_rad, series.turn_sigma_rad))
            shift, shift_sigma = (100 * v[:, k] for v in (series.shift_m, series.shift_sigma_m))
            note = text(("±3σ from the given, ", unit("deg")))
            parts += _axes(f"{camera.name} turned by", "calibration.turn", note, turn, turn_sigma, held, "deg")
            note = text("±3σ from the given, cm")
            parts += _axes(f"{camera.name} moved by", "calibration.shift", note, shift, shift_sigma, held, "cm")
    return str(tag("div", *parts, cls="vi"))


def _offset(ctx: PanelContext, series: CalibrationSeries) -> list[Html]:
    """Time offset in ms; the dashed line is the given one."""
    given = 1e3 * ctx.run.header.calibration.td_of(0)
    values, sigma = 1e3 * series.td_s, 1e3 * series.td_sigma_s
    low, high = _ends(values, sigma, given)
    held = ~series.td_free & np.isfinite(values)
    ends = tag("div", *(tag("span", fixed(end, 1), unit("ms")) for end in (high, low)), cls="vi-ends")
    lane = _lane(values, sigma, held, (low, high), given, TALL, "td")
    return [
        heading("time offset", "±3σ, dashed: as given", "calibration.td"),
        tag("div", lane, ends, cls="vi-yaw"),
    ]


def _axes(
    name: str, tip: str, note: Html, values: np.ndarray, sigma: np.ndarray, held: np.ndarray, unit_name: str
) -> list[Html]:
    """Three axes side by side on one scale around the given value."""
    reach = max(abs(end) for axis in range(3) for end in _ends(values[:, axis], sigma[:, axis], 0.0))
    lanes = (
        tag(
            "div",
            _lane(values[:, axis], sigma[:, axis], held, (-reach, reach), 0.0, LOW, f"{name} {AXES[axis]}"),
            tag("span", AXES[axis], cls="vi-axis"),
        )
        for axis in range(3)
    )
    ends = tag("div", *(tag("span", fixed(end, 1), unit(unit_name)) for end in (reach, -reach)), cls="vi-ends")
    return [heading(name, note, tip), tag("div", *lanes, ends, cls="vi-triple")]


def _lane(
    values: np.ndarray,
    sigma: np.ndarray,
    held: np.ndarray,
    ends: tuple[float, float],
    given: float,
    height: int,
    name: str,
) -> Html:
    """A curve with its band; grey where it is held, dashed where the calibration had it."""
    low, span = ends[0], ends[1] - ends[0]
    below, above = (np.clip(values + side * 3 * sigma - low, 0, span) for side in (-1, 1))
    y = height - (given - low) / span * (height - 2) - 1
    rule = Html(
        f'<path d="M0,{y:.1f}H{WIDTH}" stroke="{MUTED}" stroke-opacity=".6" stroke-dasharray="4 4" '
        'vector-effect="non-scaling-stroke"/>'
    )
    drawing = area(below, above, span, height, BAND), rule, line(values - low, span, height, ESTIMATE)
    return tag(
        "div",
        svg(height, stretches(held, height, CANDIDATE, 0.35, "held"), *drawing),
        tag("i", cls="vi-head"),
        cls="vi-lane vi-sunken",
        style=f"height:{height}px",
        onpointerdown="vi.scrub(event,this)",
        onpointermove="vi.scrub(event,this)",
        data_plot=name,
    )


def _ends(values: np.ndarray, sigma: np.ndarray, given: float) -> tuple[float, float]:
    """An axis on which the curve, the given value and the usual band have their place."""
    usual = 3 * float(np.median(sigma[np.isfinite(sigma)])) if np.isfinite(sigma).any() else 0.0
    seen = values[np.isfinite(values)] if np.isfinite(values).any() else np.array([given])
    low, high = min(seen.min() - usual, given), max(seen.max() + usual, given)
    room = 0.08 * (high - low) or 1.0
    return float(low - room), float(high + room)


# At one frame


def render(ctx: PanelContext) -> str:
    series, report = calibration_series(ctx.run), of_frame(ctx.run, ctx.frame)
    if report is None:
        why = "The calibration is estimated once the window is initialised." if series.known.any() else ""
        return panel(KEY, empty(why or "This run takes its calibration as given."), _readouts(ctx))
    return panel(KEY, _values(ctx, report), _readouts(ctx), *_gates(report))


def _values(ctx: PanelContext, report: CalibrationReport) -> Html:
    """What the frame knows, three sigma beside it."""
    series, k = calibration_series(ctx.run), ctx.frame
    parts: list[Html] = []
    if report.td_gates:
        found = _cell(1e3 * report.td_s, 1e3 * report.td_sigma_s)
        parts.append(row(term("td", "calibration.td"), strong(found), unit("ms")))
    rows = []
    for camera, given in enumerate(ctx.run.header.calibration.cameras if report.extrinsic_gates else ()):
        turn, turn_sigma = (np.degrees(v[k, camera]) for v in (series.turn_rad, series.turn_sigma_rad))
        shift, shift_sigma = (100 * v[k, camera] for v in (series.shift_m, series.shift_sigma_m))
        for name, tip, value, sigma, of in (
            ("turned", "calibration.turn", turn, turn_sigma, "deg"),
            ("moved", "calibration.shift", shift, shift_sigma, "cm"),
        ):
            label = text((term(f"{given.name} {name}", tip), " ", unit(of)))
            rows.append(table_row((label, *(_cell(v, s) for v, s in zip(value, sigma))), ("", "n", "n", "n")))
    if rows:
        parts.append(table((("from the given, ±3σ", ""), *((axis, "n") for axis in AXES)), rows))
    return tag("div", *parts, data_calibration=ctx.frame)


def _cell(value: float, sigma: float) -> Html:
    if not np.isfinite(sigma):
        return text(fixed(float(value), 2))
    return text((fixed(float(value), 2), muted(f" ±{fixed(3 * float(sigma), 2)}")))


def _readouts(ctx: PanelContext) -> Html | None:
    """Cameras whose rows are read one after another."""
    undone = ctx.run.header.params.online.rolling_shutter
    chips = [
        chip(
            f"{camera.name}: {1e3 * camera.readout_s:.3g} ms rolling shutter",
            ", undone" if undone else ", not minded",
            tone="est" if undone else "",
            tip="calibration.readout",
        )
        for camera in ctx.run.header.calibration.cameras
        if camera.readout_s
    ]
    return row(*chips) if chips else None


def _gates(report: CalibrationReport) -> list[Html]:
    parts = []
    for name, gates in (("time offset", report.td_gates), ("extrinsics", report.extrinsic_gates)):
        if gates:
            free = all_pass(gates)
            state = chip("free" if free else "held", tone="ok" if free else "", tip="calibration.held")
            parts += [heading(name, state), gate_list(gates)]
    return parts
