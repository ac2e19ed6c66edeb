"""New landmarks (seed 000.3.2): from the depth camera where there is one and it can tell, else by triangulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..params import Params
from ..report import DepthUse
from . import depth
from .assemble import tracks_of
from .landmarks import triangulate
from .slide import restrict
from .state import OUTLIER, TRIANGULATED, Landmarks, WindowState


def create_landmarks(params: Params, window: WindowState) -> WindowState:
    """Give every landmark without depth one, as far as depth camera and parallax can."""
    return triangulate(params.window, _from_depths(params, window))


def _from_depths(params: Params, window: WindowState) -> WindowState:
    """Landmarks from measured depths; with `hold`, all that are held are put where the current poses have them.

    With `confirm`, a track that has no depth yet loses its first observation when its first two frames disagree.
    """
    tracks, table = tracks_of(window), window.landmarks
    row = np.searchsorted(table.ids, tracks.ids)
    inv_depth, fine = table.inv_depth.copy(), table.status[row] != OUTLIER
    unknown = np.isnan(inv_depth[row]) & fine
    seen = depth.points(params.depth, window, tracks, inv_depth[row])
    if seen is None:
        return window
    held = seen.use == depth.USES[DepthUse.HELD]
    placed = np.flatnonzero((unknown & seen.counts) | (held & fine))
    inv_depth[row[placed]] = 1.0 / seen.depth_m[placed]
    status = table.status.copy()
    status[row[placed]] = TRIANGULATED
    window = replace(window, landmarks=Landmarks(table.ids, inv_depth, status))
    if params.depth.variant != "confirm":
        return window
    thinned = depth.forget_unsteady(window, tracks, seen, unknown)
    return window if thinned is window else replace(thinned, landmarks=restrict(window.landmarks, thinned.frames))
