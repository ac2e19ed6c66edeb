"""Both images of a pair: which tracks the second camera sees as well, where, and why not the others.

A match has the colour of its age, as in the Camera panel.  Under the pointer, and for the selected track, it shows its
line to the other image, the epipolar line on which it has to lie, and where the solved landmark would be seen.
"""

from __future__ import annotations

import numpy as np

from vins_core.report import RIGHT_LOSSES, Gate, RightLoss

from ..context import PanelContext, RunView
from ..html import Html, brief, chip, empty, heading, muted, number, panel, row, send, strong, tag, term, text, unit
from ..palette import SELECTION, age_colour
from ..stereo import MATCHED, StereoPicture, stereo_picture
from ..tooltips import parameter_tip
from ..widgets.gate import gate_lines
from ..widgets.marks import RIGHT_MARKS, dot, right_mark
from ..widgets.matches import GAP, images

TITLE = "Stereo"
ICON = "EYEGLASS"
KEY = "stereo"

STEPS: tuple[tuple[str, RightLoss, str, str], ...] = (
    ("flow finds", RightLoss.FLOW, "", ""),
    ("in the image", RightLoss.BORDER, "frontend.border_px", "px"),
    ("flow comes back", RightLoss.FLOW_BACK, "frontend.flow_back_px", "px"),
    ("on the epipolar line", RightLoss.EPIPOLAR, "frontend.stereo_epipolar_px", "px460"),
)
"""What a track has to pass to be a match: what is left after it, what it refuses, the parameter behind it, its unit."""


def exists(run: RunView) -> bool:
    return len(run.header.calibration.cameras) > 1


def render(ctx: PanelContext) -> str:
    picture = stereo_picture(ctx.report, ctx.run.header.calibration.cameras)
    if picture is None:
        return panel(KEY, empty("This frame says nothing about a second camera."))
    names = [camera.topic or camera.name for camera in ctx.run.header.calibration.cameras[:2]]
    uris, whys = (ctx.image_uri, ctx.second_uri), (ctx.image_note, ctx.second_note)
    notes = tuple(
        text((strong(side), muted(f"  {name}"), None if uri else tag("div", why, cls="vi-muted")))
        for side, name, uri, why in zip(("left", "right"), names, uris, whys)
    )
    shown = images(picture.sizes[0], uris, (notes[0], notes[1]), _marks(ctx, picture))
    return panel(KEY, shown, _legend(picture), _steps(ctx, picture), _selected(ctx, picture))


# -- the images --------------------------------------------------------------------------------------------------------


def _marks(ctx: PanelContext, picture: StereoPicture) -> Html:
    """A group a track, the selected one last of all."""
    (width, height), (right_width, _) = picture.sizes
    scale, below = width / right_width, np.array([0.0, (1 + GAP) * height])

    def in_right(uv_px: np.ndarray) -> np.ndarray:
        return np.round(scale * uv_px + below, 1)

    left, right = np.round(picture.left_px.astype(float), 1), in_right(picture.right_px.astype(float))
    lines, landmarks = in_right(picture.lines_px), in_right(picture.landmark_px)
    picked = np.array([ctx.selection.is_track(i) for i in picture.ids.tolist()], bool)
    order = np.argsort(picked, kind="stable").tolist()
    return text(
        [_track(picture, k, bool(picked[k]), left[k], right[k], lines[k], landmarks[k]) for k in order],
    )


def _track(
    picture: StereoPicture,
    k: int,
    picked: bool,
    left: np.ndarray,
    right: np.ndarray,
    line: np.ndarray,
    landmark: np.ndarray,
) -> Html:
    id, fate = int(picture.ids[k]), int(picture.loss[k])
    colour = SELECTION if picked else age_colour(int(picture.age[k]))
    (u0, v0), found = left.tolist(), bool(np.isfinite(right).all())
    parts = [
        f'<g class="vi-match vi-loose{" vi-picked" if picked else ""}" stroke="{colour}" data-pair="{id}" '
        f"""onclick="vi.send({{k:'pick',t:'track',i:{id}}})"><title>{text(_words(picture, k))}</title>"""
    ]
    seen = np.isfinite(line[:, 0])
    if seen.sum() > 1:
        points = " ".join(f"{u:.0f},{v:.0f}" for u, v in line[seen].tolist())
        parts.append(f'<polyline class="e" points="{points}"/>')
    if found:
        u1, v1 = right.tolist()
        parts.append(f'<polyline class="l" points="{u0},{v0} {u1},{v1}"/>')
        if np.isfinite(landmark).all():
            s, t = landmark.tolist()
            parts.append(f'<polyline class="r" points="{u1},{v1} {s},{t}"/><circle class="r" cx="{s}" cy="{t}"/>')
    places = [(u0, v0)] + ([(u1, v1)] if found else [])
    if fate == MATCHED:
        parts += [f'<circle cx="{u}" cy="{v}" fill="{colour}90"/>' for u, v in places]
    else:
        tone, shape = RIGHT_MARKS[RIGHT_LOSSES[fate]]
        tone = SELECTION if picked else tone
        parts += [
            f'<g class="x" transform="translate({u},{v})"><path class="h" d="{shape}"/>'
            f'<path d="{shape}" stroke="{tone}"/></g>'
            for u, v in places
        ]
    return Html("".join(parts) + "</g>")


def _words(picture: StereoPicture, k: int) -> str:
    fate = int(picture.loss[k])
    words = [f"track {int(picture.ids[k])}: {'matched' if fate == MATCHED else RIGHT_LOSSES[fate]}"]
    if np.isfinite(picture.epipolar_px[k]):
        words.append(f"{number(float(picture.epipolar_px[k]))} px₄₆₀ off its epipolar line")
    return " · ".join(words)


# -- below them --------------------------------------------------------------------------------------------------------


def _legend(picture: StereoPicture) -> Html:
    items = [tag("span", dot(age_colour(20), filled=True), term("match", "stereo.match"), " ",
                 strong(int(picture.matched.sum())))]  # fmt: skip
    items += [
        tag("span", right_mark(loss), term(str(loss), f"right.{loss}"), " ", strong(n), data_right=str(loss))
        for loss in RIGHT_LOSSES
        if (n := picture.count(loss))
    ]
    hint = row(muted("rest on a track: its line, its epipolar line, its landmark · click it to select it"))
    return text((tag("div", *items, cls="vi-legend"), hint))


def _steps(ctx: PanelContext, picture: StereoPicture) -> Html:
    """How many tracks are left after each test, and the limit behind it; then the gate on what remains."""
    left, rows = len(picture.ids), []
    if picture.count(RightLoss.NO_IMAGE) == left:
        return text("")
    for name, loss, knob, px in STEPS:
        left -= picture.count(loss)
        behind = muted("optical flow converges") if not knob else _limit(ctx, knob, px)
        rows.append(
            tag("tr", tag("td", right_mark(loss), " ", term(name, f"right.{loss}")),
                tag("td", strong(left), cls="vi-n"), tag("td", behind), data_step=str(loss), data_left=left)
        )  # fmt: skip
    offset = picture.offset_px[picture.matched]
    note = text(())
    if len(offset):
        p95 = float(np.percentile(np.abs(offset), 95))
        middle = float(np.median(offset))
        note = text(
            ("95 % within ", strong(number(p95)), unit("px460"), ", median ", strong(number(middle)), unit("px460"))
        )
    gates = [gate for gate in ctx.report.tracks.gates if gate.knob == "frontend.min_stereo_share"]
    table = tag("table", *rows, cls="vi-table vi-steps")
    return text((heading("from tracks to matches", note, "stereo.offset"), table, gate_lines(gates)))


def _limit(ctx: PanelContext, knob: str, px: str) -> Html:
    section, name = knob.split(".")
    value = getattr(getattr(ctx.run.header.params, section), name)
    sign = "≥" if name == "border_px" else "≤"
    click = tag("span", knob, cls="vi-link", onclick=send(k="knob", key=knob), data_tip=parameter_tip(knob))
    return text((f"{sign} {brief(float(value))}", unit(px), "  ", click))


def _selected(ctx: PanelContext, picture: StereoPicture) -> Html | None:
    rows = np.flatnonzero([ctx.selection.is_track(i) for i in picture.ids.tolist()])
    if not len(rows):
        return None
    k = int(rows[0])
    fate, value = int(picture.loss[k]), float(picture.epipolar_px[k])
    state = chip("matched", tone="ok") if fate == MATCHED else chip(str(RIGHT_LOSSES[fate]), tone="bad")
    chips = [chip("track ", strong(int(picture.ids[k])), tone="sel"), state]
    apart = float(np.linalg.norm(picture.landmark_px[k] - picture.right_px[k]))
    if np.isfinite(apart):
        chips.append(chip("landmark ", strong(number(apart)), unit("px"), " away", tip="stereo.landmark"))
    limit = ctx.run.header.params.frontend.stereo_epipolar_px
    gate = Gate(
        "epipolar distance", value if np.isfinite(value) else None, "<=", limit, "frontend.stereo_epipolar_px", "px460"
    )
    return tag("div", row(*chips), gate_lines([gate]), data_selected=int(picture.ids[k]))
