"""Marks of tracks: the same shapes in the picture, in legends and in tables.

A lost track is a cross.  Its colour says who ended it (optical flow, housekeeping, geometry), its shape which test,
so that no two reasons differ in colour alone.
"""

from __future__ import annotations

from vins_core.report import LossReason, RightLoss

from ..html import Html
from ..palette import BAD, MUTED, UNTRACKED

_TIMES = "M-4,-4L4,4M4,-4L-4,4"
_PLUS = "M-5,0H5M0,-5V5"
_ASTERISK = "M-5,0H5M-2.5,-4.3L2.5,4.3M2.5,-4.3L-2.5,4.3"
STAR = "M0,-6.5L1.7,-1.7L6.5,0L1.7,1.7L0,6.5L-1.7,1.7L-6.5,0L-1.7,-1.7Z"

LOSS_MARKS: dict[LossReason, tuple[str, str]] = {
    LossReason.FLOW: (UNTRACKED, _TIMES),
    LossReason.FLOW_BACK: (UNTRACKED, _PLUS),
    LossReason.BORDER: (MUTED, _TIMES),
    LossReason.MASK: (MUTED, _PLUS),
    LossReason.RESET: (MUTED, _ASTERISK),
    LossReason.RANSAC: (BAD, _TIMES),
    LossReason.OUTLIER: (BAD, _PLUS),
    LossReason.DEPTH: (BAD, _ASTERISK),
}
"""(colour, path around 0, 0) by reason."""


RIGHT_MARKS: dict[RightLoss, tuple[str, str]] = {
    RightLoss.FLOW: (UNTRACKED, _TIMES),
    RightLoss.FLOW_BACK: (UNTRACKED, _PLUS),
    RightLoss.BORDER: (MUTED, _TIMES),
    RightLoss.EPIPOLAR: (BAD, _TIMES),
    RightLoss.NO_IMAGE: (MUTED, _PLUS),
}
"""Likewise, why a track has no match in the second camera."""


def star(colour: str) -> Html:
    return Html(f'<svg width="12" height="12" viewBox="-7 -7 14 14"><path d="{STAR}" fill="{colour}"/></svg>')


def loss_mark(reason: LossReason) -> Html:
    return _cross(*LOSS_MARKS[reason])


def right_mark(loss: RightLoss) -> Html:
    return _cross(*RIGHT_MARKS[loss])


def _cross(colour: str, shape: str) -> Html:
    return Html(
        f'<svg width="12" height="12" viewBox="-7 -7 14 14"><path d="{shape}" fill="none" stroke="{colour}" '
        'stroke-width="2" stroke-linecap="round"/></svg>'
    )


def dot(colour: str, *, filled: bool) -> Html:
    """A track with a depth, or without one yet."""
    return Html(
        f'<svg width="12" height="12" viewBox="-6 -6 12 12"><circle r="3.6" stroke="{colour}" stroke-width="1.6" '
        f'fill="{colour if filled else "none"}" fill-opacity=".55"/></svg>'
    )
