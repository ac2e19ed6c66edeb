"""Tracks, and how they end."""

from __future__ import annotations

from collections.abc import Mapping

from vins_core.report import LossReason, RightLoss

from .tip import Tip

_PX = "px460"

FRONTEND: Mapping[str, Tip] = {
    "tracks": Tip("tracks", "Corners followed from image to image and alive in this one.", source="T4, T9; seed 004.4"),
    "tracks.new": Tip("new tracks", "Corners found in this image to fill up to frontend.max_cnt.", source="T9"),
    "tracks.lost": Tip(
        "lost tracks", "Tracks that ended since the previous frame, each with its reason.", source="T5-T8"
    ),
    "age": Tip("age", "Number of images a track has been seen in; 1 is new.", unit="images", source="T6; seed 004.6"),
    f"loss.{LossReason.FLOW}": Tip(
        "flow failed", "Optical flow did not converge, or its patch changed too much.", source="T5; seed 004.4"
    ),
    f"loss.{LossReason.FLOW_BACK}": Tip(
        "flow-back",
        "Tracked back into the previous image, the point does not return to where it was.",
        equation="|track_back(track(u)) − u| > frontend.flow_back_px",
        unit="px",
        source="TF4; seed 004.28",
    ),
    f"loss.{LossReason.BORDER}": Tip("border", "The point left the image.", source="T5"),
    f"loss.{LossReason.RANSAC}": Tip(
        "F-RANSAC",
        "Too far from the epipolar line of the fundamental matrix that most tracks agree on.",
        equation="dist(u', F u) > frontend.F_threshold",
        unit=_PX,
        source="T7; seed 004.7",
    ),
    f"loss.{LossReason.MASK}": Tip(
        "mask",
        "An older track lies nearer than frontend.min_dist, or the camera's mask is black here.",
        source="T8; seed 004.6",
    ),
    f"loss.{LossReason.OUTLIER}": Tip(
        "estimator outlier",
        "The window found its mean reprojection error above window.max_error_px.",
        source="O12, TF8; seed 004.30",
    ),
    f"loss.{LossReason.DEPTH}": Tip("negative depth", "The solve put the landmark behind its camera.", source="W10"),
    f"loss.{LossReason.RESET}": Tip("tracker reset", "The images have a gap, or time went back.", source="T1"),
    "stereo.match": Tip(
        "match",
        "A track that the second camera sees as well: its depth is known from this pair alone.",
        source="TF6",
    ),
    "stereo.offset": Tip(
        "distance to the epipolar line",
        "Of the matches, with the side of the line on which they lie. A median away from zero is no noise: the "
        "rotation between the cameras or their intrinsics are a little wrong.",
        equation="460 asin(ray₁ · n / |n|),   n = t × R ray₀",
        unit=_PX,
    ),
    "stereo.landmark": Tip(
        "landmark in the right image",
        "How far the solved landmark, seen by the right camera, is from its match.",
        unit="px",
    ),
    f"right.{RightLoss.FLOW}": Tip(
        "flow failed", "Optical flow from the left image to the right one found no minimum.", source="TF6"
    ),
    f"right.{RightLoss.BORDER}": Tip("border", "The point lies outside the right image.", source="TF6"),
    f"right.{RightLoss.FLOW_BACK}": Tip(
        "flow-back",
        "Tracked back into the left image, the point does not return to where it was.",
        equation="|track_back(track(u)) − u| > frontend.flow_back_px",
        unit="px",
        source="TF6",
    ),
    f"right.{RightLoss.EPIPOLAR}": Tip(
        "epipolar line",
        "The calibration says on which line of the right image the point must lie; this one is too far from it.",
        equation="ray₁ᵀ E ray₀ = 0,   E = [t]ₓ R",
        unit=_PX,
    ),
    f"right.{RightLoss.NO_IMAGE}": Tip("no image", "The second camera took no image with this one.", source="TF10"),
}
