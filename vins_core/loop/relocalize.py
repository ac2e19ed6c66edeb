"""Accepted loops to the window and back: requests to refine them, gates on what it found, the drift that follows.

Values only (HOUSE): the loop stage never touches the window, the window never knows the graph (REFERENCE R1-R4).
"""

from __future__ import annotations

import numpy as np

from .. import params
from ..geometry import poses
from ..pose_graph.graph import shift
from ..report import MATCH_STAGES, Gate, LoopCandidate, MatchStage, RelocalizationReport
from ..window.relocalize import RelocalisationRequest
from . import gates
from .keyframe import LoopKeyframe
from .verify import heading_difference

__all__ = ["RelocalisationRequest", "drift", "recheck", "request"]

_SUPPORTS = [MATCH_STAGES.index(s) for s in (MatchStage.INLIER, MatchStage.GUIDED)]


def request(candidate: LoopCandidate, later: LoopKeyframe, earlier: LoopKeyframe) -> RelocalisationRequest:
    """The inliers of a candidate's pose as observations of the later keyframe's landmarks by the earlier one.

    Raises ValueError for a candidate without pose.
    """
    if candidate.matches is None or candidate.T_match_query is None:
        raise ValueError(f"keyframes {candidate.match} and {candidate.query}: no pose was found that could be refined")
    inlier = np.flatnonzero(np.isin(candidate.matches.stage, _SUPPORTS))
    rows = inlier[np.argsort(later.track_ids[inlier], kind="stable")]
    rays = earlier.rays[candidate.matches.row[rows]].astype(float)
    return RelocalisationRequest(
        candidate.query,
        candidate.match,
        later.frame,
        poses.compose(later.T_w_b, poses.inverse(candidate.T_match_query)),
        earlier.T_b_c,
        later.track_ids[rows],
        rays / np.linalg.norm(rays, axis=1, keepdims=True),
    )


def recheck(settings: params.Loop, found: RelocalizationReport) -> tuple[Gate, ...]:
    """The tests that PnP's pose had to pass, of the window's (R3): landmarks, error, covariance, heading, distance.

    Where too few landmarks took part for a pose, all of them fail.
    """
    near = int(np.count_nonzero(found.error_px[1] <= settings.pnp_px))
    error_px, sigma_m, turned_deg, distance_m = None, None, None, None
    if np.isfinite(found.error_px_after):
        error_px = found.error_px_after
        T_w_query = poses.compose(found.T_w_match, found.T_match_query)
        turned_deg = float(np.degrees(np.abs(heading_difference(settings, T_w_query, found.T_w_match))))
        distance_m = float(np.linalg.norm(found.T_match_query[:3]))
    if found.covariance is not None:
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(found.covariance[:3, :3])[-1]))
    return (
        gates.inliers(settings, near),
        gates.rms(settings, error_px),
        gates.sigma(settings, sigma_m),
        gates.heading(settings, turned_deg),
        gates.distance(settings, distance_m),
    )


def drift(settings: params.PoseGraph, T_g_match: np.ndarray, T_w_match: np.ndarray) -> np.ndarray:
    """T_g_w (7,), by which the odometry's world moves for the earlier keyframe to come to where the graph has it.

    `T_g_match`: the earlier body in the graph; `T_w_match`: the same as the window refined it.  Position and turn about
    gravity, because roll and pitch do not drift; with 6 DoF all of the pose (R3, seed 000.3.3.5: relocalize_r and _t).
    """
    return shift(settings, T_g_match, T_w_match)
