"""The two images of a loop, or of what might have been one, with every match and what became of it."""

from __future__ import annotations

from ..context import PanelContext, RunView
from ..html import Child, Html, empty, key_cap, muted, panel, row, strong, tag, text
from ..loops import has_loops
from ..pairs import PairView
from ..widgets.matches import images, legend, marks
from .loops import outcome_chip, truth_chip

TITLE = "Pair"
ICON = "ARROWS_LEFT_RIGHT"
KEY = "pair"


def exists(run: RunView) -> bool:
    return has_loops(run)


def render(ctx: PanelContext) -> str:
    seen = ctx.loops
    pair = seen.pair if seen is not None else None
    if seen is None or pair is None:
        if seen is not None and seen.busy:
            return panel(KEY, empty("Working out this pair …"))
        return panel(KEY, empty("No pair of keyframes is looked at.", key_cap("N"), " goes to the next candidate."))
    if pair.candidate is None:
        sentence = f"Keyframe {pair.row.number} has no candidate: {pair.report.outcome}."
        return panel(KEY, empty(sentence, key_cap("N"), " goes to the next keyframe that has one."))
    drawn = (marks(pair.picture),) if pair.picture else ()
    picture = images((ctx.width, ctx.height), ctx.pair_uris, _notes(ctx, pair), *drawn)
    return panel(KEY, picture, *_below(pair))


def _notes(ctx: PanelContext, pair: PairView) -> tuple[Child, Child]:
    assert pair.candidate is not None
    later = text(("later ", strong(pair.row.number), muted(f"  frame {pair.row.frame}")))
    where = f"  frame {pair.earlier.frame}" if pair.earlier else "  of the map that the run began with"
    earlier = text(("earlier ", strong(pair.candidate.match), muted(where)))
    return tuple(  # type: ignore[return-value]
        text((note, None if uri else tag("div", why, cls="vi-muted")))
        for note, uri, why in zip((later, earlier), ctx.pair_uris, ctx.pair_notes)
    )


def _below(pair: PairView) -> list[Html]:
    assert pair.candidate is not None
    chips = [outcome_chip(pair.candidate.outcome)]
    if pair.truth is not None:
        chips.append(truth_chip(pair.truth))
    hint = muted("rest on a match: bits, epipolar lines, where the pose sees it · click a fate to hide it")
    known = legend(pair.picture) if pair.picture else muted("No landmark was matched.")
    return [known, row(*chips, hint)]
