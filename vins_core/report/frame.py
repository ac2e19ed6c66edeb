"""All that a frame said."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ..sensors import Anomaly, ImageRef
from .gps import GpsReport
from .initialization import HandEyeReport, InitReport
from .loops import ClosureReport, RelocalizationReport
from .solve import SolveReport
from .tracks import TrackReport
from .window import (
    CalibrationReport,
    DepthReport,
    HealthReport,
    KeyframeReport,
    LandmarkReport,
    MarginalizationReport,
    PoseEstimate,
    WindowReport,
)


class Status(StrEnum):
    """What the estimator is doing after a frame."""

    FILLING = "filling the window"
    INITIALIZING = "initializing"
    TRACKING = "tracking"
    FAILED = "failed, restarting"


@dataclass(frozen=True)
class FrameReport:
    """All the estimator knew at one frame."""

    frame: int
    t_ns: int
    images: tuple[ImageRef, ...]  # every image tracked for this frame, as in its packet
    n_imu: int
    status: Status
    anomalies: tuple[Anomaly, ...]
    tracks: TrackReport
    keyframe: KeyframeReport | None = None
    initialization: InitReport | None = None
    solve: SolveReport | None = None
    window: WindowReport | None = None
    landmarks: LandmarkReport | None = None
    marginalization: MarginalizationReport | None = None
    health: HealthReport | None = None
    pose: PoseEstimate | None = None
    relocalizations: tuple[RelocalizationReport, ...] = ()  # earlier keyframes that the window saw again
    closure: ClosureReport | None = None  # None before the first keyframe, and where loops are not closed
    gps: GpsReport | None = None  # None before the first pose, and where no fixes are fused
    hand_eye: HandEyeReport | None = None  # while initialising with unknown extrinsics
    calibration: CalibrationReport | None = None  # None where nothing of it is estimated
    depth: DepthReport | None = None  # None without a depth camera, and before the window is solved

    @property
    def image(self) -> ImageRef:
        """The frame itself: the newest image of camera 0."""
        return next(ref for ref in reversed(self.images) if ref.camera == 0)

    @property
    def second_image(self) -> ImageRef | None:
        """What a second camera took with it."""
        return self.images[-1] if self.images[-1].camera == 1 else None


Timings = dict[str, float]
"""Milliseconds per stage of one frame: decode, track, depth, preintegrate, initialize, solve, marginalize, slide,
describe, loop, graph, gps, record."""
