"""What the front end did."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from .gate import Gate


class LossReason(StrEnum):
    """Why a track ended (SPEC 2.2)."""

    FLOW = "flow failed"
    FLOW_BACK = "flow-back"
    BORDER = "border"
    RANSAC = "F-RANSAC"
    MASK = "mask"
    OUTLIER = "estimator outlier"
    DEPTH = "negative depth"
    RESET = "tracker reset"


class RightLoss(StrEnum):
    """Why a track has no match in the image of the second camera."""

    FLOW = "flow failed"
    FLOW_BACK = "flow-back"
    BORDER = "border"
    EPIPOLAR = "epipolar line"
    NO_IMAGE = "no image"


class DepthLoss(StrEnum):
    """Why the depth image says nothing of a track."""

    NO_IMAGE = "no image"
    MISSING = "no depth"
    NEAR = "too near"
    FAR = "too far"
    EDGE = "at an edge"


class DepthUse(StrEnum):
    """What the estimator makes of a depth at a landmark's anchor."""

    FACTOR = "pulls at its depth"
    HELD = "held there"
    WAITING = "waiting for more frames"
    UNSTEADY = "frames disagree"
    GATED = "disagrees with the estimate"


LOSS_REASONS = tuple(LossReason)
"""`TrackReport.lost_reason` holds indices into this tuple."""


RIGHT_LOSSES = tuple(RightLoss)  # begins as LOSS_REASONS does
"""`TrackReport.right_loss` holds indices into this tuple."""


DEPTH_LOSSES = tuple(DepthLoss)
"""`TrackReport.depth_loss` holds indices into this tuple."""


DEPTH_USES = tuple(DepthUse)
"""`DepthReport.use` holds indices into this tuple."""


@dataclass(frozen=True)
class TrackReport:
    """What the front end did between the previous frame and this one (all images in between)."""

    ids: np.ndarray  # (n,) int64, tracks alive in this frame, new ones last
    uv_px: np.ndarray  # (n, 2) float32
    age: np.ndarray  # (n,) int32, number of images the track has been seen in, 1 = new
    velocity: np.ndarray  # (n, 2) float32, d(x/z, y/z)/dt on the normalised plane, 1/s; 0 for new tracks
    lost_ids: np.ndarray  # (k,) int64
    lost_uv_px: np.ndarray  # (k, 2) float32, last position where it was seen
    lost_age: np.ndarray  # (k,) int32
    lost_reason: np.ndarray  # (k,) uint8, index into LOSS_REASONS
    n_new: int
    gates: tuple[Gate, ...]  # e.g. F-RANSAC inlier ratio, share surviving flow
    # with a second camera, else empty; one row per track alive
    right_uv_px: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    """(n, 2) float32, where the second camera sees each track, or seemed to before flow-back or the epipolar line
    refused it; NaN where it was not found at all."""
    right_loss: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint8))
    """(n,) uint8, index into RIGHT_LOSSES; 255 where there is a match."""
    # with a depth camera, else empty; one row per track alive
    depth_m: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(n,) float32 m, as flow sees it around each track; NaN where too few pixels have one."""
    depth_variation: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(n,) float32, by how much a tenth of the depths around it differ from their median, as a share."""
    depth_share: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(n,) float32, share of the pixels around it that have a depth."""
    depth_loss: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint8))
    """(n,) uint8, index into DEPTH_LOSSES; 255 where the estimator gets the depth."""

    @property
    def usable_depth_m(self) -> np.ndarray:
        """(n,) float32, NaN where the estimator gets none."""
        return np.where(self.depth_loss == 255, self.depth_m, np.float32(np.nan))
