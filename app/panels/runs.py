"""Runs and forks: what each was changed in and what came of it; and two of them compared."""

from __future__ import annotations

import math
from collections.abc import Iterator

from vins_core.params import DECLARATIONS
from vins_core.record.compare import Comparison, Difference, Metrics, Setting, Side

from ..comparison import OtherRun
from ..context import PanelContext
from ..html import (
    DASH,
    Child,
    Html,
    bar,
    brief,
    empty,
    frame_link,
    heading,
    key_cap,
    muted,
    number,
    panel,
    send,
    strong,
    table,
    table_row,
    tag,
    term,
    text,
    unit,
)
from ..palette import ESTIMATE, FORK
from ..store import RunEntry
from ..widgets.gate import OPS
from ..widgets.knob import figures

TITLE = "Runs"
ICON = "GIT_BRANCH"
KEY = "runs"


def render(ctx: PanelContext) -> str:
    parts: list[Html] = [heading("runs and forks", f"{len(ctx.runs)}")]
    parts += [_entry(ctx, run) for run in ctx.runs]
    if len(ctx.runs) < 2:
        parts.append(
            empty(
                "Nothing to compare with yet.",
                "Change a parameter in ", strong("What-if"), " and press ", key_cap("Ctrl"), " ", key_cap("Enter"),
                ": the run is repeated from this frame with it.",
            )
        )  # fmt: skip
    if ctx.other is not None:
        parts += _comparison(ctx, ctx.other)
    return panel(KEY, *parts)


# The list


def _entry(ctx: PanelContext, run: RunEntry) -> Html:
    is_a, is_b = run.id == ctx.run_id and run.id != "", ctx.other is not None and run.id == ctx.other.id
    side = "A" if is_a else "B" if is_b else ""
    badge = tag("span", side, cls=f"vi-side {'vi-a' if is_a else 'vi-b' if is_b else ''}".strip())
    name = tag(
        "input", type="text", value=run.name, aria_label="name of the run", cls="vi-runname", maxlength="80",
        onchange=f"vi.send({{k:'rename',id:'{_id(run)}',name:this.value}})",
    )  # fmt: skip
    buttons = [] if not run.id else [_show(run, is_a), _compare(run, is_a, is_b), _keep(run)]
    lines = [tag("div", badge, name, *buttons, cls="vi-runhead")]
    if run.growing:
        done = bar(run.share, FORK if run.parent else ESTIMATE)
        stop = tag("button", "stop", cls="vi-button", onclick=send(k="stop", id=run.id)) if run.id else None
        lines.append(tag("div", done, muted(f"frame {run.frames}"), stop, cls="vi-growing"))
    if run.error:
        lines.append(tag("div", run.error, cls="vi-outcome"))
    lines.append(tag("div", *_facts(run), cls="vi-small"))
    depth = " vi-child" if run.parent else ""
    return tag("div", *lines, cls=f"vi-run{depth}", data_run=run.id or "starting")


def _id(run: RunEntry) -> str:
    """Ids are hexadecimal; whatever else a forged header calls itself stays out of scripts."""
    return run.id if run.id.isalnum() else ""


def _show(run: RunEntry, is_a: bool) -> Html:
    return tag(
        "button", "open", cls="vi-button", onclick=send(k="open", id=run.id), disabled="disabled" if is_a else None,
        title="show this run",
    )  # fmt: skip


def _compare(run: RunEntry, is_a: bool, is_b: bool) -> Html:
    return tag(
        "button", "compared" if is_b else "compare", cls="vi-button" + (" vi-go" if is_b else ""),
        onclick=send(k="compare", id="" if is_b else run.id), disabled="disabled" if is_a else None,
        title="compare the run shown with this one, on one clock",
    )  # fmt: skip


def _keep(run: RunEntry) -> Html:
    return tag(
        "button", "★" if run.kept else "☆", cls="vi-button", onclick=send(k="keep", id=run.id, on=not run.kept),
        title="kept; click to let go" if run.kept else "keep: do not remove it when newer runs come",
        aria_label="keep",
    )  # fmt: skip


def _facts(run: RunEntry) -> Iterator[Html]:
    if run.parent is not None:
        yield text(("from ", frame_link(f"frame {run.parent.frame}", run.parent.frame), ": "))
        if not run.parent.changes:
            yield muted("nothing changed")
        for k, (key, value) in enumerate(run.parent.changes.items()):
            yield text((muted(", " if k else "", key, " "), strong(figures(value))))
        yield Html("<br>")
    known: list[Child] = [f"{run.frames} frames, {run.poses} poses"]
    if math.isfinite(run.ate_m):
        known += [", ATE ", strong(number(100 * run.ate_m)), " cm"]
    if math.isfinite(run.cost):
        known += [", mean cost ", strong(number(run.cost))]
    if math.isfinite(run.ms):
        known += [", ", strong(number(run.ms, 2)), " ms a frame"]
    yield muted(*known)


# Two of them


def _comparison(ctx: PanelContext, other: OtherRun) -> Iterator[Html]:
    legend = text((tag("span", "A", style=f"color:{ESTIMATE}"), " against ", tag("span", f"B, {other.name}",
                   style=f"color:{FORK}")))  # fmt: skip
    yield heading("compared", legend)
    if other.problem:
        yield tag("div", other.problem, cls="vi-outcome")
        return
    found = other.comparison
    if found is None:
        yield muted("comparing …")
        return
    yield _first_difference(found, other.growing)
    yield _metrics(found)
    yield from _settings("parameters that differ", found.parameters)
    yield from _settings("calibration that differs", found.calibration)
    yield from _settings("input that differs", found.input)
    yield from _settings("made with", found.environment)


def _first_difference(found: Comparison, growing: bool) -> Html:
    decision, numbers = found.first_difference, found.first_number
    if decision is None:
        words = f"Every decision of {found.frames_compared} frames is the same{' so far' if growing else ''}."
        first = "" if growing else "none"
        if numbers is None:
            return tag("div", words, " So is every number.", cls="vi-outcome vi-good", data_first=first)
        where = text(("Numbers differ from frame ", frame_link(numbers.frame, numbers.frame), f" on ({numbers.path})."))
        return tag("div", words, " ", where, cls="vi-outcome vi-plain", data_first=first)
    go = tag(
        "button", text(("go to frame ", strong(decision.frame))), cls="vi-button vi-go",
        onclick=send(k="frame", i=decision.frame), data_first=str(decision.frame),
    )  # fmt: skip
    title = text(
        (muted("first decision that differs: "), strong(decision.gate.replace("_", " ")), f", {decision.stage}")
    )
    rows = [tag("div", title), *_sides(decision), tag("div", go, " ", _knob(decision), cls="vi-runhead")]
    if numbers is not None:
        rows.append(
            tag("div", muted("numbers differ from frame "), frame_link(numbers.frame, numbers.frame),
                muted(f": {numbers.path}"), cls="vi-small")
        )  # fmt: skip
    return tag("div", *rows, cls="vi-outcome vi-forked")


def _sides(decision: Difference) -> Iterator[Html]:
    for label, colour, side in (("A", ESTIMATE, decision.first), ("B", FORK, decision.second)):
        yield tag("div", tag("b", label, style=f"color:{colour}"), " ", _said(side, decision.unit))


def _said(side: Side, units: str) -> Html:
    if side.limit is None or side.value is None:
        only = muted(f", {len(side.ids)} of them only here") if side.ids and side.value is not None else None
        return text((strong(side.outcome), only))
    op = OPS.get(side.op, side.op)
    return text(
        (strong(number(side.value, 4)), f" {op} {brief(side.limit, 4)}", unit(units), muted(f": {side.outcome}"))
    )


def _knob(decision: Difference) -> Html:
    if decision.knob not in DECLARATIONS:
        return muted(decision.knob)
    return tag("a", decision.knob, cls="vi-link", onclick=send(k="knob", key=decision.knob))


_KINDS = ("", "n", "n", "n")


def _head(name: str) -> list[tuple[Child, str]]:
    sides = ((tag("span", s, style=f"color:{c}"), "n") for s, c in (("A", ESTIMATE), ("B", FORK)))
    return [(name, ""), *sides, ("Δ", "n")]


def _metrics(found: Comparison) -> Html:
    a, b = found.metrics
    rows = [_metric(name, x, y, tip) for name, tip, x, y in _measures(a, b) if x is not None or y is not None]
    return text((heading("metrics", f"{found.frames_compared} frames on one clock"), table(_head(""), rows)))


def _measures(a: Metrics, b: Metrics) -> Iterator[tuple[Child, str, float | None, float | None]]:
    """(name, tip, A's value, B's value)."""

    def centimetres(value: float | None) -> float | None:
        return None if value is None else 100 * value

    common = [m.accuracy_common.ate_rmse_m if m.accuracy_common else None for m in (a, b)]
    own = [m.accuracy.ate_rmse_m if m.accuracy else None for m in (a, b)]
    costs = [
        (m.cost.total, m.cost.visual, m.cost.imu, m.cost.prior, m.cost.depth or None) if m.cost else (None,) * 5
        for m in (a, b)
    ]
    yield text(("ATE, shared poses", unit("cm"))), "ate", centimetres(common[0]), centimetres(common[1])
    yield text(("ATE, own poses", unit("cm"))), "ate", centimetres(own[0]), centimetres(own[1])
    names = ("mean cost", "visual", "IMU", "prior", "depth")
    yield from zip(names, ("cost", "cost.visual", "cost.imu", "cost.prior", "cost.depth"), *costs)
    yield "poses", "", a.poses, b.poses
    yield "keyframes", "keyframe", a.keyframes, b.keyframes
    yield "landmarks a frame", "", a.landmarks, b.landmarks
    yield "initialised at frame", "attempts", a.initialised_frame, b.initialised_frame
    yield "restarts", "", a.restarts, b.restarts
    yield text(("time of a frame", unit("ms"))), "ms", a.ms, b.ms


def _metric(name: Child, a: float | None, b: float | None, tip: str) -> Html:
    label = term(name, tip) if tip else name
    return table_row((label, number(a), strong(number(b)), _change(a, b)), _KINDS)


def _change(a: float | None, b: float | None) -> Html:
    if a is None or b is None or not (math.isfinite(a) and math.isfinite(b)):
        return muted(DASH)
    if a == b:
        return muted("=")
    return text((("+" if b > a else ""), number(b - a)))


def _settings(title: str, settings: tuple[Setting, ...]) -> Iterator[Html]:
    if not settings:
        return
    rows = (table_row((_key(s.key), _value(s.first), strong(_value(s.second))), ("", "n", "n")) for s in settings)
    yield heading(title)
    yield table(_head("")[:3], rows)


def _key(key: str) -> Html:
    if key in DECLARATIONS:
        return tag("a", key, cls="vi-link", onclick=send(k="knob", key=key), data_setting=key)
    return text(key)


def _value(value: object) -> str:
    said = DASH if value is None else figures(value)
    return said if len(said) <= 34 else "…" + said[-33:]
