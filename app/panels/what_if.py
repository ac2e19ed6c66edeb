"""What other parameters would have done: to every gate of the run, to this window, and from here to the end.

Three depths, each labelled with what it rests on: gates judged again from the record, this window solved again, and a
fork, which alone knows what would have become of the run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from vins_core import params as parameters
from vins_core.params import DECLARATIONS
from vins_core.record.compare import Side
from vins_core.record.reevaluate import Derived, Flips, Reevaluation
from vins_core.report import FrameReport
from vins_core.whatif import Effect, WhatIf

from .. import views
from ..context import PanelContext
from ..experiment import ExperimentView
from ..html import (
    Child,
    Html,
    brief,
    empty,
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
    unit,
)
from ..palette import BAD, ESTIMATE, FORK, OK
from ..prior import FREE
from ..style import FACTOR_COLOURS
from ..widgets.gate import OPS
from ..widgets.knob import figures, knobs
from ..widgets.plot import svg, ticks

TITLE = "What-if"
ICON = "FLASK"
KEY = "what_if"

SPANS = (("to the end", 0), ("30 frames", 30), ("60 frames", 60), ("150 frames", 150), ("300 frames", 300))


def backdrop_of(ctx: PanelContext) -> object:
    """The knobs are drawn again only for changes that the page did not make itself, so that none is lost mid-drag."""
    seen = ctx.experiment
    return (id(ctx.run), seen.revision) if seen else None


def backdrop(ctx: PanelContext) -> str:
    seen = ctx.experiment
    if seen is None:
        return tag("div", cls="vi")
    search = tag(
        "input", type="search", placeholder="find a parameter", aria_label="find a parameter", oninput="vi.find(this)"
    )
    load = tag(
        "label", "load", tag("input", type="file", accept=".yaml,.yml", onchange="vi.load(this)"), cls="vi-button",
        title="changed parameters from a YAML file",
    )  # fmt: skip
    save = _button("save", send(k="save"), title="changed parameters as a YAML file, for --params")
    head = tag("div", search, load, save, _button("reset all", send(k="reset")), cls="vi-find")
    return tag("div", head, knobs(seen.params, seen.reference, ("window",)), cls="vi")


def render(ctx: PanelContext) -> str:
    seen = ctx.experiment
    if seen is None:
        return panel(KEY, empty("There is no run to experiment with yet."))
    if not seen.changes:
        return panel(
            KEY,
            _fork_row(ctx, seen),
            empty(
                "Every parameter stands as in this run.",
                "Move one: its gates are judged again over the whole run, and this window is solved again. ",
                key_cap("Ctrl"), " ", key_cap("Enter"), " repeats the run from here with it.",
            ),
        )  # fmt: skip
    return panel(KEY, _changes(seen), _fork_row(ctx, seen), *_judged(ctx, seen), *_solved(ctx, seen))


def _button(label: Child, click: str, *, title: str = "", cls: str = "") -> Html:
    return tag("button", label, cls=f"vi-button {cls}".strip(), onclick=click, title=title)


# What is changed


def _changes(seen: ExperimentView) -> Html:
    chips = (
        tag(
            "span",
            tag("a", key, cls="vi-link", onclick=send(k="knob", key=key)),
            " ", muted(figures(parameters.get(seen.reference, key)), " → "), strong(figures(value)),
            cls="vi-chip vi-fork", data_change=key,
        )
        for key, value in seen.changes.items()
    )  # fmt: skip
    return tag("div", row(*chips), cls="vi-p")


def _fork_row(ctx: PanelContext, seen: ExperimentView) -> Html:
    options = (
        tag("option", label, value=str(n), selected="selected" if n == ctx.fork_frames else None) for label, n in SPANS
    )
    span = tag(
        "select",
        *options,
        aria_label="how many frames a fork computes",
        onchange="vi.send({k:'span',frames:+this.value})",
    )
    go = _button(
        text(("Fork from frame ", strong(ctx.frame))), send(k="fork"), cls="vi-go", title="Ctrl Enter: repeat from here"
    )
    return tag("div", go, span, cls="vi-forkrow")


def _of(seen: ExperimentView, what: str) -> Html:
    """Which question is answered here, for whoever waits for it."""
    words = " ".join(f"{key}={figures(value)}" for key, value in seen.changes.items())
    return tag("i", hidden="hidden", data_of=words, **{f"data_{what}": "1"})


# Depth one: gates of the whole run


def _judged(ctx: PanelContext, seen: ExperimentView) -> Iterator[Html]:
    judged = seen.judged
    if judged is None:
        yield heading("the whole run", "reading its gates …" if seen.busy else "")
        return
    yield heading("gates of the run", tag("b", judged.label), "whatif.gates")
    yield _of(seen, "judged")
    flipped = [flips for flips in judged.gates if len(flips.now_pass) or len(flips.now_fail)]
    decisions = [d for d in judged.derived if len(d.gained) or len(d.lost)]
    n = len(ctx.run)
    yield from (_decision(d, n) for d in decisions)
    yield from (_flips(flips, n) for flips in flipped)
    calm = len(judged.gates) - len(flipped)
    if calm:
        verb = "gate keeps its verdict" if calm == 1 else "gates keep their verdicts"
        yield tag("div", muted(f"{calm} {verb} in every frame."), cls="vi-p")
    yield from _unanswered(judged)


def _decision(derived: Derived, n: int) -> Html:
    words = text((muted(f"{derived.before} → "), strong(derived.after), muted(" frames")))
    return _lane(derived.name, words, derived.gained, derived.lost, n, "made", "no longer made")


def _flips(flips: Flips, n: int) -> Html:
    words = text((muted(f"{flips.passed_before} → "), strong(flips.passed_after), muted(f" of {flips.evaluated} pass")))
    name = text((term(flips.key.name.replace("_", " "), f"gate.{flips.key.knob}"), muted(f"  {flips.key.decision}")))
    return _lane(name, words, flips.now_pass, flips.now_fail, n, "would pass", "would fail")


def _lane(name: Child, words: Child, gained: np.ndarray, lost: np.ndarray, n: int, plus: str, minus: str) -> Html:
    """A name with its counts, the frames that change as ticks on the run's time, and links to the first of them."""
    strip = tag(
        "div",
        svg(14, ticks(gained, n, 0, 6, OK, 2.0), ticks(lost, n, 8, 14, BAD, 2.0)),
        tag("i", cls="vi-head"),
        cls="vi-lane vi-sunken",
        onpointerdown="vi.scrub(event,this)",
        onpointermove="vi.scrub(event,this)",
    )
    sides = [
        text((tag("span", f"{sign}{len(frames)}", cls=tone), muted(f" {verb}: "), _links(frames)))
        for frames, verb, sign, tone in ((gained, plus, "+", "vi-ok"), (lost, minus, "−", "vi-bad"))
        if len(frames)
    ]
    head = tag("div", tag("span", name), tag("span", words), cls="vi-flip")
    return tag("div", head, strip, *(tag("div", side, cls="vi-small") for side in sides), cls="vi-flips")


def _links(frames: np.ndarray, most: int = 6) -> Html:
    links: list[Child] = []
    for frame in frames[:most].tolist():
        links += [frame_link(frame, frame), " "]
    return text((*links, muted("…") if len(frames) > most else ""))


def _unanswered(judged: Reevaluation) -> Iterator[Html]:
    if judged.unanswered:
        names = ", ".join(judged.unanswered)
        yield tag("div", muted(f"No recorded gate depends on {names}: the window below and a fork tell."), cls="vi-p")


# Depth two: this window


def _solved(ctx: PanelContext, seen: ExperimentView) -> Iterator[Html]:
    note = "solving …" if seen.busy else _front_end_box(seen)
    yield heading(f"frame {ctx.frame} again", note, "whatif.solve")
    if seen.problem:
        yield tag("div", seen.problem, cls="vi-outcome")
        return
    solved = seen.solved
    if solved is None:
        yield muted("…")
        return
    yield _of(seen, "solved")
    yield from _decided(solved)
    if seen.effect is None:
        yield from _unsolved(solved)
        return
    yield _costs(seen.effect)
    yield _residuals(solved, seen.effect)
    yield from _states(seen.effect)
    yield from _prior(solved)


def _front_end_box(seen: ExperimentView) -> Html:
    box = tag(
        "input",
        type="checkbox",
        aria_label="run the front end again",
        checked="checked" if seen.rerun else None,
        onchange="vi.send({k:'frontend',on:this.checked})",
    )
    return tag("label", box, " track its images again", cls="vi-switch")


def _decided(solved: WhatIf) -> Iterator[Html]:
    """The first decision that falls out differently."""
    found = solved.first_difference
    if found is None:
        yield tag("div", "Every decision of this frame falls out the same.", cls="vi-outcome vi-plain")
        return
    sides = (
        text((muted(label), " ", strong(_side(side))))
        for label, side in (("was", found.first), ("would be", found.second))
    )
    knob = (
        tag("a", found.knob, cls="vi-link", onclick=send(k="knob", key=found.knob))
        if found.knob in DECLARATIONS
        else muted(found.knob)
    )
    yield tag(
        "div",
        tag("div", muted("first decision that differs: "), strong(found.gate.replace("_", " ")), f", {found.stage}"),
        *(tag("div", side) for side in sides),
        tag("div", knob, cls="vi-small"),
        cls="vi-outcome vi-forked",
    )  # fmt: skip


def _side(side: Side) -> str:
    if side.limit is None:
        return side.outcome
    return f"{number(side.value, 4)} {OPS.get(side.op, side.op)} {brief(side.limit)}: {side.outcome}"


def _unsolved(solved: WhatIf) -> Iterator[Html]:
    for label, report in (("recorded", solved.before), ("with these parameters", solved.after)):
        yield tag("div", muted(f"{label}: "), strong(str(report.status)), _tracks_words(report), cls="vi-p")


def _tracks_words(report: FrameReport) -> Html:
    return muted(f", {len(report.tracks.ids)} tracks")


def _costs(effect: Effect) -> Html:
    before, after = (views.split(cost) for cost in effect.cost)
    whole = max(sum(v for _, v in before), sum(v for _, v in after))
    lines = []
    for name, parts in (("recorded", before), ("now", after)):
        bar = stacked_bar([(n, v, FACTOR_COLOURS[n]) for n, v in parts], whole)
        lines += [muted(name), bar, tag("span", strong(number(sum(v for _, v in parts))), cls="vi-n")]
    rows = [_pair(name, a, b, f"cost.{name.lower()}") for (name, a), (_, b) in zip(before, after)]
    rows.append(_pair("total", effect.cost[0].total, effect.cost[1].total, "cost"))
    return text((tag("div", *lines, cls="vi-costs"), _pairs("cost", rows)))


def _pairs(name: str, rows: Iterable[Html]) -> Html:
    colour = tag("span", "now", style=f"color:{FORK}")
    return table(
        ((name, ""), (tag("span", "recorded", style=f"color:{ESTIMATE}"), "n"), (colour, "n"), ("Δ", "n")), rows
    )


_PAIR = ("", "n", "n", "n")


def _pair(name: Child, before: float, after: float, tip: str = "", units: str = "") -> Html:
    """Name, both values and their difference, in per cent where that says more."""
    label = term(name, tip) if tip else name
    return table_row((text((label, unit(units))), number(before), strong(number(after)), delta(before, after)), _PAIR)


def delta(before: float, after: float) -> Html:
    """`−7.7 %`, or the difference where the first value is zero; nothing when they are equal."""
    if not (np.isfinite(before) and np.isfinite(after)):
        return muted("–")
    if before == after:
        return muted("=")
    change = after - before
    words = f"{number(100 * change / abs(before), 2)} %" if before else number(change)
    return tag("span", ("+" if change > 0 else "") + words, cls="vi-bad" if change > 0 else "vi-ok")


def _residuals(solved: WhatIf, effect: Effect) -> Html:
    a, b = solved.before, solved.after
    rows = [_pair("tracks", len(a.tracks.ids), len(b.tracks.ids), "tracks")]
    assert a.solve and b.solve
    rows += [
        _pair("landmarks solved", a.solve.n_landmarks, b.solve.n_landmarks),
        _pair("projections", len(a.solve.visual_ids), len(b.solve.visual_ids)),
        _pair("iterations", len(a.solve.iterations), len(b.solve.iterations)),
    ]
    error = effect.residuals.error_px
    if error.size:
        before, after = error.mean(1)
        rows.append(_pair("mean error, shared", float(before), float(after), "landmark.error", "px460"))
    if effect.residuals.imu_sigma is not None and effect.residuals.imu_sigma.size:
        worst = np.nanmax(effect.residuals.imu_sigma, axis=(1, 2))
        rows.append(_pair("largest IMU residual", float(worst[0]), float(worst[1]), "window.imu", "sigma"))
    return _pairs("residuals", rows)


def _states(effect: Effect) -> Iterator[Html]:
    columns = (
        ("frame", "n"),
        (text(("Δp", unit("mm"))), "n"),
        (text(("ΔR", unit("deg"))), "n"),
        (text(("Δv", unit("mm/s"))), "n"),
        (text(("Δb_a", unit("m/s^2"))), "n"),
        (text(("Δb_g", unit("rad/s"))), "n"),
    )
    kinds = [kind for _, kind in columns]
    norms = [np.linalg.norm(v, axis=1) for v in (effect.p_m, effect.v_m_s, effect.b_a, effect.b_g)]
    rows = (
        table_row(
            (
                frame_link(frame, frame),
                strong(fixed(1e3 * float(norms[0][k]), 1)),
                fixed(float(effect.rotation_deg[k]), 3),
                fixed(1e3 * float(norms[1][k]), 1),
                number(float(norms[2][k]), 2),
                number(float(norms[3][k]), 2),
            ),
            kinds,
        )
        for k, frame in enumerate(effect.frames.tolist())
    )
    yield heading("states of the window", text(("dashed ", tag("b", "pink", style=f"color:{FORK}"), " in 3D")))
    yield table(columns, rows)
    yield _landmarks(effect)


def _prior(solved: WhatIf) -> Iterator[Html]:
    """What marginalisation leaves behind: how much of it nothing has measured."""
    a, b = solved.before.marginalization, solved.after.marginalization
    if a is None or b is None or not len(a.eigenvalues) or not len(b.eigenvalues):
        return
    leaks = zip(("x", "y", "z", "yaw"), ("1/m²",) * 3 + ("1/rad²",), a.gauge_information, b.gauge_information)
    rows = [_pair("rank", a.rank, b.rank, "margin.rank")]
    rows += [
        _pair(f"known of {axis}", float(v), float(w), f"prior.{axis}", u)
        for axis, u, v, w in leaks
        if axis == "yaw" or max(v, w) >= FREE
    ]
    yield heading("the new prior", tip="prior.leak")
    yield _pairs("information", rows)


def _landmarks(effect: Effect) -> Html:
    marks = effect.landmarks
    before, after = marks.inv_depth
    both = np.isfinite(before) & np.isfinite(after) & (before > 0) & (after > 0)
    words: list[Child] = [strong(len(marks.ids)), muted(" landmarks in both")]
    if both.any():
        change = np.abs(before[both] / after[both] - 1)
        low, high = (100 * float(v) for v in np.percentile(change, (50, 95)))
        words += [
            muted("; depth differs by "),
            strong(number(low, 2), " %"),
            muted(f", 95 in 100 below {number(high, 2)} %"),
        ]
    for count, where in ((len(marks.only_before), "only recorded"), (len(marks.only_after), "only now")):
        if count:
            words += [muted("; "), strong(count), muted(f" {where}")]
    return tag("div", *words, cls="vi-p")
