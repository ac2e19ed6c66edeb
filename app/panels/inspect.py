"""What the estimator knew at this frame: the selection, costs, window, solver, prior, state and times."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from vins_core.report import RIGHT_LOSSES, FrameReport, LandmarkStatus, SolveReport, TrackReport, WindowReport

from .. import views
from ..context import PanelContext
from ..html import (
    DASH,
    Html,
    bar,
    chip,
    empty,
    facts,
    fixed,
    frame_link,
    heading,
    key_cap,
    muted,
    number,
    panel,
    row,
    send,
    stacked_bar,
    strong,
    table,
    table_row,
    tag,
    term,
    text,
    track_link,
    unit,
)
from ..palette import BAD, IMU, OK
from ..style import FACTOR_COLOURS
from ..widgets.prior import marginalization

if TYPE_CHECKING:
    from ..optimum import OptimumView

TITLE = "Inspect"
ICON = "FOCUS_2"
KEY = "inspect"

IMU_PARTS = (("p", "position"), ("R", "rotation"), ("v", "velocity"), ("a", "b_a"), ("g", "b_g"))
_FULL_SIGMA = 5.0
"""Length of a full IMU bar."""


def render(ctx: PanelContext) -> str:
    report = ctx.report
    parts: list[Html] = [_selection(ctx)]
    if report.solve is None and report.window is None:
        parts.append(
            empty(
                f"No solve at this frame: the estimator is {report.status}.",
                "Look at ", strong("Gates"), " for what it waits for, or press ", key_cap("→"), " to step on.",
            )
        )  # fmt: skip
    if report.solve is not None:
        parts.append(_costs(report.solve))
    if report.window is not None:
        parts.append(_window(ctx, report.window, report.solve))
    if report.pose is not None:
        parts.append(_state(report))
    if report.solve is not None:
        parts.append(_solver(ctx, report.solve))
        parts.append(_optimum(ctx))
    if report.marginalization is not None:
        threshold = ctx.run.header.params.marginalization.eigen_threshold
        parts.append(marginalization(report.marginalization, threshold))
    if ctx.ms:
        parts.append(_timings(ctx))
    return panel(KEY, *parts)


# Selection


def _selection(ctx: PanelContext) -> Html:
    match ctx.selection.kind:
        case "track":
            body, clear = _track(ctx, ctx.selection.id), True
        case "frame":
            body, clear = _frame(ctx, ctx.selection.id), True
        case _:
            body, clear = muted("Nothing: click a track in the image or a landmark in 3D."), False
    return text((heading("selection", text((key_cap("Esc"), " clears")) if clear else ""), body))


_STATUS_TONES = {
    LandmarkStatus.CANDIDATE: "",
    LandmarkStatus.TRIANGULATED: "est",
    LandmarkStatus.OUTLIER: "bad",
    LandmarkStatus.MARGINALIZED: "prior",
}


def _track(ctx: PanelContext, id: int) -> Html:
    report = ctx.report
    at, mark = views.track_row(report.tracks, id), views.landmark(report, id)
    chips = [chip("track ", strong(id), tone="sel")]
    if mark is not None:
        chips.append(chip(str(mark.status), tone=_STATUS_TONES[mark.status], tip="landmark.state"))
    if at is not None:
        chips.append(chip("age ", strong(int(report.tracks.age[at])), unit("images"), tip="age"))
    if mark is not None:
        chips.append(chip("seen by ", strong(mark.n_obs), unit("frames"), tip="landmark.obs"))
    parts: list[Html] = [row(*chips)]
    if at is None:
        parts.append(_ending(ctx, id))
    known: list[tuple[Html, Html]] = []
    if at is not None:
        u, v = report.tracks.uv_px[at]
        known.append((tag("span", "pixel"), _pixel(u, v)))
        if len(report.tracks.right_loss):
            known.append(_in_second_camera(report.tracks, at))
    if mark is not None:
        known += _landmark_facts(mark)
    if known:
        parts.append(facts(known))
    seen = views.observations(report, id)
    if seen:
        limit = ctx.run.header.params.window.max_error_px
        mean = text(("mean ", strong(number(mark.error_px)), unit("px460"))) if mark is not None else ""
        parts += [heading("reprojection error per observation", mean, "landmark.error"), _errors(seen, limit)]
    elif mark is not None and report.solve is not None:
        parts.append(muted("It has no residual in this solve."))
    return text(parts)


def _pixel(u: float, v: float) -> Html:
    return text((fixed(float(u), 1), ", ", fixed(float(v), 1), unit("px")))


def _in_second_camera(tracks: TrackReport, at: int) -> tuple[Html, Html]:
    """Where the second camera sees a track, or why it does not."""
    loss, name = int(tracks.right_loss[at]), term("right image", "stereo.match")
    if loss >= len(RIGHT_LOSSES):
        return name, _pixel(*tracks.right_uv_px[at])
    return name, term(str(RIGHT_LOSSES[loss]), f"right.{RIGHT_LOSSES[loss]}")


def _ending(ctx: PanelContext, id: int) -> Html:
    end = views.track_ending(ctx.run, ctx.frame, id)
    if end is None:
        return tag("div", muted("It is not alive in this frame."), cls="vi-p")
    return tag(
        "div", "Lost at frame ", frame_link(end.frame, end.frame), f" at age {end.age}: ",
        term(str(end.reason), f"loss.{end.reason}"), ".", cls="vi-p",
    )  # fmt: skip


def _landmark_facts(mark: views.Landmark) -> list[tuple[Html, Html]]:
    items = [(term("anchor", "landmark.inv_depth"), text(("frame ", frame_link(mark.anchor_frame, mark.anchor_frame))))]
    if math.isfinite(mark.inv_depth):
        near, far = mark.depth_interval
        sigma = f" ± {number(mark.sigma, 2)}" if math.isfinite(mark.sigma) else ""
        interval = f"  ({number(near)} to {number(far)})" if math.isfinite(mark.sigma) else ""
        items += [
            (
                term("inverse depth", "landmark.inv_depth"),
                text((strong(number(mark.inv_depth)), sigma, unit("1/m"))),
            ),
            (term("depth", "landmark.depth"), text((strong(number(mark.depth)), unit("m"), muted(interval)))),
        ]
    if np.isfinite(mark.xyz_w).all():
        xyz = ", ".join(fixed(float(v), 2) for v in mark.xyz_w)
        items.append((term("position", "landmark.xyz"), text((xyz, unit("m")))))
    return items


def _errors(seen: Sequence[views.Observation], limit: float) -> Html:
    """One bar a frame; the dashed line is the limit for their mean."""
    top = max(1.25 * limit, max(o.error_px for o in seen))
    bars = (
        tag(
            "i",
            style=f"height:{max(100 * o.error_px / top, 3):.1f}%;background:{OK if o.error_px <= limit else BAD}",
            title=f"frame {o.frame} (slot {o.slot}): {number(o.error_px)} px",
            onclick=send(k="frame", i=o.frame),
        )
        for o in seen
    )
    return tag("div", *bars, tag("u", style=f"bottom:{100 * limit / top:.1f}%"), cls="vi-obs")


def _frame(ctx: PanelContext, frame: int) -> Html:
    head = chip("frame ", strong(frame), tone="sel")
    window = ctx.report.window
    if window is None or frame not in window.frames:
        return text((row(head), tag("div", muted("It is not in the window here. "), frame_link("Go there", frame))))
    k = int(np.flatnonzero(window.frames == frame)[0])
    chips = [head, chip("slot ", strong(k), tip="slot")]
    if window.keyframe[k]:
        chips.append(chip("keyframe", tone="est", tip="window.kf"))
    vectors = _vectors(window.p_w_b[k], window.q_w_b[k], window.v_w_b[k], window.b_a[k], window.b_g[k])
    return text((row(*chips), vectors))


# Costs


def _costs(solve: SolveReport) -> Html:
    before, after = views.split(solve.before), views.split(solve.after)
    whole = max(solve.before.total, solve.after.total)

    def line(name: str, cost: list[tuple[str, float]]) -> tuple[Html, Html, Html]:
        total = sum(v for _, v in cost)
        return (
            muted(name),
            stacked_bar([(n, v, FACTOR_COLOURS[n]) for n, v in cost], whole),
            tag("span", strong(number(total)), cls="vi-n"),
        )

    legend = (
        tag(
            "span", tag("span", "■ ", style=f"color:{FACTOR_COLOURS[name]}"), term(name, f"cost.{name.lower()}"), " ",
            muted(number(a), " → "), strong(number(b)),
        )
        for (name, a), (_, b) in zip(before, after)
    )  # fmt: skip
    return text(
        (
            heading("cost", f"{solve.n_landmarks} landmarks, {len(solve.visual_ids)} projections", "cost"),
            tag("div", *line("before", before), *line("after", after), cls="vi-costs", data_costs="1"),
            tag("div", *legend, cls="vi-legend"),
        )
    )


# Window


def _window(ctx: PanelContext, window: WindowReport, solve: SolveReport | None) -> Html:
    kinds = ("n", "n", "", "n", "n", "wide", "n")
    names = (
        (term("#", "slot"), "n"),
        ("frame", "n"),
        ("", ""),
        (term("shared", "window.shared"), "n"),
        (term("rms px", "window.rms"), "n"),
        (text((term("IMU residual σ", "window.imu"), _bars_of(tag("span", n[0]) for n in IMU_PARTS))), "wide"),
        ("", "n"),
    )
    rows = []
    for slot, frame in enumerate(window.frames.tolist()):
        sigma = solve.imu_sigma[slot - 1] if solve is not None and 0 < slot <= len(solve.imu_sigma) else None
        worst = float(np.max(sigma)) if sigma is not None else math.nan
        here = frame == ctx.frame or ctx.selection.is_frame(frame)
        cells = (
            slot,
            frame,
            tag("span", "KF", cls="vi-kf") if window.keyframe[slot] else muted("·"),
            int(window.shared[slot]),
            fixed(float(window.error_px[slot]), 2),
            _sigma_bars(sigma) if sigma is not None else None,
            fixed(worst, 1) if sigma is not None else muted(DASH),
        )
        rows.append(
            table_row(
                cells, kinds, click=send(k="frame", i=frame), cls="vi-now" if here else "", title=f"go to {frame}"
            )
        )
    return text((heading("sliding window", "a row goes to its frame"), table(names, rows)))


def _sigma_bars(sigma: np.ndarray) -> Html:
    """One bar for each part of an IMU residual."""
    return _bars_of(
        bar(float(v) / _FULL_SIGMA, IMU, f"{name} {number(float(v))} σ") for (_, name), v in zip(IMU_PARTS, sigma)
    )


def _bars_of(parts: Iterable[Html]) -> Html:
    return tag("div", *parts, cls="vi-sigmas")


# State


def _vectors(p: np.ndarray, q: np.ndarray, v: np.ndarray, b_a: np.ndarray, b_g: np.ndarray) -> Html:
    rows = (
        ("position", "p", p, "m", 3),
        ("attitude", "attitude", np.array(views.yaw_pitch_roll_deg(q)), "deg", 1),
        ("velocity", "v", v, "m/s", 3),
        ("b_a", "b_a", b_a, "m/s^2", 4),
        ("b_g", "b_g", b_g, "rad/s", 5),
    )
    kinds = ("", "n", "n", "n", "n", "")
    body = (
        table_row(
            (
                term(name, tip),
                *(fixed(float(x), places) for x in value),
                muted(DASH) if tip == "attitude" else strong(fixed(float(np.linalg.norm(value)), places)),
                unit(units),
            ),
            kinds,
        )
        for name, tip, value, units, places in rows
    )
    return table((("", ""), ("x, yaw", "n"), ("y, pitch", "n"), ("z, roll", "n"), ("norm", "n"), ("", "")), body)


def _state(report: FrameReport) -> Html:
    pose = report.pose
    assert pose is not None
    return text(
        (
            heading("state of this frame", f"{report.n_imu} IMU samples since the last"),
            _vectors(pose.p_w_b, pose.q_w_b, pose.v_w_b, pose.b_a, pose.b_g),
        )
    )


# Solver


def _solver(ctx: PanelContext, solve: SolveReport) -> Html:
    kinds = ("n", "n", "n", "n", "n", "")
    names = (
        ("#", "n"),
        (term("cost", "iteration.cost"), "n"),
        (term("step", "iteration.step"), "n"),
        (term("gain ratio", "iteration.gain"), "n"),
        (term("radius", "iteration.radius"), "n"),
        ("", ""),
    )
    rows = (
        table_row(
            (k, number(it.cost, 5), number(it.step_norm), number(it.gain_ratio), number(it.damping, 2),
             muted("taken") if it.accepted else tag("span", "rejected", cls="vi-bad")),
            kinds,
            cls="" if it.accepted else "vi-dim",
        )
        for k, it in enumerate(solve.iterations, start=1)
    )  # fmt: skip
    taken = len(solve.iterations)
    settings = ctx.run.header.params.solver
    how = f"{settings.method}, damping {settings.damping}"
    note = text(
        (
            tag("a", how, cls="vi-link", onclick=send(k="knob", key="solver.method")),
            f", {taken} iteration{'' if taken == 1 else 's'}",
        )
    )
    stopped = tag("div", muted("stopped: "), term(solve.termination or "no reason given", "termination"), cls="vi-p")
    return text((heading("solver", note), table(names, rows) if taken else None, stopped))


# Optimum


def _optimum(ctx: PanelContext) -> Html:
    """IPOPT's answer to the same window, when it was asked."""
    seen = ctx.optimum
    ask = tag(
        "button", "Is this the optimum?", cls="vi-button", onclick=send(k="optimum"),
        disabled="disabled" if seen is not None and seen.busy else None,
        title="solve this window again with IPOPT through CasADi, to its end",
    )  # fmt: skip
    head = tag("div", ask, muted("IPOPT is at work …") if seen is not None and seen.busy else None, cls="vi-forkrow")
    if seen is None or seen.busy:
        return head
    if seen.comparison is None:
        return text((head, tag("div", seen.problem, cls="vi-outcome")))
    return text((head, tag("div", *_answer(seen), data_optimum="1")))


def _answer(seen: OptimumView) -> Iterator[Html]:
    found = seen.comparison
    assert found is not None
    near = found.excess < _NEAR
    words = "Yes, within " if near else "Not quite: it costs more by "
    share = f"{number(100 * max(found.excess, 0.0), 2)} %"
    yield tag("div", words, strong(share), ".", cls="vi-outcome " + ("vi-good" if near else "vi-plain"))
    kinds = ("", "n", "n", "n")
    costs = [(name, a, b) for (name, a), (_, b) in zip(views.split(found.cost), views.split(found.optimum))]
    costs.append(("total", found.cost.total, found.optimum.total))
    rows = (table_row((name, number(a, 5), number(b, 5), number(a - b, 2)), kinds) for name, a, b in costs)
    yield table((("cost", ""), ("solver", "n"), ("IPOPT", "n"), ("Δ", "n")), rows)
    blocks = (
        table_row((name, text((strong(number(value, 2)), unit(units))), _where(seen, name, at)), ("", "n", "n"))
        for name, value, units, at in found.largest()
    )
    yield table((("largest difference", ""), ("", "n"), ("at", "n")), blocks)
    how = f"{found.iterations} iterations in {number(found.ms)} ms: {found.termination}"
    yield tag("div", muted(how), cls="vi-small")


_NEAR = 1e-4
"""Share of the cost up to which a solution is called optimal: what eight steps of dogleg are held to (SOLVER.md)."""


def _where(seen: OptimumView, block: str, at: int) -> Html:
    if block == "inverse depth":
        return (
            track_link(f"track {seen.landmarks[at]}", seen.landmarks[at]) if at < len(seen.landmarks) else muted(DASH)
        )
    return frame_link(f"frame {seen.frames[at]}", seen.frames[at]) if at < len(seen.frames) else muted(DASH)


# Time


def _timings(ctx: PanelContext) -> Html:
    total = sum(ctx.ms.values())
    rows = (
        table_row((stage, bar(ms / total if total else 0, "#7C8896"), fixed(ms, 1)), ("", "wide", "n"))
        for stage, ms in sorted(ctx.ms.items(), key=lambda item: -item[1])
    )
    note = text((strong(fixed(total, 1)), unit("ms")))
    return text((heading("time", note, "ms"), table((("stage", ""), ("", "wide"), ("ms", "n")), rows)))
