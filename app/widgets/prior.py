"""What marginalisation dropped and kept, and the spectrum of the prior it left."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from vins_core.report import BlockReport, MarginalizationReport

from ..html import Html, chip, facts, heading, muted, number, row, strong, tag, text
from ..palette import BAD, PRIOR


def marginalization(prior: MarginalizationReport, threshold: float) -> Html:
    """`threshold`: eigenvalues below it count as zero (marginalization.eigen_threshold)."""
    title = heading("marginalisation", "", "margin")
    if prior.kind == "none":
        return text((title, muted("Nothing left the window at this frame.")))
    chips = row(
        chip(prior.kind, tone="prior", tip="keyframe"),
        chip("m ", strong(prior.m), tip="margin.m"),
        chip("n ", strong(prior.n), tip="margin.n"),
        chip("rank ", strong(prior.rank), muted(f"/ {prior.n}"), tip="margin.rank"),
    )
    blocks = facts(
        (
            (muted("dropped"), _blocks([b for b in prior.blocks if b.dropped])),
            (muted("kept"), _blocks([b for b in prior.blocks if not b.dropped])),
        )
    )
    parts: list[Html | None] = [title, chips, tag("div", blocks, cls="vi-p")]
    if len(prior.eigenvalues):
        parts += [heading("eigenvalues of the prior", _span(prior.eigenvalues), "margin.eigenvalues")]
        parts += [spectrum(prior.eigenvalues, threshold)]
    return text(parts)


def _blocks(blocks: Sequence[BlockReport]) -> Html:
    """Names of single blocks, and counts where a kind has many: `pose 0 (frame 12), 42 × inv_depth`."""
    if not blocks:
        return muted("nothing")
    kinds = Counter(b.name.split(" ")[0] for b in blocks)
    said: list[str] = []
    for block in blocks:
        kind = block.name.split(" ")[0]
        words = block.name if kinds[kind] <= 2 else f"{kinds[kind]} × {kind}"
        if words not in said:
            said.append(words)
    names = "\n".join(f"{b.name}: columns {b.index} to {b.index + b.size - 1}" for b in blocks[:60])
    return tag("span", ", ".join(said), title=names)


def _span(eigenvalues: np.ndarray) -> str:
    return f"{number(float(eigenvalues.min()), 2)} to {number(float(eigenvalues.max()), 2)}"


def spectrum(eigenvalues: np.ndarray, threshold: float) -> Html:
    """Bars on a logarithmic scale, largest first; those that count as zero in the colour of what is wrong."""
    values = np.sort(eigenvalues)[::-1]
    logs = np.log10(np.maximum(values, 1e-12))
    low = min(float(logs.min()), math.log10(max(threshold, 1e-12)))
    share = (logs - low) / max(float(logs.max()) - low, 1e-9)
    n = len(values)
    bars = "".join(
        f'<rect x="{k}" y="{38 - h:.1f}" width=".8" height="{h + 2:.1f}" fill="{PRIOR if v > threshold else BAD}">'
        f"<title>{k + 1} of {n}: {number(v)}</title></rect>"
        for k, (v, h) in enumerate(zip(values.tolist(), (38 * share).tolist()))
    )
    return Html(
        f'<div class="vi-strip" style="height:40px"><svg viewBox="0 0 {n} 40" preserveAspectRatio="none">'
        f"{bars}</svg></div>"
    )
