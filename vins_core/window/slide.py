"""Sliding the window: one frame leaves, its tracks find a new anchor (REFERENCE W5, W11).

MARGIN_OLD drops the oldest frame: landmarks anchored in it move to the next frame that sees them, their depth
carried over with the refined poses.  MARGIN_SECOND_NEW drops the frame before the newest: its IMU samples are
appended to the newest frame's interval, its observations are forgotten.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..factors.preintegration import merge
from ..geometry import inverse_depth, se3
from ..sensors import ImuNoise
from .state import CANDIDATE, OUTLIER, Landmarks, WindowFrame, WindowState
from .timing import referred_to


def drop_oldest(window: WindowState) -> WindowState:
    first, *rest = window.frames
    frames = (replace(rest[0], imu=None), *rest[1:])
    table = window.landmarks
    anchored = np.isin(table.ids, first.observations.ids, assume_unique=True)
    inv_depth, status = table.inv_depth.copy(), table.status.copy()
    inv_depth[anchored] = np.nan
    for frame in frames:  # the first remaining frame that sees a landmark becomes its anchor
        ids = table.ids[anchored]
        seen, in_table, _ = np.intersect1d(ids, frame.observations.ids, return_indices=True)
        if len(seen):
            rows = np.flatnonzero(anchored)[in_table]
            old, new = (referred_to(f, window.td_s) for f in (first, frame))
            inv_depth[rows] = _transfer(window.T_b_c[0], old, new, seen, table.inv_depth[rows])
            anchored[rows] = False
    lost_depth = np.isnan(inv_depth) & (status != OUTLIER)
    status[lost_depth] = CANDIDATE
    return replace(window, frames=frames, landmarks=restrict(Landmarks(table.ids, inv_depth, status), frames))


def drop_second_newest(window: WindowState, noise: ImuNoise) -> WindowState:
    *rest, second, newest = window.frames
    if window.inertial:
        assert second.imu is not None and newest.imu is not None
        newest = replace(newest, imu=merge(second.imu, newest.imu, noise))
    frames = (*rest, newest)
    table = window.landmarks
    started_here = np.isin(table.ids, second.observations.ids, assume_unique=True)
    for frame in rest:
        started_here &= ~np.isin(table.ids, frame.observations.ids, assume_unique=True)
    inv_depth = np.where(started_here, np.nan, table.inv_depth)
    status = np.where(started_here & (table.status != OUTLIER), CANDIDATE, table.status).astype(np.uint8)
    return replace(window, frames=frames, landmarks=restrict(Landmarks(table.ids, inv_depth, status), frames))


def restrict(table: Landmarks, frames: tuple[WindowFrame, ...]) -> Landmarks:
    """The landmarks that some frame still sees, and new candidates for tracks that have no landmark yet."""
    ids = np.unique(np.concatenate([f.observations.ids for f in frames]))
    inv_depth, status = np.full(len(ids), np.nan), np.full(len(ids), CANDIDATE, np.uint8)
    _, new, old = np.intersect1d(ids, table.ids, assume_unique=True, return_indices=True)
    inv_depth[new], status[new] = table.inv_depth[old], table.status[old]
    return Landmarks(ids, inv_depth, status)


def _transfer(
    T_b_c: np.ndarray, old: WindowFrame, new: WindowFrame, ids: np.ndarray, inv_depth: np.ndarray
) -> np.ndarray:
    """Inverse depths of tracks in the old anchor, expressed in the new one; NaN behind the camera."""
    rays, rays_new = (o.rays[np.searchsorted(o.ids, ids)] for o in (old.observations, new.observations))
    T_w_old = se3.from_quaternion_translation(old.q_w_b, old.p_w_b) @ T_b_c
    T_w_new = se3.from_quaternion_translation(new.q_w_b, new.p_w_b) @ T_b_c
    points = se3.transform(se3.inverse(T_w_new) @ T_w_old, inverse_depth.point(rays, inv_depth))
    depth = inverse_depth.depth(rays_new, points)
    return np.where(depth > 0, 1.0 / np.where(depth > 0, depth, 1.0), np.nan)
