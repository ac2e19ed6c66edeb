"""Depths for new landmarks, a verdict on solved ones, and what the interface is told about all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry import inverse_depth, se3
from ..geometry.triangulation import triangulate_tracks
from ..params import Window
from ..report import LandmarkReport, LossReason, SolveReport
from .assemble import Assembly, Tracks, tracks_of
from .state import CANDIDATE, MARGINALIZED, OUTLIER, TRIANGULATED, Landmarks, WindowState

FAR_M = 1000.0
"""Depth of what a pair of cameras sees beyond infinity, as noise makes it."""


def triangulate(params: Window, window: WindowState) -> WindowState:
    """Give every landmark without depth one, from all its observations and the current poses (REFERENCE W8, W9).

    Depths below `min_depth`, as too little parallax produces them, are replaced by `init_depth`.  Landmarks that a
    second camera sees get theirs in their first frame; where it finds their rays diverging, they are `FAR_M` away.
    """
    tracks, table = tracks_of(window), window.landmarks
    row = np.searchsorted(table.ids, tracks.ids)
    ready = (tracks.count >= params.min_observations) & (tracks.anchor < len(window.frames) - 3)
    ready |= (stereo := tracks.stereo)
    new = np.flatnonzero(ready & np.isnan(table.inv_depth[row]) & (table.status[row] != OUTLIER))
    if not len(new):
        return window
    renumber = np.full(len(tracks.ids), -1)
    renumber[new] = np.arange(len(new))
    mine = renumber[tracks.track] >= 0
    cameras, track, slots, rays = (
        camera_poses(window),
        renumber[tracks.track[mine]],
        tracks.slots[mine],
        tracks.rays[mine],
    )
    if tracks.right is not None:
        right = tracks.right[mine]
        seen = ~np.isnan(right[:, 0])
        cameras = np.concatenate([cameras, camera_poses(window, 1)])
        track, slots = np.append(track, track[seen]), np.append(slots, slots[seen] + len(window.frames))
        rays = np.concatenate([rays, right[seen]])
    depth = triangulate_tracks(cameras, track, slots, rays, tracks.anchor[new])
    usable = np.isfinite(depth) & (depth >= params.min_depth)
    otherwise = np.where(stereo[new] & ~(np.abs(depth) < params.min_depth), FAR_M, params.init_depth)
    inv_depth, status = table.inv_depth.copy(), table.status.copy()
    inv_depth[row[new]] = 1.0 / np.where(usable, depth, otherwise)
    status[row[new]] = TRIANGULATED
    return replace(window, landmarks=Landmarks(table.ids, inv_depth, status))


def reject(params: Window, window: WindowState, solve: SolveReport) -> tuple[WindowState, dict[LossReason, np.ndarray]]:
    """Mark landmarks behind their camera or with a mean reprojection error above `max_error_px` (W10, O12)."""
    table = window.landmarks
    behind = table.inv_depth <= 0
    row = np.searchsorted(table.ids, solve.visual_ids)
    count = np.bincount(row, minlength=len(table))
    mean = np.bincount(row, solve.visual_error_px, len(table)) / np.maximum(count, 1)
    wrong = (mean > params.max_error_px) & ~behind if params.reject_outliers else np.zeros(len(table), bool)
    status = np.where(behind | wrong, OUTLIER, table.status).astype(np.uint8)
    inv_depth = np.where(behind | wrong, np.nan, table.inv_depth)
    rejected = {LossReason.DEPTH: table.ids[behind], LossReason.OUTLIER: table.ids[wrong]}
    return replace(window, landmarks=Landmarks(table.ids, inv_depth, status)), rejected


def report(
    solved: WindowState,
    rejected: WindowState,
    assembly: Assembly,
    solve: SolveReport,
    sigma: np.ndarray,
    leaves_oldest: bool,
) -> LandmarkReport:
    """Every landmark after the solve: depths of `solved`, verdicts of `rejected`."""
    tracks: Tracks = assembly.tracks
    table = solved.landmarks
    row = np.searchsorted(table.ids, tracks.ids)
    inv_depth, status = table.inv_depth[row], rejected.landmarks.status[row].copy()
    rays = tracks.rays[tracks.start[:-1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        points_c = inverse_depth.point(rays, inv_depth)
    xyz = se3.transform(camera_poses(solved)[tracks.anchor], points_c)
    in_solve = np.searchsorted(tracks.ids, assembly.ids)
    sigma_all = np.full(len(tracks.ids), np.nan, np.float32)
    sigma_all[in_solve] = sigma
    position = np.searchsorted(tracks.ids, solve.visual_ids)
    count = np.bincount(position, minlength=len(tracks.ids))
    error = np.bincount(position, solve.visual_error_px, len(tracks.ids)) / np.where(count, count, np.nan)
    if leaves_oldest:
        solved_now = np.zeros(len(tracks.ids), bool)
        solved_now[in_solve] = True
        status[solved_now & (tracks.anchor == 0) & (status == TRIANGULATED)] = MARGINALIZED
    status[np.isnan(inv_depth) & (status == TRIANGULATED)] = CANDIDATE
    return LandmarkReport(
        ids=tracks.ids,
        xyz_w=xyz.astype(np.float32),
        inv_depth=inv_depth.astype(np.float32),
        sigma_inv_depth=sigma_all,
        anchor_slot=tracks.anchor.astype(np.uint8),
        n_obs=tracks.count.astype(np.uint8),
        error_px=error.astype(np.float32),
        status=status,
    )


def camera_poses(window: WindowState, camera: int = 0) -> np.ndarray:
    """T_w_c of every slot, (n, 4, 4)."""
    q = np.array([f.q_w_b for f in window.frames])
    p = np.array([f.p_w_b for f in window.frames])
    return se3.from_quaternion_translation(q, p) @ window.T_b_c[camera]
