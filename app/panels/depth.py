"""The depth camera: its image over the camera's, and what it measures beside what the window has estimated.

A filled mark has a depth, a cross has none, and its colour and title say why.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vins_core.frontend.depth import gates
from vins_core.report import DEPTH_LOSSES, DEPTH_USES, DepthLoss, DepthReport, DepthUse, Gate, TrackReport

from ..context import PanelContext, RunView
from ..html import (
    Html,
    chip,
    empty,
    fixed,
    heading,
    key_cap,
    muted,
    number,
    panel,
    row,
    strong,
    swatch,
    table,
    table_row,
    tag,
    term,
    text,
    track_link,
    unit,
)
from ..palette import BAD, CANDIDATE, ESTIMATE, IMU, MUTED, OK, PRIOR, SELECTION, UNTRACKED
from ..widgets.depth_plot import histogram, scatter
from ..widgets.gate import gate_list

TITLE = "Depth"
ICON = "STACK_2"
KEY = "depth"

LOSS_COLOURS = {
    DepthLoss.NO_IMAGE: MUTED,
    DepthLoss.MISSING: CANDIDATE,
    DepthLoss.NEAR: UNTRACKED,
    DepthLoss.FAR: IMU,
    DepthLoss.EDGE: BAD,
}
USE_COLOURS = {
    DepthUse.FACTOR: ESTIMATE,
    DepthUse.HELD: PRIOR,
    DepthUse.WAITING: CANDIDATE,
    DepthUse.UNSTEADY: IMU,
    DepthUse.GATED: BAD,
}
KEPT = 255
_MARKS_PER_WIDTH = 420
_CROSS = "M-4,-4L4,4M4,-4L-4,4"


def exists(run: RunView) -> bool:
    return run.header.mode == "rgbd_imu"


def render(ctx: PanelContext) -> str:
    tracks, found = ctx.report.tracks, ctx.report.depth
    if not len(tracks.depth_loss):
        return panel(KEY, empty("This frame has no track to measure.", "Press ", key_cap("→"), " to step."))
    parts = [_picture(ctx), _legend(tracks), *_selected(ctx)]
    if found is None:
        parts.append(empty("The window is not solved yet.", "Estimated depths come with the first pose."))
        return panel(KEY, *parts)
    return panel(KEY, *parts, *_against(ctx, found), *_uses(ctx, found))


# The image


def _picture(ctx: PanelContext) -> Html:
    image = tag("img", draggable="false", alt="", src=ctx.image_uri) if ctx.image_uri else None
    over = (
        tag("img", draggable="false", alt="", src=ctx.depth_uri, style="opacity:.62", data_depth_image="1")
        if ctx.depth_uri
        else None
    )
    note = None if ctx.image_uri else tag("div", ctx.image_note or "This frame has no image.", cls="vi-noimg")
    scale = f"--u:{ctx.width / _MARKS_PER_WIDTH:.3f}"
    svg = Html(f'<svg viewBox="0 0 {ctx.width} {ctx.height}" style="{scale}">{_marks(ctx)}</svg>')
    return tag(
        "div",
        tag("div", image, over, svg, cls="vi-zoom"),
        note,
        cls="vi-img",
        style=f"aspect-ratio:{ctx.width}/{ctx.height}",
        onwheel="vi.wheel(event,this)",
        onpointermove="vi.pan(event)",
        ondblclick="vi.reset()",
    )


def _marks(ctx: PanelContext) -> str:
    """The selected track last, above all others."""
    tracks = ctx.report.tracks
    marks, selected = [], ""
    rows = zip(tracks.ids.tolist(), np.round(tracks.uv_px, 1).tolist(), tracks.depth_m.tolist(), tracks.depth_loss)
    for id, (u, v), depth_m, loss in rows:
        click = f"""onclick="vi.send({{k:'pick',t:'track',i:{id}}})" data-measured="{id}\""""
        said = f"{depth_m:.2f} m" if loss == KEPT else str(DEPTH_LOSSES[loss])
        title = f"<title>track {id} · {said}</title>"
        if ctx.selection.is_track(id):
            selected = f'<circle class="p" cx="{u}" cy="{v}" {click}>{title}</circle>'
        elif loss == KEPT:
            marks.append(f'<circle cx="{u}" cy="{v}" stroke="#000" fill="{OK}" {click}>{title}</circle>')
        else:
            colour = LOSS_COLOURS[DEPTH_LOSSES[loss]]
            marks.append(
                f'<g class="x" transform="translate({u},{v})" {click}><path class="h" d="{_CROSS}"/>'
                f'<path d="{_CROSS}" stroke="{colour}"/>{title}</g>'
            )
    return "".join(marks) + selected


def _legend(tracks: TrackReport) -> Html:
    n = int((tracks.depth_loss == KEPT).sum())
    items = [tag("span", swatch(OK, "●"), " ", term("measured", "depth"), " ", strong(n), data_measured_count=n)]
    for index, loss in enumerate(DEPTH_LOSSES):
        if count := int((tracks.depth_loss == index).sum()):
            mark, name = swatch(LOSS_COLOURS[loss], "×"), term(str(loss), f"depth.loss.{loss}")
            items.append(tag("span", mark, " ", name, " ", strong(count), data_depth_loss=str(loss)))
    scale = tag("span", muted("far "), tag("i", cls="vi-magma"), muted(" near"), data_tip="depth.image")
    return text((tag("div", *items, cls="vi-legend"), tag("div", scale, _HINT, cls="vi-legend")))


_HINT = muted("wheel zooms · click a track for its gates")


# The selected track


def _selected(ctx: PanelContext) -> Iterator[Html]:
    tracks = ctx.report.tracks
    rows = np.flatnonzero(tracks.ids == ctx.selection.id)
    if ctx.selection.kind != "track" or not len(rows):
        return
    at, params = int(rows[0]), ctx.run.header.params_at(ctx.frame)
    sensor = ctx.run.header.calibration.cameras[0].depth
    asked = [] if sensor is None else list(gates(params.frontend, sensor, tracks, at))
    found = ctx.report.depth
    note: Html | str = "no depth" if tracks.depth_loss[at] != KEPT else ""
    if found is not None and ctx.selection.id in found.ids:
        k = int(np.flatnonzero(found.ids == ctx.selection.id)[0])
        use = DEPTH_USES[found.use[k]]
        note = text((swatch(USE_COLOURS[use]), " ", term(str(use), f"depth.use.{use}")))
        asked += _at_anchor(found, k, params.depth.max_chi2, params.depth.max_disagreement)
    yield heading(text(("track ", strong(ctx.selection.id))), note, "depth")
    yield gate_list(asked)


def _at_anchor(found: DepthReport, k: int, max_chi2: float, max_disagreement: float) -> Iterator[Gate]:
    if not np.isnan(found.disagreement[k]):
        apart = float(found.disagreement[k])
        yield Gate("frames disagree by", apart, "<=", max_disagreement, "depth.max_disagreement", "sigma")
    ratio = float(found.measured_m[k] / found.estimated_m[k])
    chi2 = None if np.isnan(ratio) else ((ratio - 1.0) / found.sigma) ** 2
    yield Gate("chi-square at the anchor", chi2, "<=", max_chi2, "depth.max_chi2")


# Measured against estimated


def _against(ctx: PanelContext, found: DepthReport) -> Iterator[Html]:
    known = np.isfinite(found.seen_estimated_m) & np.isfinite(found.seen_m)
    yield heading("measured against estimated", f"{known.sum()} tracks of this frame", "depth.scatter")
    if not known.any():
        yield empty("No measured track has a landmark yet.", "Step on: they come with the next frames.")
        return
    error = found.seen_error_sigma[known]
    ids, use = found.seen_ids[known], dict(zip(found.ids.tolist(), found.use.tolist()))
    uses = [DEPTH_USES[use[i]] if i in use else None for i in ids.tolist()]
    colours = [USE_COLOURS[u] if u else CANDIDATE for u in uses]
    titles = [
        f"track {i} · measured {z:.3f} m · estimated {e:.3f} m · {s:+.1f} σ" + (f" · {u}" if u else "")
        for i, z, e, s, u in zip(ids, found.seen_m[known], found.seen_estimated_m[known], error, uses)
    ]
    picked = ctx.selection.id if ctx.selection.kind == "track" else -1
    yield scatter(ids, found.seen_m[known], found.seen_estimated_m[known], found.sigma, colours, titles, picked)
    median, spread = (strong(fixed(value, 2)) for value in (float(np.median(error)), _spread(error)))
    yield heading("relative error", text(("median ", median, " · spread ", spread, " σ")), "depth.error")
    yield histogram(error)


def _spread(values: np.ndarray) -> float:
    """Standard deviation by the median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


# What the solve made of them


def _uses(ctx: PanelContext, found: DepthReport) -> Iterator[Html]:
    params = ctx.run.header.params_at(ctx.frame).depth
    yield heading("in the solve", text(("variant ", strong(params.variant))), "depth.variant")
    chips = [
        chip(swatch(USE_COLOURS[use]), f" {use} ", strong(count), tip=f"depth.use.{use}")
        for index, use in enumerate(DEPTH_USES)
        if (count := int((found.use == index).sum()))
    ]
    if ctx.report.solve is not None and ctx.report.solve.after.depth > 0:
        chips.append(chip("cost ", strong(number(ctx.report.solve.after.depth)), tip="cost.depth"))
    yield row(*chips)
    yield gate_list(found.gates)
    error = np.abs(found.error_sigma)
    worst = np.argsort(np.where(np.isnan(error), -1.0, error))[::-1][:6]
    worst = worst[~np.isnan(error[worst])]
    if not len(worst):
        return
    yield heading("farthest from the estimate", "at the anchor", "depth.anchor")
    head = (("track", ""), ("measured", "n"), ("estimated", "n"), ("error", "n"), ("", ""))
    kinds = [kind for _, kind in head]
    yield table(head, (_worst(ctx, found, k, kinds) for k in worst.tolist()))


def _worst(ctx: PanelContext, found: DepthReport, k: int, kinds: list[str]) -> Html:
    id, use = int(found.ids[k]), DEPTH_USES[found.use[k]]
    cells = (
        track_link(id, id),
        text((fixed(float(found.measured_m[k]), 2), unit("m"))),
        text((fixed(float(found.estimated_m[k]), 2), unit("m"))),
        text((fixed(float(found.error_sigma[k]), 1), unit("σ"))),
        text((swatch(USE_COLOURS[use]), " ", str(use))),
    )
    picked = tag("span", cells[0], style=f"color:{SELECTION}") if ctx.selection.is_track(id) else cells[0]
    return table_row((picked, *cells[1:]), kinds, title=str(use))
