"""The pose graph: what it made of the path, residual and weight of every loop, and what other edges would make of it.

Below it the two drift corrections at this frame, and the earlier keyframes that the window saw again.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vins_core.geometry import heading as headings
from vins_core.report import ClosureReport, RelocalizationReport

from ..context import PanelContext, RunView
from ..graph import EdgeRow, Edits, GraphView
from ..html import (
    Child,
    Html,
    bar,
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
from ..loops import has_loops
from ..palette import BAD, FORK, OK
from ..widgets.gate import gate_lines

TITLE = "Graph"
ICON = "TOPOLOGY_STAR_3"
KEY = "graph"

MOST_EDGES = 24
"""Rows of the table: those that the graph doubts most."""


def exists(run: RunView) -> bool:
    return has_loops(run)


def render(ctx: PanelContext) -> str:
    seen = ctx.graph
    if seen is None:
        if ctx.report.closure is None:
            return panel(KEY, empty("There is no keyframe in the graph yet.", "Press ", key_cap("→"), " to step."))
        return panel(KEY, muted("reading the graph …"))
    return panel(KEY, *_path(seen), *_chosen(ctx, seen), *_edges(ctx, seen), *_drifts(ctx), *_seen_again(ctx))


def _path(seen: GraphView) -> Iterator[Html]:
    yield heading("pose graph", text((muted("at frame "), seen.frame)))
    chips = [chip("keyframes ", strong(len(seen.after))), chip("loops ", strong(len(seen.edges)))]
    if seen.base.any():
        chips.append(chip("of a loaded map ", strong(int(seen.base.sum()))))
    if len(np.unique(seen.session)) > 1:
        chips.append(chip("sessions ", strong(len(np.unique(seen.session)))))
    yield row(*chips)
    if seen.ate_m is not None:
        yield tag("div", *_errors(seen), cls="vi-errors vi-p")
    if seen.edits:
        yield tag("div", *_edits(seen.edits), cls="vi-p")


def _errors(seen: GraphView) -> Iterator[Html]:
    """ATE by the odometry alone, in the graph, and after the user's edits, as bars of one scale."""
    assert seen.ate_m is not None
    values = [("odometry", seen.ate_m[0], "#2D5B76"), ("graph", seen.ate_m[1], OK)]
    if seen.edited_ate_m is not None:
        values.append(("your edges", seen.edited_ate_m, FORK))
    longest = max(value for _, value, _ in values) or 1.0
    for name, value, colour in values:
        yield tag("span", term(f"ATE {name}", "ate"))
        yield bar(value / longest, colour)
        yield tag("span", strong(number(100 * value)), unit("cm"), cls="vi-n", data_ate=name, data_m=f"{value:.6f}")


def _edits(edits: Edits) -> Iterator[Child]:
    for pairs, word in ((edits.disabled, "off"), (edits.forced, "forced")):
        for earlier, later in sorted(pairs):
            do = "disable" if word == "off" else "force"
            undo = tag("a", "×", cls="vi-link", onclick=send(k="edge", do=do, i=earlier, j=later), title="as it was")
            yield tag("span", f"{later}→{earlier} ", strong(word), " ", undo, cls="vi-chip vi-fork")
            yield " "
    yield tag("button", "all as they were", cls="vi-button", onclick=send(k="edge", do="reset"))


# One edge


def _chosen(ctx: PanelContext, seen: GraphView) -> Iterator[Html]:
    pair = ctx.loops.pair if ctx.loops is not None else None
    if pair is None or pair.candidate is None:
        return
    earlier, later = pair.candidate.match, pair.candidate.query
    edge = seen.edge((earlier, later))
    yield heading("selected edge", text((strong(later), " → ", strong(earlier))), "loops.edge")
    if edge is not None:
        yield table(_COLUMNS, [_edge(edge, seen, True)])
    elif (earlier, later) in seen.edits.forced:
        yield muted("Not a loop of this run; added here by the pose that PnP found.")
    elif pair.candidate.T_match_query is None:
        yield muted("Not in the graph, and no pose was found that could put it there.")
        return
    else:
        yield muted("Not in the graph at this frame.")
    off, on = (earlier, later) in seen.edits.disabled, (earlier, later) in seen.edits.forced
    buttons = [_button("force" if not on else "no longer force", "force", earlier, later, on)]
    if edge is not None:
        buttons.insert(0, _button("disable" if not off else "enable", "disable", earlier, later, off))
    yield tag("div", *buttons, muted("and optimise again; the run stays as it is"), cls="vi-forkrow")


def _button(label: str, do: str, earlier: int, later: int, on: bool) -> Html:
    return tag(
        "button", label, cls="vi-button" + (" vi-go" if on else ""), onclick=send(k="edge", do=do, i=earlier, j=later),
        data_edge=do,
    )  # fmt: skip


# All edges

_COLUMNS = (
    (text(("later", "→", "earlier")), ""),
    (term("odometry", "loops.edge"), "n"),
    (term("graph", "loops.edge"), "n"),
    (text(("turn", unit("deg"))), "n"),
    (term("weight", "loops.edge"), "wide"),
)
_KINDS = [kind for _, kind in _COLUMNS]


def _edges(ctx: PanelContext, seen: GraphView) -> Iterator[Html]:
    if not seen.edges:
        yield empty("No loop has entered the graph yet: it does when its keyframe has left the window.")
        return
    doubted = sorted(seen.edges, key=lambda e: (e.weight, -e.error_m[1]))[:MOST_EDGES]
    yield heading(
        "loops", text(("the most doubted first", muted(f" · {len(doubted)} of {len(seen.edges)}"))), "loops.edge"
    )
    pair = ctx.loops.pair if ctx.loops is not None else None
    shown = pair.key if pair is not None else None
    yield table(_COLUMNS, (_edge(e, seen, shown == (e.pair[1], e.pair[0])) for e in doubted))


def _edge(edge: EdgeRow, seen: GraphView, shown: bool) -> Html:
    earlier, later = edge.pair
    off, forced = edge.pair in seen.edits.disabled, edge.pair in seen.edits.forced
    weight = tag(
        "div", bar(edge.weight, OK if edge.weight > 0.5 else BAD), tag("span", number(edge.weight, 2)), cls="vi-weight"
    )  # fmt: skip
    cells = (
        text((strong(later), muted("→"), earlier, muted(" off") if off else muted(" forced") if forced else None)),
        text((number(100 * edge.error_m[0]), unit("cm"))),
        text((number(100 * edge.error_m[1]), unit("cm"))),
        number(edge.error_deg[1], 2),
        weight,
    )
    click = send(k="pick", t="loop", i=later, j=earlier)
    return table_row(cells, _KINDS, click=click, cls="vi-now" if shown else "vi-dim" if off else "")


# At this frame


def _drifts(ctx: PanelContext) -> Iterator[Html]:
    closure, pose = ctx.report.closure, ctx.report.pose
    if closure is None or pose is None:
        return
    series, k = ctx.run.series, ctx.frame
    yield heading("drift corrections", "of the newest position")
    names = ("graph", "newest loop")
    moved = series.moved_m[k].tolist()
    rows = [
        table_row(
            (term(name, tip), text((number(100 * m), unit("cm"))), text((number(turn, 2), unit("deg")))), ("", "n", "n")
        )
        for name, tip, m, turn in zip(names, ("drift.graph", "drift.fast"), moved, _turns(closure))
    ]
    apart = float(series.corrections_apart_m[k])
    cells = (term("difference", "drift.apart"), text((number(100 * apart), unit("cm"))), "")
    yield table((("", ""), ("moves by", "n"), ("turns by", "n")), [*rows, table_row(cells, ("", "n", "n"))])


def _turns(closure: ClosureReport) -> list[float]:
    """About gravity, degrees."""
    return [float(np.degrees(headings.turn(T[3:]))) for T in (closure.drift, closure.fast_drift)]


def _seen_again(ctx: PanelContext) -> Iterator[Html]:
    found = ctx.report.relocalizations
    if not found:
        return
    yield heading("relocalisation in the window", f"{len(found)} earlier keyframe{'s' if len(found) > 1 else ''}")
    for report in found:
        yield row(*_relocalization(report))
        if report.gates:
            yield gate_lines(report.gates)


def _relocalization(report: RelocalizationReport) -> Iterator[Html]:
    yield chip(strong(report.query), " → ", strong(report.match), tone="sel")
    yield chip("landmarks ", strong(report.n_factors))
    yield chip("error ", strong(number(report.error_px_before), " → ", number(report.error_px_after)), unit("px460"))
    if report.gates:
        yield chip("taken" if report.accepted else "not taken", tone="ok" if report.accepted else "bad")
