"""An earlier keyframe seen again by the window: a free pose with reprojection factors of its own (REFERENCE R1-R4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RelocalisationRequest:
    """Landmarks of the window that an earlier keyframe sees: what the loop stage asks the window to refine.

    It lives while the later keyframe is in the window.
    """

    query: int  # the later keyframe, counted over the session (`LoopReport.keyframe`)
    match: int  # the earlier one
    frame: int  # frame number of the later keyframe
    T_w_match: np.ndarray  # (7,) p and q wxyz: body of the earlier keyframe in the odometry's world, where to start
    T_b_c: np.ndarray  # (4, 4) of the earlier keyframe
    track_ids: np.ndarray  # (n,) int64, increasing
    rays: np.ndarray  # (n, 3) float64, unit rays in the earlier keyframe's camera
