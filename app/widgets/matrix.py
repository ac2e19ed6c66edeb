"""A symmetric matrix of blocks as a heat map: magma over log10|entry|, block names along its edges.

One pixel an entry in a PNG, enlarged by the page without smoothing; over it lies a rectangle a block, which says what
it couples and selects both frames when clicked.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..html import Html, number, send, tag, text
from ..palette import SELECTION

DECADES = 9
"""Below the largest entry; what is smaller is black."""


@dataclass(frozen=True)
class MatrixBlock:
    """Consecutive rows and columns that belong together."""

    name: str  # "pose of frame 120"
    short: str  # on the edge: "x3"
    start: int
    size: int
    frame: int = -1  # that it belongs to
    dropped: bool = False


def heat_map(matrix: np.ndarray, blocks: Sequence[MatrixBlock], picked: Sequence[int] = ()) -> Html:
    """(n, n) matrix with its blocks; blocks of `picked` frames are outlined."""
    n = len(matrix)
    logs, low, high = log_range(matrix)
    edges = "".join(f"M{b.start},0V{n}M0,{b.start}H{n}" for b in blocks if b.start)
    cells = "".join(_cell(matrix, a, b) for a in blocks for b in blocks)
    outlines = "".join(
        f'<rect class="vi-picked" x="{a.start}" y="{b.start}" width="{a.size}" height="{b.size}" fill="none" '
        f'stroke="{SELECTION}" stroke-width="1.6" vector-effect="non-scaling-stroke"/>'
        for a in blocks
        for b in blocks
        if picked and a.frame in picked and b.frame in picked
    )
    last_dropped = max((b.start + b.size for b in blocks if b.dropped), default=0)
    rule = f'<path d="M{last_dropped},0V{n}M0,{last_dropped}H{n}" class="vi-cut"/>' if 0 < last_dropped < n else ""
    svg = Html(
        f'<svg viewBox="0 0 {n} {n}" preserveAspectRatio="none"><path d="{edges}" class="vi-edges"/>{rule}'
        f"{cells}{outlines}</svg>"
    )
    picture = tag("img", alt="", src=png_uri(colours(logs, low, high)), draggable="false")
    return tag(
        "div",
        tag("div", *_labels(blocks, n, "left", 4.5), cls="vi-mtop"),
        tag("div", *_labels(blocks, n, "top", 2.4), cls="vi-mleft"),
        tag("div", picture, svg, cls="vi-mbody"),
        cls="vi-matrix",
        data_matrix=str(n),
    )


def scale(low: float, high: float) -> Html:
    """What the colours mean."""
    return tag(
        "div", tag("span", f"10^{low:.0f}"), tag("i", cls="vi-magma"), tag("span", f"10^{high:.0f}"), cls="vi-mscale"
    )


def log_range(matrix: np.ndarray) -> tuple[np.ndarray, float, float]:
    """(log10|matrix|, lowest shown, highest)."""
    size = np.abs(matrix)
    with np.errstate(divide="ignore"):
        logs = np.log10(size)
    finite = logs[np.isfinite(logs)]
    high = float(np.ceil(finite.max())) if len(finite) else 0.0
    return logs, high - DECADES, high


def colours(logs: np.ndarray, low: float, high: float) -> np.ndarray:
    """(n, n, 3) uint8 BGR."""
    share = np.nan_to_num((logs - low) / max(high - low, 1e-9), nan=0.0, neginf=0.0, posinf=1.0)
    return cv2.applyColorMap(np.round(255 * np.clip(share, 0, 1)).astype(np.uint8), cv2.COLORMAP_MAGMA)


def png_uri(bgr: np.ndarray) -> str:
    return "data:image/png;base64," + base64.b64encode(cv2.imencode(".png", bgr)[1].tobytes()).decode()


def _cell(matrix: np.ndarray, a: MatrixBlock, b: MatrixBlock) -> str:
    """A transparent rectangle: `a` is the column."""
    part = matrix[b.start : b.start + b.size, a.start : a.start + a.size]
    largest = float(np.abs(part).max()) if part.size else 0.0
    names = a.name if a is b else f"{b.name} and {a.name}"
    frames = [f for f in dict.fromkeys((b.frame, a.frame)) if f >= 0]
    click = ""
    if frames:
        call = send(k="pick", t="frame", i=frames[0], j=frames[1] if len(frames) > 1 else -1)
        click = f' onclick="{text(call)}"'
    return (
        f'<rect x="{a.start}" y="{b.start}" width="{a.size}" height="{b.size}" class="vi-cell"{click}>'
        f"<title>{text(names)}: {b.size} x {a.size}, largest entry {number(largest)}</title></rect>"
    )


def _labels(blocks: Sequence[MatrixBlock], n: int, side: str, apart: float) -> list[Html]:
    """Names along an edge, at least `apart` per cent from each other."""
    labels, last = [], -np.inf
    for block in blocks:
        middle = 100 * (block.start + block.size / 2) / n
        if middle - last >= apart:
            labels.append(tag("span", block.short, style=f"{side}:{middle:.2f}%", title=block.name))
            last = middle
    return labels
