"""Accepted loops to the window and back: requests to refine them, gates on what it found, the drift that follows.

Values only (HOUSE): the loop stage never touches the window, the window never knows the graph (REFERENCE R1-R4).
"""

from __future__ import annotations

import numpy as np

from ..geometry import poses
from ..report import MATCH_STAGES, LoopCandidate, MatchStage
from ..window.relocalize import RelocalisationRequest
from .keyframe import LoopKeyframe

__all__ = ["RelocalisationRequest", "request"]

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
