"""A frame on one page: `step` turns a state and a packet into the next state and a report."""

from __future__ import annotations

from dataclasses import dataclass, field

from .frontend.state import TrackerState
from .report import PoseEstimate, Status
from .window.state import WindowFrame, WindowState


@dataclass(frozen=True)
class RunState:
    """Everything a run carries from frame to frame."""

    tracker: TrackerState
    window: WindowState
    status: Status
    history: tuple[WindowFrame, ...] = field(default=())
    """While initialising: every frame since the oldest of the window, kept or not (VINS' all_image_frame), each with
    the pre-integration from the frame just before it in time; empty once tracking."""
    last_attempt_ns: int | None = None
    rejected_ids: tuple[int, ...] = ()
    """Tracks the estimator rejected in this frame; the tracker drops them in the next one."""
    resume: PoseEstimate | None = None
    """After a restart: the last healthy pose, which the next initialisation starts from."""
