"""The prior as an object one can look into: its matrix, what it cannot know but claims to, its spectrum, its blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator

from vins_core.errors import VinspectError
from vins_core.report import MarginalizationReport
from vins_core.solver.spectrum import GAUGE

from ..context import PanelContext
from ..html import (
    Child,
    Html,
    chip,
    empty,
    heading,
    key_cap,
    muted,
    number,
    panel,
    row,
    send,
    strong,
    table,
    table_row,
    tag,
    term,
    text,
    unit,
)
from ..palette import BAD, OK
from ..prior import FREE, PriorView
from ..widgets.matrix import heat_map, log_range, scale
from ..widgets.prior import spectrum

TITLE = "Prior"
ICON = "GRID_DOTS"
KEY = "prior"

FIRST_ESTIMATES = "marginalization.first_estimates"
"""The parameter that keeps linearisation points."""


def render(ctx: PanelContext) -> str:
    try:
        prior = ctx.run.prior(ctx.frame)
    except VinspectError as problem:
        return panel(KEY, empty(str(problem)), *_blocks(ctx.report.marginalization))
    if prior is None:
        return panel(
            KEY,
            empty(
                f"There is no prior after this frame: the estimator is {ctx.report.status}.",
                "The first one is there once a frame has left a solved window: press ", key_cap("→"), ".",
            ),
        )  # fmt: skip
    return panel(KEY, *_matrix(ctx, prior), *_null_space(prior), *_spectrum(ctx, prior), *_blocks(
        ctx.report.marginalization))  # fmt: skip


SIDES = (("after", "what is left"), ("before", "what it is made of"), ("fill-in", "entries that are new"))


def _matrix(ctx: PanelContext, prior: PriorView) -> Iterator[Html]:
    left = ctx.report.marginalization
    sides = SIDES if left is not None and left.kind != "none" else SIDES[:1]
    side, seen = ctx.prior_side if len(sides) > 1 else "after", ctx.departure
    matrix, blocks, note = prior.information, prior.blocks, "Λ = JᵀJ"
    if side == "before" and seen is not None:
        matrix, blocks, note = seen.information, seen.blocks, f"dropped m {seen.m} left of the line, kept n beyond"
    if side == "fill-in" and seen is not None:
        matrix, blocks, note = seen.fill_in, seen.kept, f"{number(100 * seen.share, 2)} % of the entries are new"
    if side != "after" and seen is None:
        note = "working it out …"
    n = len(matrix)
    _, low, high = log_range(matrix)
    picked = (ctx.selection.id, ctx.selection.other) if ctx.selection.kind == "frame" else ()
    yield heading("information", text((f"{n} × {n}, log₁₀|Λ|", scale(low, high))), "prior.information")
    if len(sides) > 1:
        yield tag("div", *(_side(name, words, name == side) for name, words in sides), muted(note), cls="vi-sides")
    yield heat_map(matrix, blocks, [f for f in picked if f >= 0])
    words = text((strong(_named(picked)), " are drawn in 3D. ", key_cap("Esc"), " clears")) if picked else None
    hint = words or "hover a block for its name; a click shows both frames in 3D"
    yield tag("div", muted(hint), cls="vi-small")


def _side(name: str, words: str, on: bool) -> Html:
    return tag(
        "button", name, cls="vi-button" + (" vi-on" if on else ""), onclick=send(k="side", name=name), title=words,
        aria_pressed="true" if on else "false",
    )  # fmt: skip


def _named(frames: tuple[int, ...]) -> str:
    return " and ".join(f"frame {f}" for f in dict.fromkeys(frames) if f >= 0)


def _null_space(prior: PriorView) -> Iterator[Html]:
    yield heading("null-space check", "what camera and IMU cannot see", "prior.null_space")
    names = (
        ("direction", ""),
        (term("information", "prior.leak"), "n"),
        ("", "wide"),
        (term("claims σ", "prior.sigma"), "n"),
        ("", ""),
    )
    kinds = [kind for _, kind in names]
    yield table(
        names,
        (
            table_row(
                (
                    term(f"global {name}" if name != "yaw" else "yaw", f"prior.{name}"),
                    text((strong(number(float(leak))), unit("1/rad²" if name == "yaw" else "1/m²"))),
                    _leak_bar(float(leak)),
                    _claimed(float(leak), name == "yaw"),
                    chip("leaks", tone="bad") if leak > FREE else chip("free", tone="ok"),
                ),
                kinds,
            )
            for name, leak in zip(GAUGE, prior.leaks)
        ),
    )
    knob = tag("a", FIRST_ESTIMATES, cls="vi-link", onclick=send(k="knob", key=FIRST_ESTIMATES))
    yield tag("div", muted("what if Jacobians kept their first estimates: "), knob, cls="vi-p")
    held = text((strong(number(prior.held_cost)), muted(" of its cost "), number(prior.cost)))
    what = ", ".join((*prior.held, "position and yaw are held"))
    yield tag("div", held, muted(f" can no solve lower: {what}"), cls="vi-small")


_LOWEST, _HIGHEST = -24.0, 6.0


def _leak_bar(leak: float) -> Html:
    """Logarithmic, with the limit marked."""

    def share(v: float) -> float:
        return 100 * min(max((math.log10(max(v, 1e-300)) - _LOWEST) / (_HIGHEST - _LOWEST), 0.0), 1.0)

    colour = BAD if leak > FREE else OK
    return Html(
        f'<div class="vi-meter" title="from 1e-24 to 1e6, logarithmic; the mark is {FREE:g}">'
        f'<i class="vi-fill" style="left:0;width:{share(leak):.1f}%;background:{colour}"></i>'
        f'<u style="left:{share(FREE):.1f}%"></u></div>'
    )


def _claimed(leak: float, angle: bool) -> Html:
    """The standard deviation that the prior claims to have of the direction; nothing where it claims none."""
    if leak <= FREE:
        return muted("none")
    sigma = 1 / math.sqrt(leak)
    return text((number(math.degrees(sigma) if angle else sigma), unit("deg" if angle else "m")))


def _spectrum(ctx: PanelContext, prior: PriorView) -> Iterator[Html]:
    threshold = ctx.run.header.params.marginalization.eigen_threshold
    n = len(prior.eigenvalues)
    note = text((term("rank", "margin.rank"), " ", strong(prior.rank), f" of {n}; ", strong(n - prior.rank), " null"))
    yield heading("eigen-spectrum", note, "margin.eigenvalues")
    yield spectrum(prior.eigenvalues, threshold)
    known = prior.eigenvalues[prior.eigenvalues > threshold]
    if len(known):
        low, high = number(float(known.min())), number(float(known.max()))
        yield tag("div", muted(f"smallest that counts {low}, largest {high}"), cls="vi-small")


def _blocks(report: MarginalizationReport | None) -> Iterator[Html]:
    if report is None:
        return
    if report.kind == "none":
        yield heading("marginalisation", "", "margin")
        yield muted("Nothing left the window at this frame.")
        return
    yield heading("marginalisation", report.kind, "margin")
    yield row(
        chip("dropped m ", strong(report.m), tone="bad", tip="margin.m"),
        chip("kept n ", strong(report.n), tone="prior", tip="margin.n"),
        chip("rank ", strong(report.rank), tip="margin.rank"),
    )
    rows, depths = [], [b for b in report.blocks if b.dropped and b.name.startswith("inv_depth")]
    kinds = ("", "n", "n", "")
    for block in report.blocks:
        if block in depths and len(depths) > 1:
            if block is not depths[0]:
                continue
            cells: tuple[Child, ...] = (f"{len(depths)} inverse depths", sum(b.size for b in depths), block.index)
        else:
            cells = (block.name, block.size, block.index)
        verdict = tag("span", "dropped", cls="vi-bad") if block.dropped else muted("kept")
        rows.append(table_row((*cells, verdict), kinds))
    yield table((("block", ""), ("size", "n"), ("index", "n"), ("", "")), rows)
