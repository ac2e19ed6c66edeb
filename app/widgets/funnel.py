"""A funnel: how many came past each stage, how many of them rightly, and how many would with other settings."""

from __future__ import annotations

from collections.abc import Sequence

from vins_core.mapping.funnel import FunnelStage

from ..html import Html, muted, strong, tag, term
from ..palette import ESTIMATE, FORK, OK


def funnel_bars(stages: Sequence[FunnelStage], predicted: Sequence[FunnelStage] = ()) -> Html:
    """A bar a stage, its part elsewhere hatched; below it, thin, what is predicted."""
    whole = max((s.count for s in (*stages, *predicted)), default=0)
    would = {s.name: s for s in predicted}
    rows = (_stage(s, would.get(s.name), whole, last=s is stages[-1]) for s in stages)
    return tag("div", *rows, cls="vi-funnel")


def _stage(stage: FunnelStage, would: FunnelStage | None, whole: int, *, last: bool) -> Html:
    bars = [_bar(stage, whole, OK if last else ESTIMATE)]
    count = [strong(stage.count)]
    if would is not None:
        bars.append(_bar(would, whole, FORK))
        if would.count != stage.count:
            count += [muted(" → "), tag("b", would.count, style=f"color:{FORK}")]
    return tag(
        "div",
        term(stage.name, f"loops.{stage.name}"),
        tag("div", *bars, cls="vi-funnelbars"),
        tag("span", tag("span", *count), _places(would or stage), cls="vi-val"),
        cls="vi-funnelrow",
        data_stage=stage.name,
        data_count=stage.count if would is None else would.count,
        title=_title(stage, would),
    )


def _bar(stage: FunnelStage, whole: int, colour: str) -> Html:
    elsewhere = stage.elsewhere or 0 if stage.name not in ("queried", "retrievable") else 0
    share = 100 * stage.count / whole if whole else 0.0
    hatched = 100 * elsewhere / stage.count if stage.count else 0.0
    return Html(
        f'<div style="width:{share:.1f}%;background:{colour}"><i style="width:{min(hatched, 100):.1f}%"></i></div>'
    )


def _places(stage: FunnelStage) -> Html:
    """Same place and elsewhere, small; nothing without truth."""
    if stage.same_place is None or stage.elsewhere is None:
        return Html("")
    sides = tag("span", stage.same_place, cls="vi-ok"), tag("span", stage.elsewhere, cls="vi-bad")
    return tag("span", sides[0], muted(" · "), sides[1], cls="vi-places")


def _title(stage: FunnelStage, would: FunnelStage | None) -> str:
    said = [f"{stage.count} keyframes"]
    if stage.same_place is not None:
        first = stage.name in ("queried", "retrievable")
        said.append(
            f"{stage.same_place} truly revisit a place, {stage.elsewhere} do not" if first
            else f"{stage.same_place} with a candidate at the same place, {stage.elsewhere} with one elsewhere"
        )  # fmt: skip
    if would is not None:
        said.append(f"{would.count} with these settings")
    return "; ".join(said)
