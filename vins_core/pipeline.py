"""A frame on one page: `step` turns a state and a packet into the next state and a report."""

from __future__ import annotations

from dataclasses import dataclass, field

from .frontend.state import TrackerState
from .report import Status
from .window.state import WindowFrame, WindowState


@dataclass(frozen=True)
class RunState:
    """Everything a run carries from frame to frame."""

    tracker: TrackerState
    window: WindowState
    status: Status
    interim: tuple[WindowFrame, ...] = field(default=())
    """While initialising: frames since the oldest window frame that the window did not keep (VINS all_image_frame)."""
    last_attempt_ns: int | None = None
    rejected_ids: tuple[int, ...] = ()
    """Tracks the estimator rejected in this frame; the tracker drops them in the next one."""
