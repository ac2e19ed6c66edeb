"""Why loops close, and why not: a funnel over the run, every gate of one pair, what would have accepted it, and what
other limits would let in.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

from vins_core import params as parameters
from vins_core.loop.rejudge import LIMITS
from vins_core.mapping.counterfactual import ClosedPair, Prediction, Remedy
from vins_core.mapping.truth import Place, Truth
from vins_core.params import DECLARATIONS
from vins_core.report import Gate, LoopCandidate, LoopOutcome

from ..context import PanelContext, RunView
from ..html import (
    Child,
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
    send,
    strong,
    table,
    table_row,
    tag,
    term,
    text,
    unit,
)
from ..loops import FILTERS, LoopsView, TableRow, has_loops
from ..pairs import PairView
from ..widgets.funnel import funnel_bars
from ..widgets.gate import OPS, gate_lines
from ..widgets.knob import figures, knob

TITLE = "Loops"
ICON = "INFINITY"
KEY = "loops"

FIRST = ("min_score_ratio", "min_matches", "min_epipolar", "min_inliers", "max_rms_px", "max_sigma_m",
         "max_tilt_deg", "max_heading_deg", "max_distance_m", "max_drift", "sure_drift", "min_agreement")  # fmt: skip
"""Limits in the order in which they are judged; the others follow."""


def exists(run: RunView) -> bool:
    return has_loops(run)


# Knobs and the question about any pair: drawn once, so that nothing is lost while they are used.


def backdrop_of(ctx: PanelContext) -> object:
    seen = ctx.experiment
    return (id(ctx.run), seen.revision) if seen else None


def backdrop(ctx: PanelContext) -> str:
    seen = ctx.experiment
    if seen is None:
        return tag("div", cls="vi")
    known = [d for d in DECLARATIONS.values() if d.key.startswith("loop.") and d.key != "loop.enabled"]
    order = {name: k for k, name in enumerate((*FIRST, *sorted(LIMITS - set(FIRST))))}
    known.sort(key=lambda d: order.get(d.key.split(".")[1], len(order)))
    rows = (knob(d, parameters.get(seen.params, d.key), parameters.get(seen.reference, d.key)) for d in known)
    changed = any(key.startswith("loop.") for key in seen.changes)
    title = tag("summary", tag("b", "limits"), tag("span", "move one: everything below follows", cls="vi-muted"))
    limits = tag("details", title, *rows, cls="vi-stageknobs", data_stage="loop", open="open" if changed else None)
    ask = tag(
        "div",
        term("why not", "loops.pair"),
        _box("later"),
        "and",
        _box("earlier"),
        tag("button", "ask", cls="vi-button", onclick="vi.askPair(this)"),
        muted("two keyframes, by their numbers"),
        cls="vi-ask",
    )
    return tag("div", tag("div", limits, cls="vi-knobs vi-loopknobs"), ask, cls="vi")


def _box(which: str) -> Html:
    return tag(
        "input", type="number", min=0, cls="vi-num", placeholder=which, aria_label=f"{which} keyframe",
        onkeydown="if(event.key==='Enter')vi.askPair(this)",
    )  # fmt: skip


def render(ctx: PanelContext) -> str:
    seen = ctx.loops
    if seen is None:
        return panel(KEY, empty("This run closes no loops.", "Make one with --loops on."))
    if seen.problem:
        return panel(KEY, tag("div", seen.problem, cls="vi-outcome"))
    return panel(KEY, *_settings(ctx, seen), _funnel(seen), *_why(ctx, seen), *_candidates(seen))


# The whole run


def _funnel(seen: LoopsView) -> Html:
    note: Child = text((strong(seen.judged), f" of {seen.total} keyframes judged …"))
    if seen.complete:
        note = "same place · elsewhere" if seen.funnel and seen.funnel[0].same_place is not None else "the whole run"
    if seen.busy:
        note = "…"
    predicted = seen.prediction.funnel if seen.prediction else ()
    return text((heading("funnel", note, "loops.funnel"), funnel_bars(seen.funnel, predicted), _answer(seen)))


def _answer(seen: LoopsView) -> Html:
    """Which question is answered, for whoever waits for it."""
    changed = " ".join(f"{key}={figures(value)}" for key, value in seen.wish.changes)
    state = "busy" if seen.busy or not seen.complete else "complete"
    return tag("i", hidden="hidden", data_loops=state, data_of=changed or "the run")


def _settings(ctx: PanelContext, seen: LoopsView) -> Iterator[Html]:
    """What is changed, what it gains and loses, how sure that is, and the way to find out."""
    experiment = ctx.experiment
    if experiment is None or not experiment.changes:
        return
    chips = (
        tag(
            "span",
            tag("a", key, cls="vi-link", onclick=send(k="knob", key=key)), " ",
            muted(figures(parameters.get(experiment.reference, key)), " → "), strong(figures(value)),
            cls="vi-chip vi-fork",
        )
        for key, value in experiment.changes.items()
    )  # fmt: skip
    yield tag("div", row(*chips, tag("button", "reset", cls="vi-button", onclick=send(k="reset"))), cls="vi-p")
    predicted = seen.prediction
    if predicted is None:
        yield tag("div", muted("judging the run with these settings …"), cls="vi-p")
        return
    yield _verdict(predicted)
    for pairs, sign, what, tone in (
        (predicted.gained, "+", "newly accepted", "vi-ok"),
        (predicted.lost, "−", "newly lost", "vi-bad"),
    ):
        if pairs:
            yield _list(pairs, sign, what, tone)
    at = predicted.fork_at if predicted.fork_at is not None else ctx.frame
    yield tag(
        "div",
        tag(
            "button", "Fork with these settings", cls="vi-button vi-go", onclick=send(k="fork", at=at),
            title=f"repeat the run from frame {at}: the map that results",
        ),
        muted("from frame "), frame_link(at, at), cls="vi-forkrow vi-p",
    )  # fmt: skip


def _verdict(predicted: Prediction) -> Html:
    gained, lost = (
        tuple(sum(p.truth is not None and p.truth.place is place for p in pairs) for place in Place)
        for pairs in (predicted.gained, predicted.lost)
    )
    lines: list[Child] = []
    if not predicted.gained and not predicted.lost:
        lines.append("The same loops are accepted.")
    else:
        swapped = len({p.query for p in predicted.gained} & {p.query for p in predicted.lost})
        lines += [
            strong(f"+{len(predicted.gained)}"), _split(gained), " ",
            strong(f"−{len(predicted.lost)}"), _split(lost),
            muted(f"; {swapped} of them with another keyframe") if swapped else None,
        ]  # fmt: skip
    if predicted.unanswered:
        lines.append(tag("div", muted(f"Only a fork answers {', '.join(predicted.unanswered)}."), cls="vi-small"))
    elif predicted.first_difference is None or (
        predicted.reports and predicted.exact_until >= predicted.reports[-1].keyframe
    ):
        lines.append(tag("div", muted("Exact over the whole run."), cls="vi-small"))
    else:
        said = (
            f"Exact up to keyframe {predicted.exact_until}, predicted beyond: what changes there changes the "
            "trajectory, which is taken as it was recorded."
        )
        lines.append(tag("div", term(muted(said), "loops.prediction"), cls="vi-small"))
    return tag("div", *lines, cls="vi-outcome vi-forked", data_prediction="1")


def _split(counts: tuple[int, ...]) -> Html:
    same, _, elsewhere = counts
    return muted(f" ({same} same place, {elsewhere} elsewhere)") if same or elsewhere else Html("")


def _list(pairs: tuple[ClosedPair, ...], sign: str, what: str, tone: str, most: int = 12) -> Html:
    links: list[Child] = []
    for p in pairs[:most]:
        wrong = p.truth is not None and p.truth.place is Place.ELSEWHERE
        links += [tag("span", _pair_link(p.query, p.match), cls="vi-wrong" if wrong else ""), " "]
    head = tag("span", f"{sign}{len(pairs)}", cls=tone)
    rest = muted(f"and {len(pairs) - most} more") if len(pairs) > most else None
    listed = what.split()[1]
    return tag("div", head, muted(f" {what}: "), *links, rest, cls="vi-small vi-listed", data_list=listed)


def _pair_link(query: int, match: int) -> Html:
    return tag("a", f"{query}→{match}", cls="vi-link", onclick=send(k="pick", t="loop", i=query, j=match))


# One pair


def _why(ctx: PanelContext, seen: LoopsView) -> Iterator[Html]:
    pair = seen.pair
    if pair is None:
        yield heading("why", "…" if seen.busy else "")
        if not seen.busy:
            hint = (key_cap("N"), " goes to the next candidate; or ask about two keyframes above.")
            yield empty("No keyframe has been asked about yet.", *hint)
        return
    yield heading("why", _frames(pair))
    yield row(*_pair_chips(pair))
    if pair.candidate is None:
        yield gate_lines(pair.report.gates)
        yield tag("div", f"No candidate: {pair.report.outcome}.", cls="vi-outcome vi-plain")
        return
    yield gate_lines(_gates(pair))
    yield _remedy(seen, pair)


def _gates(pair: PairView) -> tuple[Gate, ...]:
    """Of the keyframe alone, then of the pair; what both are asked stands once."""
    assert pair.candidate is not None
    asked = {g.name for g in pair.candidate.gates}
    return (*(g for g in pair.report.gates if g.name not in asked), *pair.candidate.gates)


def _frames(pair: PairView) -> Html:
    ends: list[Child] = [muted("frame "), frame_link(pair.row.frame, pair.row.made_in)]
    if pair.earlier is not None:
        ends += [muted(" and "), frame_link(pair.earlier.frame, pair.earlier.made_in)]
    return text(ends)


def _pair_chips(pair: PairView) -> Iterator[Html]:
    match: Child = strong(pair.candidate.match) if pair.candidate else muted("nothing")
    yield chip("keyframe ", strong(pair.row.number), " → ", match, tone="sel")
    if pair.candidate is not None:
        yield outcome_chip(pair.candidate.outcome)
    if pair.predicted:
        yield chip("predicted", tip="loops.prediction")
    if pair.truth is not None:
        yield truth_chip(pair.truth)
    others = [c for c in pair.report.candidates if pair.candidate is None or c.match != pair.candidate.match]
    if others:
        links = (part for c in others for part in (" ", _candidate_link(c)))
        yield tag("span", muted("others"), *links, cls="vi-small")


def _candidate_link(candidate: LoopCandidate) -> Html:
    click = send(k="pick", t="loop", i=candidate.query, j=candidate.match)
    return tag(
        "a",
        candidate.match,
        cls="vi-link",
        onclick=click,
        title=f"{candidate.query}→{candidate.match}: {candidate.outcome}",
    )


def outcome_chip(outcome: LoopOutcome) -> Html:
    if outcome is LoopOutcome.ACCEPTED:
        return chip("accepted", tone="ok")
    if outcome is LoopOutcome.NOT_CHOSEN:
        return chip(str(outcome), title="another candidate of this keyframe was taken")
    return chip("✕ ", str(outcome), tone="bad")


def truth_chip(truth: Truth) -> Html:
    tone = {Place.SAME: "ok", Place.ELSEWHERE: "bad"}.get(truth.place, "")
    apart = text((number(truth.distance_m), unit("m"), " · ", number(truth.angle_deg), unit("deg")))
    return chip(strong(str(truth.place)), " ", apart, tone=tone, tip="loops.truth")


def _remedy(seen: LoopsView, pair: PairView) -> Html:
    """The smallest joint change that would have accepted this loop, and what else it lets in."""
    assert pair.candidate is not None
    if pair.row.match == pair.candidate.match:
        return tag("div", "The run closed this loop.", cls="vi-outcome vi-good", data_remedy="closed")
    if not seen.remedy_known:
        return tag("div", muted("looking for the smallest change that accepts it …"), cls="vi-p")
    remedy = seen.remedy
    if remedy is None:
        why = _beyond_limits(_gates(pair))
        return tag("div", f"No limits accept it: {why}.", cls="vi-outcome", data_remedy="none")
    if not remedy.changes:
        return tag("div", *_not_by_limits(remedy), cls="vi-outcome vi-plain", data_remedy="order")
    gates = _gates(pair)
    parts: list[Child] = []
    for key, value in remedy.changes.items():
        parts += [" and " if parts else "", strong(_demand(key, value, gates))]
    extra = len(remedy.others)
    same, elsewhere = (remedy.prediction.count(remedy.others, place) for place in (Place.SAME, Place.ELSEWHERE))
    known = pair.truth is not None
    split = f": {same} same place, {elsewhere} elsewhere" if extra and known else ""
    said = text(("; accepts ", strong(extra), " more", split, "."))
    use = tag("button", "set these", cls="vi-button", onclick=_apply(remedy))
    caveat = (
        None if remedy.accepts
        else tag("div", muted("Another candidate of this keyframe would then come first."), cls="vi-small")
    )  # fmt: skip
    return tag(
        "div", term("Would close", "loops.remedy"), " with ", *parts, said, " ", use, caveat,
        cls="vi-outcome vi-remedy", data_remedy="limits",
    )  # fmt: skip


def _beyond_limits(gates: tuple[Gate, ...]) -> str:
    """Why no allowed setting lets a pair pass."""
    for gate in gates:
        if gate.passed or not gate.decides:
            continue
        if gate.value is None:
            return f"{gate.name} cannot be computed"
        declared = DECLARATIONS.get(gate.knob)
        end = None if declared is None else declared.low if gate.op.startswith(">") else declared.high
        if end is not None and (gate.value < end if gate.op.startswith(">") else gate.value > end):
            return f"{gate.name} is {number(gate.value)}, and {gate.knob} ends at {figures(end)}"
    return "they contradict each other"


def _apply(remedy: Remedy) -> str:
    return f"vi.send({json.dumps({'k': 'apply', 'changes': dict(remedy.changes)})})"


def _not_by_limits(remedy: Remedy) -> Iterator[Child]:
    yield "Every gate passes"
    yield "." if remedy.accepts else ": another candidate of this keyframe was taken."


def _demand(key: str, value: object, gates: tuple[Gate, ...]) -> str:
    """`score ≥ 0.037` of a parameter and its value."""
    gate = next((g for g in gates if g.knob == key and g.decides and not g.passed), None)
    units = DECLARATIONS[key].unit
    name, op = (gate.name, OPS.get(gate.op, gate.op)) if gate else (key, "=")
    return f"{name} {op} {figures(value)}" + (f" {units}" if units and units != "sigma" else "")


# Table

_COLUMNS = (
    (text(("later", "→", "earlier")), ""), (term("score", "gate.loop.score"), "n"),
    (term("matches", "gate.loop.matches"), "n"), (term("inliers", "gate.loop.pose inliers"), "n"),
    ("verdict", ""), (term("truth", "loops.truth"), ""),
)  # fmt: skip
_KINDS = [kind for _, kind in _COLUMNS]
_SAID = {
    "all": "all", "accepted": "accepted", "refused": "refused", "missed": "missed", "wrong": "wrong",
    "gained": "+ new", "lost": "− lost",
}  # fmt: skip
_TITLES = {
    "missed": "refused although the place is the same",
    "wrong": "accepted although the place is another one",
    "gained": "accepted with these settings only",
    "lost": "no longer accepted with these settings",
}


def _candidates(seen: LoopsView) -> Iterator[Html]:
    yield heading("candidates", _filters(seen))
    if not seen.table:
        yield muted("None of these.")
        return
    shown = seen.pair.row.number if seen.pair else -1
    yield table(_COLUMNS, (_row(r, shown) for r in seen.table), cls="vi-candidates")


def _filters(seen: LoopsView) -> Html:
    buttons = (
        tag(
            "button", _SAID[show], " ", muted(seen.counts[show]),
            cls="vi-tab vi-on" if show == seen.wish.show else "vi-tab",
            onclick=send(k="loops", show=show), title=_TITLES.get(show, ""), data_filter=show,
        )
        for show in FILTERS
        if show in ("all", seen.wish.show) or seen.counts.get(show)
    )  # fmt: skip
    return tag("span", *buttons, cls="vi-tabs") if seen.counts else Html("")


def _row(r: TableRow, shown: int) -> Html:
    c = r.candidate
    if c is None:
        cells: tuple[Child, ...] = (r.row.number, "–", "–", "–", muted(str(r.report.outcome)), "")
        return table_row(cells, _KINDS, click=send(k="pick", t="loop", i=r.row.number), cls="vi-dim")
    values = {g.name: g.value for g in c.gates}
    sign = "+ " if r.gained else "− " if r.lost else ""
    place = r.truth.place if r.truth else None
    tone = {Place.SAME: "vi-ok", Place.ELSEWHERE: "vi-bad"}.get(place, "vi-muted") if place else ""
    cells = (
        text((strong(c.query), muted("→"), c.match)),
        fixed(c.score, 3),
        number(values.get("matches")),
        number(values.get("pose inliers")),
        text((tag("b", sign, cls="vi-forked") if sign else None, outcome_chip(c.outcome))),
        tag("span", str(place) if place else "–", cls=tone),
    )
    click = send(k="pick", t="loop", i=c.query, j=c.match)
    return table_row(cells, _KINDS, click=click, cls="vi-now" if c.query == shown else "")
