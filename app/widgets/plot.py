"""Curves over a whole run as SVG: one column of `WIDTH` is enough, however long the run is.

Frame k of n lies at x = k / (n - 1) of the width, as the playhead does.  Gaps (NaN) stay gaps.
"""

from __future__ import annotations

import math

import numpy as np

from ..html import Html, tag, text

WIDTH = 1000
"""Horizontal extent of every plot in SVG units; vertical units are pixels."""


def x_of(frame: float | np.ndarray, n: int) -> float | np.ndarray:
    return frame * (WIDTH / max(n - 1, 1))


def thin(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) of a curve with at most 4 points a column: first, extremes and NaN gaps survive, so no spike is lost."""
    n = len(values)
    frames = np.arange(n)
    if n <= 2 * WIDTH:
        return np.asarray(x_of(frames, n), float), values
    starts = np.unique(np.linspace(0, n, WIDTH, endpoint=False).astype(int))
    y = np.stack([values[starts], np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)], 1).ravel()
    return np.repeat(np.asarray(x_of(starts, n), float), 3), y


def line(values: np.ndarray, top: float, height: float, colour: str, width: float = 1.4) -> Html:
    """A curve of `values`, 0 at the bottom and `top` at the top of `height` pixels; what is higher is cut."""
    x, y = thin(values)
    y = height - np.clip(y / top, 0, 1) * (height - 2) - 1
    return Html(
        f'<path d="{_path(x, y)}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-linejoin="round" '
        'vector-effect="non-scaling-stroke"/>'
    )


def area(low: np.ndarray, high: np.ndarray, top: float, height: float, colour: str) -> Html:
    """The band between two curves, NaN where either is."""
    x, a = thin(low)
    _, b = thin(high)
    y0, y1 = (height - np.clip(v / top, 0, 1) * height for v in (a, b))
    body = []
    for run in _runs(np.isfinite(y0) & np.isfinite(y1)):
        there = _points(x[run], y1[run])
        back = _points(x[run][::-1], y0[run][::-1])
        body.append(f"M{there}L{back}Z")
    return Html(f'<path d="{"".join(body)}" fill="{colour}" fill-opacity=".75"/>')


def ticks(frames: np.ndarray, n: int, y0: float, y1: float, colour: str, width: float = 1.2) -> Html:
    """Vertical marks at `frames`, one a column."""
    columns = np.unique(np.round(np.asarray(x_of(np.asarray(frames), n)), 1))
    body = "".join(f"M{x:g},{y0:g}V{y1:g}" for x in columns.tolist())
    return Html(
        f'<path d="{body}" stroke="{colour}" stroke-width="{width}" fill="none" vector-effect="non-scaling-stroke"/>'
    )


def stretches(where: np.ndarray, height: float, colour: str, opacity: float, why: str) -> Html:
    """Upright bands over the frames in `where` (n,) bool; `why` begins their titles."""
    n = len(where)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(np.int8)))
    bands = (
        tag(
            "rect",
            tag("title", f"{why}: frames {a} to {b - 1}"),
            x=f"{float(x_of(a, n)):.1f}",
            y=0,
            width=f"{max(float(x_of(b - a, n)), 1):.1f}",
            height=height,
            fill=colour,
            fill_opacity=opacity,
        )
        for a, b in zip(edges[::2].tolist(), edges[1::2].tolist())
    )
    return text(bands)


def mark(frame: int, n: int, y0: float, y1: float, colour: str, title: str, width: float = 2.5) -> Html:
    """One vertical mark that says what happened there."""
    x = float(x_of(frame, n))
    return tag(
        "path",
        tag("title", title),
        d=f"M{x:.1f},{y0:g}V{y1:g}",
        stroke=colour,
        stroke_width=width,
        vector_effect="non-scaling-stroke",
        fill="none",
    )


def svg(height: float, *body: Html) -> Html:
    """A plot that fills its element; all strokes keep their width."""
    return Html(
        f'<svg viewBox="0 0 {WIDTH} {height:g}" preserveAspectRatio="none" width="100%" height="{height:g}">'
        + "".join(body)
        + "</svg>"
    )


def top_of(values: np.ndarray) -> float:
    """Upper end of an axis from 0: the maximum, unless a few spikes would flatten everything else."""
    finite = values[np.isfinite(values)]
    if not len(finite) or finite.max() <= 0:
        return 1.0
    usual = float(np.percentile(finite, 97))
    highest = float(finite.max())
    return 1.08 * (highest if highest <= 4 * usual or usual <= 0 else 2 * usual)


def nice_step(span: float, most: int) -> float:
    """A step of 1, 2 or 5 times a power of ten that divides `span` into at most `most` parts."""
    raw = max(span / most, 1e-9)
    power = 10.0 ** math.floor(math.log10(raw))
    return next(m * power for m in (1, 2, 5, 10) if m * power >= raw - 1e-12)


def _path(x: np.ndarray, y: np.ndarray) -> str:
    parts = []
    for run in _runs(np.isfinite(y)):
        points = _points(x[run], y[run])
        # a single point would draw nothing
        parts.append(f"M{points}h.5" if run.stop - run.start == 1 else f"M{points}")
    return "".join(parts)


def _points(x: np.ndarray, y: np.ndarray) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist()))


def _runs(good: np.ndarray) -> list[slice]:
    """Stretches where `good` holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    return [slice(a, b) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist())]
