"""The image with its tracks: who is followed, for how long, and who was lost and why.

Colour is age (cividis), a filled mark has a depth, a hollow one has none yet, a star is an outlier, a cross is a
track lost there.
"""

from __future__ import annotations

import numpy as np

from vins_core.report import LOSS_REASONS, LandmarkStatus

from .. import views
from ..context import PanelContext
from ..html import Html, empty, muted, panel, row, strong, tag, term, text
from ..palette import BAD, FORK, OLD_TRACK, SELECTION, age_colour
from ..widgets.marks import LOSS_MARKS, STAR, dot, loss_mark, star

TITLE = "Camera"
ICON = "CAMERA"
KEY = "camera"

_MARKS_PER_WIDTH = 480
"""Marks keep their size in CSS pixels when the image is about this wide on the page."""


def render(ctx: PanelContext) -> str:
    return panel(KEY, _picture(ctx), _legend(ctx))


def _picture(ctx: PanelContext) -> Html:
    image = tag("img", draggable="false", alt="", src=ctx.image_uri) if ctx.image_uri else None
    svg = Html(
        f'<svg viewBox="0 0 {ctx.width} {ctx.height}" style="--u:{ctx.width / _MARKS_PER_WIDTH:.3f}">'
        f"{_tracks(ctx)}{_lost(ctx)}{_changed(ctx)}</svg>"
    )
    note = None if ctx.image_uri else tag("div", ctx.image_note or "This frame has no image.", cls="vi-noimg")
    return tag(
        "div",
        tag("div", image, svg, cls="vi-zoom"),
        note,
        cls="vi-img",
        style=f"aspect-ratio:{ctx.width}/{ctx.height}",
        onwheel="vi.wheel(event,this)",
        onpointermove="vi.pan(event)",
        ondblclick="vi.reset()",
    )


def _tracks(ctx: PanelContext) -> str:
    """Trails below, marks above, the selected track last of all."""
    tracks, state = ctx.report.tracks, views.statuses(ctx.report)
    below, above, selected = [], [], ""
    paths = views.trails(ctx.run, ctx.report)
    for id, age, path in zip(tracks.ids.tolist(), tracks.age.tolist(), np.round(paths, 1).tolist()):
        colour, status = age_colour(age), state.get(id)
        picked = ctx.selection.is_track(id)
        points = " ".join(f"{u:g},{v:g}" for u, v in path if u == u)
        if " " in points:
            look = f'stroke="{SELECTION}" style="--s:2px;opacity:1"' if picked else f'stroke="{colour}"'
            below.append(f'<polyline points="{points}" {look}/>')
        u, v = path[-1]
        click = f"""onclick="vi.send({{k:'pick',t:'track',i:{id}}})" data-track="{id}\""""
        title = f"<title>track {id} · age {age}{f' · {status}' if status else ''}</title>"
        if picked:
            selected = f'<circle class="p" cx="{u}" cy="{v}" {click}>{title}</circle>'
        elif status is LandmarkStatus.OUTLIER:
            above.append(
                f'<g transform="translate({u},{v})"><path class="o" d="{STAR}" fill="{BAD}" {click}>{title}</path></g>'
            )
        else:
            fill = f"{colour}90" if status is LandmarkStatus.TRIANGULATED else "#0009"
            above.append(f'<circle cx="{u}" cy="{v}" stroke="{colour}" fill="{fill}" {click}>{title}</circle>')
    return "".join(below) + "".join(above) + selected


def _lost(ctx: PanelContext) -> str:
    """Crosses with a dark rim, so that they stand out from bright images."""
    tracks = ctx.report.tracks
    marks = []
    rows = zip(
        tracks.lost_ids.tolist(),
        np.round(tracks.lost_uv_px, 1).tolist(),
        tracks.lost_age.tolist(),
        tracks.lost_reason.tolist(),
    )
    for id, (u, v), age, index in rows:
        reason = LOSS_REASONS[index]
        colour, shape = LOSS_MARKS[reason]
        picked = SELECTION if ctx.selection.is_track(id) else colour
        marks.append(
            f'<g class="x" transform="translate({u},{v})" onclick="vi.send({{k:\'pick\',t:\'track\',i:{id}}})" '
            f'data-lost="{id}"><path class="h" d="{shape}"/><path d="{shape}" stroke="{picked}"/>'
            f"<title>track {id} lost at age {age}: {reason}</title></g>"
        )
    return "".join(marks)


def _changes(ctx: PanelContext) -> views.TrackChanges | None:
    """What tracking the images again with other parameters changed here."""
    solved = ctx.experiment.solved if ctx.experiment else None
    if solved is None or not solved.reran_frontend:
        return None
    return views.track_changes(solved.before.tracks, solved.after.tracks)


def _changed(ctx: PanelContext) -> str:
    """Tracks that other parameters change: a ring where it lands now, a cross where none is left, a dot where one is
    new."""
    changes = _changes(ctx)
    if changes is None:
        return ""
    marks = []
    for (u, v), id in zip(np.round(changes.moved[:, 1], 1).tolist(), changes.moved_ids.tolist()):
        title = f"<title>track {id} would lie elsewhere</title>"
        marks.append(
            f'<circle class="w" cx="{u}" cy="{v}" stroke="{FORK}" fill="none" data-moved="{id}">{title}</circle>'
        )
    for (u, v), id in zip(np.round(changes.come, 1).tolist(), changes.come_ids.tolist()):
        title = f"<title>track {id} would be there</title>"
        marks.append(f'<circle cx="{u}" cy="{v}" stroke="#000" fill="{FORK}" data-come="{id}">{title}</circle>')
    shape = "M-4,-4L4,4M4,-4L-4,4"
    for (u, v), id in zip(np.round(changes.gone, 1).tolist(), changes.gone_ids.tolist()):
        marks.append(
            f'<g class="x" transform="translate({u},{v})" data-gone="{id}"><path class="h" d="{shape}"/>'
            f'<path d="{shape}" stroke="{FORK}"/><title>track {id} would be gone</title></g>'
        )
    return "".join(marks)


def _changes_legend(changes: views.TrackChanges) -> Html:
    counts = (("moved", len(changes.moved)), ("new", len(changes.come)), ("gone", len(changes.gone)))
    items = [tag("span", word, " ", strong(n)) for word, n in counts]
    what_if = tag("span", "what-if", style=f"color:{FORK}")
    pairs = [tag("span", tag("span", sign, style=f"color:{FORK}"), " ", item) for sign, item in zip("○●×", items)]
    return tag("div", what_if, *pairs, cls="vi-legend", data_changes="1")


def _legend(ctx: PanelContext) -> Html:
    tracks = ctx.report.tracks
    old = age_colour(OLD_TRACK)
    items = [
        tag("span", term("age", "age"), muted(" 1"), tag("i", cls="vi-ages"), muted(f"{OLD_TRACK}+"), cls="vi-scale"),
    ]
    if ctx.report.landmarks is not None:
        outliers = sum(s is LandmarkStatus.OUTLIER for s in views.statuses(ctx.report).values())
        items += [
            tag("span", dot(old, filled=True), term("has a depth", "landmark.inv_depth")),
            tag("span", dot(old, filled=False), term("none yet", "landmark.state")),
        ]
        if outliers:
            items.append(tag("span", star(BAD), "outlier ", strong(outliers)))
    counts = views.lost_counts(tracks)
    lost = [
        tag("span", loss_mark(reason), term(str(reason), f"loss.{reason}"), " ",
            strong(n), data_loss=str(reason))
        for reason, n in counts
    ]  # fmt: skip
    if lost:
        lost.insert(0, tag("span", "lost ", strong(len(tracks.lost_ids)), cls="vi-muted"))
    elif len(tracks.ids):
        lost = [muted("no track was lost since the previous frame")]
    parts = [tag("div", *items, cls="vi-legend"), tag("div", *lost, cls="vi-legend")]
    changes = _changes(ctx)
    hint = row(muted("wheel zooms · drag pans · double click resets · click a track to select it"))
    parts.append(_changes_legend(changes) if changes is not None else hint)
    if not len(tracks.ids):
        parts.append(
            empty("No track is alive in this frame.", "Look at ", strong("Gates"), " for the reason, or step back.")
        )
    return text(parts)
