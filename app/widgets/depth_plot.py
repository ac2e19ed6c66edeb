"""Measured depth against estimated depth on logarithmic axes, and a histogram of their difference, as SVG."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..html import Html, tag
from ..palette import ESTIMATE, LINE, MUTED, SELECTION, TRUTH

WIDTH, HEIGHT, LEFT, BOTTOM = 420, 250, 34, 26
TICKS_M = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
BINS, REACH = 33, 5.5
"""Of the histogram, from -REACH to REACH sigma; what is further out stands in the last bins."""


def scatter(
    ids: np.ndarray,
    measured_m: np.ndarray,
    estimated_m: np.ndarray,
    sigma: float,
    colours: Sequence[str],
    titles: Sequence[str],
    selected: int,
) -> Html:
    """A dot (click selects its track) for each pair of depths; the identity with three sigma to either side."""
    low, high = _span(np.concatenate([measured_m, estimated_m]))
    scale = np.log(high / low)

    def x(z: float | np.ndarray) -> np.ndarray:
        return LEFT + np.log(np.asarray(z) / low) / scale * (WIDTH - LEFT - 6)

    def y(z: float | np.ndarray) -> np.ndarray:
        return HEIGHT - BOTTOM - np.log(np.asarray(z) / low) / scale * (HEIGHT - BOTTOM - 6)

    ends = np.array([low, high])
    sides = [" ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x(ends), y(ends * (1 + s * 3 * sigma)))) for s in (1, -1)]
    band = f'<polygon points="{sides[0]} {" ".join(reversed(sides[1].split()))}" fill="{TRUTH}" fill-opacity=".1"/>'
    middle = f'<path d="M{x(low):.1f},{y(low):.1f}L{x(high):.1f},{y(high):.1f}" stroke="{TRUTH}" stroke-opacity=".7"/>'
    grid = "".join(_tick(float(x(t)), float(y(t)), t) for t in TICKS_M if low <= t <= high)
    dots: list[str] = []
    picked = ""
    for id, u, v, colour, title in zip(ids.tolist(), x(estimated_m), y(measured_m), colours, titles):
        is_picked = id == selected
        look = f'r="3" fill="{colour}"'
        if is_picked:
            look = f'r="6" fill="{SELECTION}40" stroke="{SELECTION}" stroke-width="2"'
        mark = (
            f'<circle cx="{u:.1f}" cy="{v:.1f}" {look} style="cursor:pointer" data-depth-of="{id}" '
            f"onclick=\"vi.send({{k:'pick',t:'track',i:{id}}})\">{tag('title', title)}</circle>"
        )
        if is_picked:
            picked = mark
        else:
            dots.append(mark)
    names = (
        f'<text x="{WIDTH - 6}" y="{HEIGHT - 2}" text-anchor="end" fill="{MUTED}">estimated, m</text>'
        f'<text x="2" y="12" fill="{MUTED}">measured, m</text>'
    )
    return _svg(HEIGHT, grid, band, middle, *dots, picked, names, label="measured against estimated depth")


def histogram(error_sigma: np.ndarray) -> Html:
    """How often each error occurs, and what noise alone would make."""
    height, floor = 96, 96 - 16
    edges = np.linspace(-REACH, REACH, BINS + 1)
    count, _ = np.histogram(np.clip(error_sigma, -REACH + 1e-6, REACH - 1e-6), edges)
    middle = 0.5 * (edges[1:] + edges[:-1])
    expected = len(error_sigma) * np.exp(-0.5 * middle**2) / np.sqrt(2 * np.pi) * (edges[1] - edges[0])
    top = 1.1 * max(float(count.max(initial=1)), float(expected.max()))
    step = WIDTH / BINS
    bars = "".join(
        f'<rect x="{k * step + 0.5:.1f}" y="{floor * (1 - n / top):.1f}" width="{step - 1:.1f}" '
        f'height="{floor * n / top:.1f}" fill="{ESTIMATE}" data-count="{n}"><title>{n} at {m:.1f} σ</title></rect>'
        for k, (n, m) in enumerate(zip(count.tolist(), middle.tolist()))
        if n
    )
    points = " ".join(f"{(k + 0.5) * step:.1f},{floor * (1 - n / top):.1f}" for k, n in enumerate(expected.tolist()))
    curve = f'<polyline points="{points}" fill="none" stroke="{TRUTH}" stroke-opacity=".8" stroke-dasharray="3 3"/>'
    marks = "".join(
        f'<text x="{(s + REACH) / (2 * REACH) * WIDTH:.1f}" y="{height - 3}" text-anchor="middle" fill="{MUTED}">'
        f"{'−' if s < 0 else ''}{abs(s)}σ</text>"
        for s in (-4, -2, 0, 2, 4)
    )
    axis = f'<path d="M0,{floor}H{WIDTH}" stroke="{LINE}"/>'
    return _svg(height, bars, curve, axis, marks, label="errors of measured depths in standard deviations")


def _span(values: np.ndarray) -> tuple[float, float]:
    return float(values.min()) * 0.9, max(float(values.max()) * 1.1, float(values.min()) * 1.5)


def _tick(x: float, y: float, depth_m: float) -> str:
    return (
        f'<path d="M{x:.1f},6V{HEIGHT - BOTTOM}M{LEFT},{y:.1f}H{WIDTH - 6}" stroke="{LINE}" stroke-width="1"/>'
        f'<text x="{x:.1f}" y="{HEIGHT - BOTTOM + 12}" text-anchor="middle" fill="{MUTED}">{depth_m:g}</text>'
        f'<text x="{LEFT - 4}" y="{y + 3:.1f}" text-anchor="end" fill="{MUTED}">{depth_m:g}</text>'
    )


def _svg(height: int, *body: str, label: str) -> Html:
    attributes = f'viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{label}" class="vi-depthplot"'
    return Html(f"<svg {attributes}>{''.join(body)}</svg>")
