"""Every comparison that decided something at this frame, and where to look when nothing was decided here.

While the estimator is not initialised the question is why not, so that comes first, with what failed on top.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from vins_core.report import FrameReport, InitReport, InitStage, KeyframeReport, Status

from .. import views
from ..context import PanelContext
from ..html import (
    Html,
    chip,
    empty,
    frame_link,
    heading,
    key_cap,
    muted,
    number,
    panel,
    row,
    strong,
    tag,
    term,
    text,
    unit,
)
from ..series import Event
from ..tooltips import TIPS
from ..widgets.gate import FAILED, PASSED, UNKNOWN, gate_list
from ..widgets.marks import loss_mark

TITLE = "Gates"
ICON = "CHECKLIST"
KEY = "gates"

STAGES = (
    "excitation",
    "relative pose",
    "structure",
    "frames between",
    "gyroscope bias",
    "alignment",
    "gravity",
    "refinement",
)
"""Stages of an attempt in order, for lamps of stages that an attempt did not reach."""
SOMETIMES = ("extrinsic rotation",)
"""Stages that come first in runs which need them."""
ALL = (*SOMETIMES, *STAGES)


def render(ctx: PanelContext) -> str:
    report = ctx.report
    waiting = report.status is not Status.TRACKING or report.initialization is not None
    sections = [_keyframe(report), _tracks(report), _health(ctx)]
    sections.insert(0 if waiting else len(sections), _initialization(ctx))
    return panel(KEY, *sections)


def _outcome(*words: str | Html, tone: str = "") -> Html:
    return tag("div", *words, cls=f"vi-outcome {tone}".strip())


# Initialisation


def _initialization(ctx: PanelContext) -> Html:
    report, events = ctx.report, ctx.run.series.events
    if report.initialization is not None:
        note = "succeeded here" if report.initialization.succeeded else "failed here"
        return text((heading("initialisation", note, "attempts"), _attempt(report.initialization)))
    title = heading("initialisation", "", "attempts")
    if report.status is Status.TRACKING:
        done = views.latest(events, ctx.frame, "initialized")
        if done is None:
            return text((title, muted("The run does not say when it was initialised.")))
        return text((title, _outcome("Initialised at frame ", frame_link(done.frame, done.frame), ".", tone="vi-good")))
    return text((title, _why_not_yet(ctx, views.latest(events, ctx.frame, "attempt"))))


def _why_not_yet(ctx: PanelContext, last: Event | None) -> Html:
    """The estimator has no state at this frame and did not try to get one here."""
    if last is None:
        coming = views.nearest(ctx.run.series.events, ctx.frame, "attempt", "initialized")
        size = ctx.run.header.params.window.size + 1
        where = (
            (" The first attempt is at frame ", frame_link(coming.frame, coming.frame), ".")
            if coming is not None
            else (" No attempt was made yet; press ", key_cap("→"), " to step.")
        )
        return _outcome(f"Not tried yet: the window must hold {size} frames first.", *where, tone="vi-plain")
    attempt = ctx.run.report(last.frame).initialization
    said = _outcome(
        "Not tried at this frame. The last attempt, at frame ", frame_link(last.frame, last.frame), ", failed:",
        tone="vi-plain",
    )  # fmt: skip
    return text((said, _attempt(attempt) if attempt is not None else None))


def _attempt(attempt: InitReport) -> Html:
    """Lamps of all stages, then the stages: a failed one first, the others in order."""
    ordered = sorted(attempt.stages, key=lambda s: s.passed)
    parts = [_lamps(attempt)]
    if attempt.succeeded:
        values = [chip("reference slot ", strong(attempt.reference_slot), tip="reference_slot")]
        if attempt.scale is not None:
            values.append(chip("scale ", strong(number(attempt.scale)), tip="scale"))
        if attempt.gravity is not None:
            g = ", ".join(number(float(v)) for v in attempt.gravity)
            values.append(chip("gravity ", strong(g), unit("m/s^2"), tip="gravity"))
        if attempt.b_g is not None:
            b = ", ".join(number(float(v), 2) for v in attempt.b_g)
            values.append(chip("b_g ", strong(b), unit("rad/s"), tip="b_g"))
        parts.append(row(*values))
    return text((*parts, *(_stage(stage) for stage in ordered)))


def _lamps(attempt: InitReport) -> Html:
    """One lamp a stage; stages that were not reached stay dark."""
    done = {stage.name: stage for stage in attempt.stages}
    names = [*(name for name in done if name in SOMETIMES), *STAGES, *(name for name in done if name not in ALL)]
    lamps = []
    for name in names:
        stage = done.get(name)
        icon = UNKNOWN if stage is None else PASSED if stage.passed else FAILED
        tone = "" if stage is None else "vi-ok" if stage.passed else "vi-bad"
        lamps.append(
            tag(
                "div",
                icon,
                tag("span", name),
                cls=f"vi-lamp {tone}".strip(),
                data_tip=_stage_tip(name),
                data_lamp=name,
            )
        )
    return tag("div", *lamps, cls="vi-lamps")


def _stage_tip(name: str) -> str:
    key = f"stage.{name}"
    return key if key in TIPS else ""


def _stage(stage: InitStage) -> Html:
    values = (muted(f"{label} ", strong(value), unit(units)) for label, value, units in _values(stage.values))
    head = tag("div", strong(term(stage.name, _stage_tip(stage.name))), *values, cls="vi-stage", data_stage=stage.name)
    outcome = None if stage.passed else _outcome(stage.outcome)
    return text((head, outcome, gate_list(stage.gates) if stage.gates else None))


_SUFFIXES = {"deg": "deg", "px": "px460", "m": "m", "s": "s", "ms": "ms"}


def _values(values: Mapping[str, float]) -> Iterator[tuple[str, str, str]]:
    """(label, figures, unit) of what a stage found: `turned_deg` loses its suffix, b_g_x, b_g_y, b_g_z are one."""
    for name, value in values.items():
        stem, _, end = name.rpartition("_")
        axes = [f"{stem}_{axis}" for axis in "xyz"]
        if end in ("x", "y", "z") and stem and all(axis in values for axis in axes):
            if end == "x":
                name, _, units = stem.rpartition("_")
                known = bool(name) and units in _SUFFIXES
                label, units = (name.replace("_", " "), _SUFFIXES[units]) if known else (stem, "")
                yield label, ", ".join(number(values[axis]) for axis in axes), units
        elif stem and end in _SUFFIXES:
            yield stem.replace("_", " "), number(value), _SUFFIXES[end]
        else:
            yield name.replace("_", " "), number(value), ""


# Every frame


def _keyframe(report: FrameReport) -> Html:
    decision: KeyframeReport | None = report.keyframe
    title = heading("keyframe", f"about frame {report.frame - 1}" if report.frame else "", "keyframe")
    if decision is None:
        return text((title, muted("Decided from the second frame on, about the frame before.")))
    words = "Keyframe" if decision.is_keyframe else "No keyframe"
    facts = row(
        chip("uncompensated ", strong(number(decision.parallax_raw_px)), unit("px460"), tip="parallax_raw"),
        chip("long tracks ", strong(decision.long_tracks), tip="long_tracks"),
        chip("new ", strong(decision.new_tracks), tip="new_tracks"),
    )
    return text(
        (
            title,
            _outcome(strong(words), ": ", decision.reason, tone="vi-kept" if decision.is_keyframe else "vi-plain"),
            gate_list(decision.gates, switch=True) if decision.gates else None,
            facts,
        )
    )


def _tracks(report: FrameReport) -> Html:
    tracks = report.tracks
    counts = (
        chip(loss_mark(reason), str(reason), strong(n), tip=f"loss.{reason}") for reason, n in views.lost_counts(tracks)
    )
    note = f"{len(tracks.ids)} alive, {tracks.n_new} new, {len(tracks.lost_ids)} lost"
    return text(
        (
            heading("tracks", note, "tracks.lost"),
            gate_list(tracks.gates) if tracks.gates else None,
            row(*counts) if len(tracks.lost_ids) else muted("No track was lost since the previous frame."),
        )
    )


def _health(ctx: PanelContext) -> Html:
    health = ctx.report.health
    note = "" if health is None else "healthy" if not health.outcome else "restarted"
    title = heading("health", note)
    if health is not None:
        outcome = _outcome(health.outcome) if health.outcome else None
        motion = _outcome(health.degeneracy) if health.degeneracy else None
        return text((title, outcome, motion, gate_list(health.gates, failed_first=True)))
    restart = views.latest(ctx.run.series.events, ctx.frame, "restart")
    if restart is not None:
        return text(
            (title, _outcome("Restarted at frame ", frame_link(restart.frame, restart.frame), f": {restart.text}"))
        )
    first = views.nearest(ctx.run.series.events, ctx.frame, "initialized")
    if first is None:
        return text((title, empty("Judged after each solve; nothing has been solved in this run yet.")))
    return text(
        (title, muted("Judged after each solve; the first is at frame "), frame_link(first.frame, first.frame), ".")
    )
