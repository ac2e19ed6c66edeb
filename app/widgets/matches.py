"""Two images above each other with the matches between them, each in the colour and dash of what became of it.

Resting on a match shows its descriptor distance, the images of its rays (epipolar lines, curves under distortion), and
where the pose found sees its landmark.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vins_core.report import MATCH_STAGES, MatchStage

from ..html import Child, Html, number, strong, tag, term, text
from ..pair import PairPicture
from ..palette import BAD, CANDIDATE, ESTIMATE, IMU, OK, PRIOR, TRUTH, UNTRACKED

GAP = 0.02
"""Between the images, as a share of their height."""
MARKS_PER_WIDTH = 480
"""Marks keep their size in CSS pixels when an image is about this wide on the page."""


@dataclass(frozen=True)
class Look:
    colour: str
    dash: str = ""  # of its line
    lined: bool = True  # its line is always drawn, not only under the pointer


LOOKS: dict[MatchStage, Look] = {
    MatchStage.FAR: Look(CANDIDATE, "1 4", lined=False),
    MatchStage.AMBIGUOUS: Look(UNTRACKED, "1 4", lined=False),
    MatchStage.ONE_SIDED: Look(PRIOR, "1 4", lined=False),
    MatchStage.EPIPOLAR: Look(IMU, "7 3 1 3"),
    MatchStage.PNP: Look(BAD, "5 4"),
    MatchStage.MATCHED: Look(TRUTH),
    MatchStage.GUIDED: Look(ESTIMATE),
    MatchStage.INLIER: Look(OK),
}
"""In the order of drawing: what supports the pose comes last."""


def images(picture_of: tuple[int, int], uris: tuple[str, str], notes: tuple[Child, Child], *marks: Html) -> Html:
    """Both images, the later above; `picture_of` is (width, height) of one, `notes` stand in their corners."""
    width, height = picture_of
    whole = 2 + GAP
    shown = []
    for k, (uri, note) in enumerate(zip(uris, notes)):
        top = f"top:{100 * k * (1 + GAP) / whole:.3f}%"
        if uri:
            shown.append(tag("img", draggable="false", alt="", src=uri, style=f"{top};height:{100 / whole:.3f}%"))
        shown.append(tag("div", note, cls="vi-corner", style=top))
    svg = Html(
        f'<svg viewBox="0 0 {width} {whole * height:g}" style="--u:{width / MARKS_PER_WIDTH:.3f}">{text(marks)}</svg>'
    )
    return tag(
        "div",
        tag("div", *shown, svg, cls="vi-zoom"),
        cls="vi-img vi-both",
        style=f"aspect-ratio:{width}/{whole * height:g}",
        onwheel="vi.wheel(event,this)",
        onpointermove="vi.pan(event)",
        ondblclick="vi.reset()",
    )


def marks(picture: PairPicture) -> Html:
    """Every match with a fate as a group of its own."""
    below = (1 + GAP) * picture.height
    uv = np.round(picture.uv_px + np.array([[0.0, 0.0], [0.0, below]])[:, None], 1)
    lines = picture.epipolar_px + np.array([[0.0, 0.0], [0.0, below]])[:, None, None]
    sees = np.round(picture.reprojected_px + np.array([0.0, below]), 1)
    groups = []
    for stage, look in LOOKS.items():
        for k in np.flatnonzero(picture.matches.stage == MATCH_STAGES.index(stage)).tolist():
            groups.append(_match(picture, k, stage, look, uv[:, k], lines[:, k], sees[k]))
    return text(groups)


def _match(
    picture: PairPicture, k: int, stage: MatchStage, look: Look, uv: np.ndarray, lines: np.ndarray, sees: np.ndarray
) -> Html:
    (u0, v0), (u1, v1) = uv.tolist()
    cls = f"vi-match vi-match-{MATCH_STAGES.index(stage)}" + ("" if look.lined else " vi-loose")
    parts = [
        f'<g class="{cls}" stroke="{look.colour}" data-match="{int(picture.track_ids[k])}">',
        f"<title>{text(_words(picture, k, stage))}</title>",
        f'<polyline class="l" points="{u0},{v0} {u1},{v1}"',
        f' stroke-dasharray="{look.dash}"/>' if look.dash else "/>",
        *(f'<polyline class="e" points="{points}"/>' for line in lines for points in _stretches(line)),
    ]
    if np.isfinite(sees).all():
        s, t = sees.tolist()
        parts.append(f'<polyline class="r" points="{u1},{v1} {s},{t}"/><circle class="r" cx="{s}" cy="{t}"/>')
    solid = look.lined and not look.dash
    for k, (u, v) in enumerate(((u0, v0), (u1, v1))):
        hollow = "" if solid else ' class="h"'
        loose = "" if k == 0 or look.lined else ' class="l"'
        parts.append(f'<circle cx="{u}" cy="{v}" fill="{look.colour if solid else "#0008"}"{loose or hollow}/>')
    return Html("".join(parts) + "</g>")


def _words(picture: PairPicture, k: int, stage: MatchStage) -> str:
    matches = picture.matches
    words = [f"track {int(picture.track_ids[k])}: {stage}", f"{int(matches.hamming[k])} of 256 bits differ"]
    if np.isfinite(matches.ratio[k]):
        words.append(f"ratio {float(matches.ratio[k]):.2f}")
    if np.isfinite(matches.error_px[k]):
        words.append(f"reprojection error {number(float(matches.error_px[k]))} px₄₆₀")
    return " · ".join(words)


def _stretches(line: np.ndarray) -> Iterator[str]:
    """Points of the parts of a line that can be seen."""
    seen = np.isfinite(line[:, 0])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]]).astype(np.int8)))
    for a, b in zip(edges[::2].tolist(), edges[1::2].tolist()):
        if b - a > 1:
            yield " ".join(f"{u:.0f},{v:.0f}" for u, v in line[a:b].tolist())


def legend(picture: PairPicture) -> Html:
    """Every fate that occurred with its count; a click hides its matches, or shows them again."""
    counts = np.bincount(picture.matches.stage, minlength=len(MATCH_STAGES))
    items = (
        tag(
            "span",
            _sample(look),
            term(str(stage), f"match.{stage}"),
            " ",
            strong(int(n)),
            cls=f"vi-fate vi-fate-{MATCH_STAGES.index(stage)}",
            onclick=f"vi.hideMatches({MATCH_STAGES.index(stage)})",
            data_fate=str(stage),
        )
        for stage, look in reversed(LOOKS.items())
        if (n := counts[MATCH_STAGES.index(stage)])
    )
    return tag("div", *items, cls="vi-legend")


def _sample(look: Look) -> Html:
    dash = f' stroke-dasharray="{look.dash}"' if look.dash else ""
    fill = look.colour if look.lined and not look.dash else "none"
    return Html(
        f'<svg width="26" height="10" viewBox="0 0 26 10" stroke="{look.colour}" stroke-width="1.6">'
        f'<path d="M5,5H21"{dash}/><circle cx="4" cy="5" r="2.6" fill="{fill}"/></svg>'
    )
