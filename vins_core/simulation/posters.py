"""What hangs on the walls: each poster fills a rectangle with its own kind of corners, drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .canvas import Canvas

Poster = Callable[[Canvas, np.random.Generator, int, float, float, float, float], None]
"""canvas, randomness, running number of the picture, then x, y, width, height in metres"""

TITLES = (
    ("SLAM", "in a box room"),
    ("KALMAN", "predict, correct"),
    ("GAUSS", "normal equations"),
    ("SO(3)", "mind the wrap"),
    ("IMU", "two hundred hertz"),
    ("SCHUR", "complement"),
    ("EXP LOG", "there and back"),
    ("BUNDLE", "adjustment"),
    ("LOOP", "closed at last"),
    ("EULER", "yaw pitch roll"),
    ("HORN", "aligned"),
    ("DRIFT", "one per cent"),
    ("CORNER", "Harris, Shi, Tomasi"),
    ("PRIOR", "handle with care"),
    ("NEWTON", "second order"),
    ("ALLAN", "variance"),
    ("HUBER", "robust"),
    ("SCALE", "observe it"),
    ("RANSAC", "vote early"),
    ("FLOW", "Lucas, Kanade"),
    ("SPLINE", "four times smooth"),
    ("CAUCHY", "heavy tails"),
    ("GRAVITY", "nine point eight"),
    ("HAMILTON", "w x y z"),
    ("JACOBI", "first order"),
    ("DEPTH", "inverse is better"),
    ("WINDOW", "ten and one"),
    ("ANCHOR", "first seen here"),
    ("FISHEYE", "beyond ninety"),
    ("BIAS", "it walks"),
)


def frame(canvas: Canvas, x: float, y: float, width: float, height: float, grey: float, border: float = 0.035) -> None:
    """A picture frame with its shadow on the wall."""
    canvas.rectangle(x + 0.02 - border, y + 0.03 - border, width + 2 * border, height + 2 * border, 90)
    canvas.rectangle(x - border, y - border, width + 2 * border, height + 2 * border, grey)


def title(
    canvas: Canvas, rng: np.random.Generator, number: int, x: float, y: float, width: float, height: float
) -> None:
    """A headline, a figure and some lines of print."""
    dark = bool(rng.integers(2))
    paper, ink = (45, 235) if dark else (238, 30)
    head, line = TITLES[number // 4 % len(TITLES)]  # two of eight POSTERS are titles: each comes once
    canvas.rectangle(x, y, width, height, paper)
    cap = min(0.16, 0.16 * height / 0.8)
    canvas.text(head, x + 0.06 * width, y + cap + 0.07 * height, cap, ink, 0.88 * width)
    canvas.text(line, x + 0.06 * width, y + 1.75 * cap + 0.07 * height, 0.4 * cap, ink, 0.88 * width)
    top, bottom = y + 2.3 * cap + 0.05 * height, y + 0.95 * height
    canvas.rectangle(x + 0.06 * width, top, 0.42 * width, bottom - top, 128)
    for _ in range(5):
        cx, cy = x + width * rng.uniform(0.12, 0.42), rng.uniform(top + 0.05, bottom - 0.05)
        canvas.circle(cx, cy, rng.uniform(0.02, 0.06) * width, rng.choice([paper, ink, 70, 190]))
    rows = max(3, int((bottom - top) / 0.055))
    for row in range(rows):
        at = top + (row + 0.2) * (bottom - top) / rows
        start = x + 0.54 * width
        for word in rng.uniform(0.05, 0.16, 4) * width:
            if start + word > x + 0.94 * width:
                break
            canvas.rectangle(start, at, word, 0.45 * (bottom - top) / rows, 0.7 * ink + 0.3 * paper)
            start += word + 0.03 * width


def shapes(
    canvas: Canvas, rng: np.random.Generator, number: int, x: float, y: float, width: float, height: float
) -> None:
    """Discs, half discs and triangles on a grid, as in a Bauhaus print."""
    columns, rows = max(2, round(width / 0.22)), max(2, round(height / 0.22))
    w, h = width / columns, height / rows
    greys = rng.permutation([25, 70, 120, 165, 205, 245])
    quarter = np.linspace(0, np.pi / 2, 14)
    for i in range(columns):
        for j in range(rows):
            paper, ink, third = rng.choice(greys, 3, replace=False)
            left, top = x + i * w, y + j * h
            canvas.rectangle(left, top, w, h, paper)
            kind = rng.integers(4)
            flip_x, flip_y = rng.integers(2, size=2)
            corner = np.array([left + flip_x * w, top + flip_y * h])
            inward = np.array([1 - 2 * flip_x, 1 - 2 * flip_y]) * [w, h]
            if kind == 0:
                canvas.polygon(np.vstack([corner, corner + inward * [0, 1], corner + inward]), ink)
            elif kind == 1:
                arc = corner + 0.95 * inward * np.stack([np.cos(quarter), np.sin(quarter)], -1)
                canvas.polygon(np.vstack([corner, arc]), ink)
                canvas.polygon(np.vstack([corner, corner + 0.45 * (arc - corner)]), third)
            elif kind == 2:
                canvas.circle(left + w / 2, top + h / 2, 0.42 * min(w, h), ink)
                canvas.circle(left + w / 2, top + h / 2, 0.18 * min(w, h), third)
            else:
                canvas.rectangle(left + 0.2 * w, top + 0.2 * h, 0.6 * w, 0.6 * h, ink)
                canvas.rectangle(left + 0.38 * w, top + 0.38 * h, 0.24 * w, 0.24 * h, third)


def landscape(
    canvas: Canvas, rng: np.random.Generator, number: int, x: float, y: float, width: float, height: float
) -> None:
    """Ridges under a moon."""
    canvas.rectangle(x, y, width, height, 215)
    canvas.circle(x + width * rng.uniform(0.2, 0.8), y + 0.22 * height, 0.1 * min(width, height), 250)
    for layer, grey in enumerate((170, 125, 80, 35)):
        count = 5 + 2 * layer
        edge_x = x + width * np.concatenate([[0], np.sort(rng.uniform(0.03, 0.97, count)), [1]])
        base = 0.38 + 0.15 * layer
        peaks = base + rng.uniform(-0.11, 0.05, count + 2) * np.where(np.arange(count + 2) % 2, 1.4, -0.4)
        ridge = np.stack([edge_x, y + height * peaks], -1)
        canvas.polygon(np.vstack([ridge, [x + width, y + height], [x, y + height]]), grey)
        if layer < 2:
            for left, peak, right in zip(ridge[:-2], ridge[1:-1], ridge[2:]):
                if peak[1] < min(left[1], right[1]):
                    notch = peak + np.array([0.0, 0.03])
                    canvas.polygon(
                        np.stack([peak, peak + 0.3 * (right - peak), notch, peak + 0.3 * (left - peak)]), 245
                    )


def skyline(
    canvas: Canvas, rng: np.random.Generator, number: int, x: float, y: float, width: float, height: float
) -> None:
    """A town at night with some windows lit."""
    canvas.rectangle(x, y, width, height, 60)
    left = x
    while left < x + width - 0.03:
        w = min(rng.uniform(0.12, 0.24), x + width - left)
        h = height * rng.uniform(0.4, 0.9)
        wall = rng.choice([20, 95, 120, 150])
        canvas.rectangle(left, y + height - h, w, h, wall)
        columns, rows = max(1, int(w / 0.065)), int(h / 0.085)
        for i in range(columns):
            for j in range(rows):
                lit = 240 if rng.random() < 0.55 else wall * 0.6
                canvas.rectangle(
                    left + (i + 0.25) * w / columns,
                    y + height - h + (j + 0.3) * h / rows,
                    0.5 * w / columns,
                    0.45 * h / rows,
                    lit,
                )
        left += w


def plot(
    canvas: Canvas, rng: np.random.Generator, number: int, x: float, y: float, width: float, height: float
) -> None:
    """Axes, a grid and three curves with markers."""
    canvas.rectangle(x, y, width, height, 245)
    left, top, w, h = x + 0.1 * width, y + 0.08 * height, 0.84 * width, 0.8 * height
    for share in np.linspace(0, 1, 5):
        canvas.line([(left + share * w, top), (left + share * w, top + h)], 0.006, 185)
        canvas.line([(left, top + share * h), (left + w, top + share * h)], 0.006, 185)
        canvas.rectangle(left + share * w - 0.02, y + 0.92 * height, 0.04, 0.02, 60)
        canvas.rectangle(x + 0.03 * width, top + share * h - 0.01, 0.03, 0.02, 60)
    canvas.line([(left, top), (left, top + h), (left + w, top + h)], 0.016, 20)
    for grey in (20, 90, 140):
        at = np.linspace(0.03, 0.97, 8)
        value = np.clip(0.5 + 0.5 * np.cumsum(rng.normal(0, 0.28, 8)), 0.06, 0.94)
        curve = np.stack([left + at * w, top + value * h], -1)
        canvas.line(curve, 0.018, grey)
        for point in curve:
            canvas.rectangle(point[0] - 0.02, point[1] - 0.02, 0.04, 0.04, grey)


def mondrian(
    canvas: Canvas, rng: np.random.Generator, number: int, x: float, y: float, width: float, height: float
) -> None:
    """Panes of different greys between dark bars."""
    canvas.rectangle(x, y, width, height, 20)
    panes = [(x, y, width, height)]
    for _ in range(7):
        panes.sort(key=lambda p: -p[2] * p[3])
        px, py, pw, ph = panes.pop(0)
        share = rng.uniform(0.3, 0.7)
        if pw > ph:
            panes += [(px, py, share * pw, ph), (px + share * pw, py, (1 - share) * pw, ph)]
        else:
            panes += [(px, py, pw, share * ph), (px, py + share * ph, pw, (1 - share) * ph)]
    for px, py, pw, ph in panes:
        canvas.rectangle(px + 0.012, py + 0.012, pw - 0.024, ph - 0.024, rng.choice([75, 130, 175, 225, 250]))


def quilt(
    canvas: Canvas, rng: np.random.Generator, number: int, x: float, y: float, width: float, height: float
) -> None:
    """Triangles in many shades."""
    columns, rows = max(3, round(width / 0.16)), max(3, round(height / 0.16))
    w, h = width / columns, height / rows
    for i in range(columns):
        for j in range(rows):
            corners = [(x + (i + a) * w, y + (j + b) * h) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
            turn = rng.integers(2)
            first, second = rng.choice([30, 75, 115, 150, 190, 235], 2, replace=False)
            canvas.polygon(corners, first)
            canvas.polygon([corners[turn], corners[turn + 1], corners[(turn + 2) % 4]], second)


POSTERS: tuple[Poster, ...] = (title, shapes, landscape, skyline, plot, mondrian, title, quilt)
