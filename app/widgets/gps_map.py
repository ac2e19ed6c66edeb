"""Fixes and trajectories from above, east to the right and north up.

    filled circle    a fix that counts          3-sigma ellipses of the newest ones and of the one selected
    cross            one that was gated         solid: final trajectory, dashed where no fix counts
    hollow diamond   one kept for the alignment thin: live, as far as the frame shown

What is beyond the edge, as gross outliers are, stands on it.  Fixes that are still to come are faint.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vins_core.report import FixVerdict

from ..gps import UNKNOWN, VERDICTS, GpsSeries
from ..html import Html, fixed, number, send, tag, text
from ..palette import BAD, CANDIDATE, ESTIMATE, LINE, MUTED, OK, SELECTION
from .plot import nice_step

WIDTH = 1000
"""Of the drawing, in its own units; the height follows from the ground that is shown."""
MARKS_PER_WIDTH = 400
"""Marks keep their size in CSS pixels when the map is about this wide on the page."""
TALLEST, FLATTEST = 1.0, 0.5
MARGIN = 0.08
MOST_FIXES = 400
"""Of a long run all gated fixes are drawn, and no more than about so many that count."""
ELLIPSES = 6
"""Newest fixes whose ellipses are drawn."""
MOST_POINTS = 800

CROSS, DIAMOND = "M-4,-4L4,4M4,-4L-4,4", "M0,-5.5L5.5,0L0,5.5L-5.5,0Z"
COLOURS = {FixVerdict.USED: OK, FixVerdict.GATED: BAD, FixVerdict.OPEN: CANDIDATE}


@dataclass(frozen=True)
class Ground:
    """What part of the earth is shown."""

    west_m: float
    north_m: float
    unit_per_m: float
    height: float  # of the drawing

    @staticmethod
    def around(points: np.ndarray) -> Ground:
        """That all of (k, 2) east and north can be seen; at least 2 m."""
        points = points[np.isfinite(points).all(1)]
        low, high = (points.min(0), points.max(0)) if len(points) else (np.zeros(2), np.zeros(2))
        span = np.maximum(high - low, 2.0) * (1 + 2 * MARGIN)
        shape = float(np.clip(span[1] / span[0], FLATTEST, TALLEST))
        wide = max(span[0], span[1] / shape)
        centre = (low + high) / 2
        return Ground(
            float(centre[0] - wide / 2), float(centre[1] + wide * shape / 2), WIDTH / wide, round(WIDTH * shape, 1)
        )

    def place(self, p_e: np.ndarray) -> np.ndarray:
        """(..., 2 or 3) in metres -> (..., 2) in the drawing."""
        x = (p_e[..., 0] - self.west_m) * self.unit_per_m
        return np.stack([x, (self.north_m - p_e[..., 1]) * self.unit_per_m], -1)

    def onto(self, xy: np.ndarray) -> np.ndarray:
        """(n, 2) places, those beyond the edge moved onto it."""
        return np.clip(xy, 6.0, np.array([WIDTH - 6.0, self.height - 6.0]))


@dataclass(frozen=True)
class MapPicture:
    """What is drawn."""

    gps: GpsSeries
    frame: int
    selected: int  # a fix, -1 for none
    final_e: np.ndarray  # (k, 3), NaN between stretches; none while the run grows
    final_silent: np.ndarray  # (k,) bool: no fix counts there


def gps_map(picture: MapPicture) -> Html:
    gps = picture.gps
    kept = gps.z_e[gps.final_verdicts != VERDICTS.index(FixVerdict.GATED)]
    ground = Ground.around(np.concatenate([kept[:, :2], gps.T_e_b[:, :2], picture.final_e[:, :2]]))
    body = text((*_grid(ground), *_trajectories(picture, ground), *_fixes(picture, ground), *_body(picture, ground)))
    svg = Html(f'<svg viewBox="0 0 {WIDTH} {ground.height:g}" style="--u:{WIDTH / MARKS_PER_WIDTH:.3f}">{body}</svg>')
    return tag(
        "div",
        tag("div", svg, cls="vi-zoom"),
        tag("div", "N ↑", cls="vi-north"),
        tag("div", f"grid {_step(ground):g} m", cls="vi-mapscale"),
        cls="vi-img vi-map",
        style=f"aspect-ratio:{WIDTH}/{ground.height:g}",
        data_zoom="map",
        onwheel="vi.wheel(event,this)",
        onpointermove="vi.pan(event)",
        ondblclick="vi.reset(this)",
    )


def _grid(ground: Ground) -> Iterator[Html]:
    step = _step(ground)
    wide, high = WIDTH / ground.unit_per_m, ground.height / ground.unit_per_m
    east = np.arange(np.ceil(ground.west_m / step) * step, ground.west_m + wide, step)
    north = np.arange(np.ceil((ground.north_m - high) / step) * step, ground.north_m, step)
    x = ((east - ground.west_m) * ground.unit_per_m).tolist()
    y = ((ground.north_m - north) * ground.unit_per_m).tolist()
    lines = "".join([f"M{v:.1f},0V{ground.height:g}" for v in x] + [f"M0,{v:.1f}H{WIDTH}" for v in y])
    yield Html(f'<path d="{lines}" class="vi-line" stroke="{LINE}"/>')


def _step(ground: Ground) -> float:
    return nice_step(WIDTH / ground.unit_per_m, 6)


def _trajectories(picture: MapPicture, ground: Ground) -> Iterator[Html]:
    final, silent = ground.place(picture.final_e), picture.final_silent
    if len(final):
        nothing = np.full((1, 2), np.nan)
        counted = np.where(silent[:, None], nothing, final)
        edges = silent | np.append(silent[1:], False) | np.append(False, silent[:-1])  # so that nothing gapes
        yield _line(counted, OK, "final", "--s:2.2px;opacity:1")
        yield _line(np.where(edges[:, None], final, nothing), OK, "silent", "--s:1.6px;opacity:1;stroke-dasharray:9 9")
    live = ground.place(picture.gps.T_e_b[: picture.frame + 1])
    yield _line(live, ESTIMATE, "live", "--s:1.3px;opacity:.95")


def _line(xy: np.ndarray, colour: str, name: str, style: str) -> Html:
    stride = max(1, -(-len(xy) // MOST_POINTS))
    kept = np.unique(np.append(np.arange(0, len(xy), stride), len(xy) - 1)) if len(xy) else np.zeros(0, int)
    xy = xy[kept]
    known = np.isfinite(xy).all(1)
    cuts = np.flatnonzero(np.diff(known.astype(np.int8))) + 1
    parts = (part for part in np.split(xy, cuts) if len(part) > 1 and np.isfinite(part[0]).all())
    lines = (
        Html(
            f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in part.tolist())}" stroke="{colour}" '
            f'style="{style}" data-line="{name}"/>'
        )
        for part in parts
    )
    return text(lines)


def _fixes(picture: MapPicture, ground: Ground) -> Iterator[Html]:
    gps = picture.gps
    now, last = gps.verdicts(picture.frame), gps.final_verdicts
    there = np.isfinite(gps.z_e).all(1)
    xy = ground.place(gps.z_e)
    shown = ground.onto(xy)
    come = now != UNKNOWN
    recent = np.flatnonzero(there & come)[-ELLIPSES:].tolist()
    for k in recent:
        if k != picture.selected:
            yield _ellipse(gps, k, xy, ground, COLOURS[VERDICTS[now[k]]], "vi-sigma")
    for k in _thinned(there, last, recent, picture.selected):
        verdict = VERDICTS[now[k] if come[k] else last[k]]
        beyond = "" if np.array_equal(xy[k], shown[k]) else ", beyond the edge"
        title = f"<title>fix {k}: {verdict if come[k] else 'still to come'}{beyond}</title>"
        click = text(send(k="pick", t="fix", i=k))
        yield Html(
            f'<g transform="translate({shown[k][0]:.1f},{shown[k][1]:.1f})" class="vi-fix vi-{_WORD[verdict]}'
            f'{"" if come[k] else " vi-later"}" onclick="{click}" data-fix="{k}">{_SHAPES[verdict]}{title}</g>'
        )
    k = picture.selected
    if 0 <= k < len(gps) and there[k]:
        yield _ellipse(gps, k, xy, ground, SELECTION, "vi-sigma vi-picked")
        yield Html(f'<circle class="p" cx="{shown[k][0]:.1f}" cy="{shown[k][1]:.1f}" data-selected-fix="{k}"/>')


_WORD = {FixVerdict.USED: "used", FixVerdict.GATED: "gated", FixVerdict.OPEN: "open"}
_SHAPES = {
    FixVerdict.USED: Html(
        f'<path d="M3.2,0A3.2,3.2 0 1 1 -3.2,0A3.2,3.2 0 1 1 3.2,0Z" fill="{OK}" fill-opacity=".8"/>'
    ),
    FixVerdict.GATED: Html(f'<path d="{CROSS}" fill="none" stroke="{BAD}" stroke-width="2" stroke-linecap="round"/>'),
    FixVerdict.OPEN: Html(f'<path d="{DIAMOND}" fill="#0009" stroke="{MUTED}" stroke-width="1.6"/>'),
}


def symbol(verdict: FixVerdict) -> Html:
    """As on the map, for legends."""
    return Html(f'<svg width="12" height="12" viewBox="-6.5 -6.5 13 13">{_SHAPES[verdict]}</svg>')


def _thinned(there: np.ndarray, last: np.ndarray, recent: list[int], selected: int) -> list[int]:
    """Rows to draw: of those that count every n-th, and all others."""
    rows = np.flatnonzero(there)
    usual = rows[last[rows] == VERDICTS.index(FixVerdict.USED)]
    kept = usual[:: max(1, -(-len(usual) // MOST_FIXES))]
    others = np.setdiff1d(rows, usual)
    return np.unique(
        np.concatenate([kept, others, recent, [selected] if selected in rows else []]).astype(int)
    ).tolist()


def _ellipse(gps: GpsSeries, k: int, xy: np.ndarray, ground: Ground, colour: str, cls: str) -> Html:
    """Three standard deviations, east and north."""
    return _oval(gps.covariance[k, :2, :2], xy[k], ground, colour, cls, f'data-ellipse="{k}"')


def _oval(C: np.ndarray, xy: np.ndarray, ground: Ground, colour: str, cls: str, said: str = "") -> Html:
    if not np.isfinite(C).all():
        return Html("")
    values, vectors = np.linalg.eigh(C)
    ry, rx = (3 * np.sqrt(np.maximum(values, 0)) * ground.unit_per_m).tolist()
    turn = -np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))  # y of the drawing points down
    return Html(
        f'<ellipse cx="{xy[0]:.1f}" cy="{xy[1]:.1f}" rx="{rx:.1f}" ry="{ry:.1f}" '
        f'transform="rotate({turn:.1f} {xy[0]:.1f} {xy[1]:.1f})" class="{cls}" stroke="{colour}" {said}/>'
    )


def _body(picture: MapPicture, ground: Ground) -> Iterator[Html]:
    """Where the body is by the live trajectory, or else by the final one."""
    p_e = picture.gps.T_e_b[picture.frame, :3] if picture.frame < len(picture.gps.T_e_b) else np.full(3, np.nan)
    if np.isfinite(p_e).all():
        x, y = ground.place(p_e).tolist()
        title = (
            f"<title>east {fixed(float(p_e[0]), 2)} m, north {fixed(float(p_e[1]), 2)} m, up {number(float(p_e[2]))} m"
        )
        yield Html(f'<circle class="vi-body" cx="{x:.1f}" cy="{y:.1f}" data-body="1">{title}</title></circle>')
