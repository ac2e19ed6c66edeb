"""What a depth camera says of the landmarks of a window: the three variants of seed 000.3.2 (docs/depth.md).

A track that frames i = 1 ... k, the first that see it, have measured at depths z_i along rays f_i is at

    X_i = T_w_ci (f_i z_i / f_i.z),      z = (T_w_c1^-1 mean X_i).z,
    disagreement^2 = 1/(k-1) sum |X_i - mean X|^2 / (sigma |f_i z_i / f_i.z|)^2

with the current poses.  `trust` takes k = 1, `confirm` k = 2, `hold` k = `depth.frames`.  From frame to frame the mean
moves on by one frame and a measurement takes part in k of them, so that each mean counts as one measurement: over the
life of a track every depth counts once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..geometry import inverse_depth, se3
from ..params import Depth
from ..report import DEPTH_USES, DepthReport, DepthUse, Gate
from ..solver.problem import Depths
from .state import OUTLIER, WindowFrame, WindowState

if TYPE_CHECKING:
    from .assemble import Assembly, Tracks

NONE = np.uint8(255)
USES = {use: np.uint8(i) for i, use in enumerate(DEPTH_USES)}


@dataclass(frozen=True)
class DepthPoints:
    """Of the T tracks of a window."""

    depth_m: np.ndarray  # (T,) along z of the anchor; NaN unless the anchor has a depth
    disagreement: np.ndarray  # (T,) sigma between the frames that were compared; NaN where none were
    use: np.ndarray  # (T,) uint8, index into DEPTH_USES; NONE where the anchor has no depth

    @property
    def counts(self) -> np.ndarray:
        """(T,) bool: a landmark may be made from it, and is then solved for with it."""
        return (self.use == USES[DepthUse.FACTOR]) | (self.use == USES[DepthUse.HELD])


def points(params: Depth, window: WindowState, tracks: Tracks, inv_depth: np.ndarray) -> DepthPoints | None:
    """Every track with the current poses and its inverse depth (T,), NaN without; None without a depth camera.

    A factor whose depth disagrees with the estimate by more than `max_chi2` does not count.  When most of them do, it
    is the estimate that is wrong, and all count.
    """
    if tracks.depth_m is None:
        return None
    k = {"trust": 1, "confirm": 2, "hold": params.frames}[params.variant]
    first, T = tracks.start[:-1], len(tracks.ids)
    depth, disagreement, use = np.full(T, np.nan), np.full(T, np.nan), np.full(T, NONE)
    measured = ~np.isnan(tracks.depth_m)
    anchored = measured[first]
    depth[anchored], use[anchored] = tracks.depth_m[first[anchored]], USES[DepthUse.WAITING]

    complete = np.flatnonzero(anchored & (tracks.count >= k))
    complete = complete[measured[first[complete, None] + np.arange(k)].all(1)]
    use[complete] = USES[DepthUse.HELD if params.variant == "hold" else DepthUse.FACTOR]
    if k > 1:
        mean, disagreement[complete] = _mean(params.sigma, window, tracks, first[complete, None] + np.arange(k))
        depth[complete] = mean
        apart = ~((disagreement <= params.max_disagreement) & (depth > 0))
        use[complete[apart[complete]]] = USES[DepthUse.UNSTEADY]

    factor = use == USES[DepthUse.FACTOR]
    with np.errstate(invalid="ignore"):
        off = factor & (((depth * inv_depth - 1.0) / params.sigma) ** 2 > params.max_chi2)  # False for NaN
    if 2 * np.count_nonzero(off) <= np.count_nonzero(factor & ~np.isnan(inv_depth)):
        use[off] = USES[DepthUse.GATED]
    return DepthPoints(depth, disagreement, use)


def _mean(sigma: float, window: WindowState, tracks: Tracks, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth along z of the first of the observations `rows` (n, k) of n tracks, and their disagreement."""
    assert tracks.depth_m is not None
    rays, slots = tracks.rays[rows], tracks.slots[rows]
    x_c = rays / rays[..., 2:] * tracks.depth_m[rows][..., None]  # (n, k, 3)
    T_w_c = _cameras(window)
    x_w = np.einsum("nkij,nkj->nki", T_w_c[slots, :3, :3], x_c) + T_w_c[slots, :3, 3]
    mean = x_w.mean(1)
    apart = np.linalg.norm(x_w - mean[:, None], axis=2) / (sigma * np.linalg.norm(x_c, axis=2))
    z = se3.transform(se3.inverse(T_w_c)[slots[:, 0]], mean)[:, 2]
    return z, np.sqrt((apart**2).sum(1) / (rows.shape[1] - 1))


def factors(params: Depth, seen: DepthPoints, usable: np.ndarray) -> Depths:
    """Those of the `usable` tracks (T,) bool, which become the landmarks of a problem."""
    landmark = np.cumsum(usable) - 1
    pulls, held = (usable & (seen.use == USES[use]) for use in (DepthUse.FACTOR, DepthUse.HELD))
    return Depths(landmark[pulls], seen.depth_m[pulls], params.sigma, landmark[held])


def forget_unsteady(window: WindowState, tracks: Tracks, seen: DepthPoints, unknown: np.ndarray) -> WindowState:
    """Without the first observation of the `unknown` tracks (T,) bool whose first frames disagree (seed 000.3.2)."""
    gone = unknown & (seen.use == USES[DepthUse.UNSTEADY])
    if not gone.any():
        return window
    frames = list(window.frames)
    for slot in np.unique(tracks.anchor[gone]).tolist():
        frames[slot] = _without(frames[slot], tracks.ids[gone & (tracks.anchor == slot)])
    return replace(window, frames=tuple(frames))


def _without(frame: WindowFrame, ids: np.ndarray) -> WindowFrame:
    o = frame.observations
    kept = ~np.isin(o.ids, ids)
    depth_m = None if o.depth_m is None else o.depth_m[kept]
    left = replace(
        o, ids=o.ids[kept], rays=o.rays[kept], uv_px=o.uv_px[kept], velocity=o.velocity[kept], depth_m=depth_m
    )
    return replace(frame, observations=left)


def report(params: Depth, window: WindowState, solved: WindowState, assembly: Assembly) -> DepthReport | None:
    """What the depths of `window`, as it went into the solve, say beside the `solved` one; None without depths."""
    tracks, table = assembly.tracks, solved.landmarks
    row = np.searchsorted(table.ids, tracks.ids)
    before = np.where(window.landmarks.status[row] != OUTLIER, window.landmarks.inv_depth[row], np.nan)
    seen = points(params, window, tracks, before)
    if seen is None or tracks.depth_m is None:
        return None
    inv_depth = np.where(table.status[row] != OUTLIER, table.inv_depth[row], np.nan)
    at = seen.use != NONE
    T_w_c = _cameras(solved)
    is_new = (tracks.slots == len(window.frames) - 1) & ~np.isnan(tracks.depth_m)
    track = tracks.track[is_new]
    anchor = tracks.anchor[track]
    x_w = se3.transform(T_w_c[anchor], inverse_depth.point(tracks.rays[tracks.start[track]], inv_depth[track]))
    z = se3.transform(se3.inverse(T_w_c[-1]), x_w)[:, 2]
    found = DepthReport(
        params.sigma,
        tracks.ids[at],
        seen.depth_m[at].astype(np.float32),
        (1.0 / inv_depth[at]).astype(np.float32),
        seen.disagreement[at].astype(np.float32),
        seen.use[at],
        tracks.ids[track],
        tracks.depth_m[is_new].astype(np.float32),
        np.where(z > 0, z, np.nan).astype(np.float32),
        (),
    )
    return replace(found, gates=_gates(params, found))


def _gates(params: Depth, found: DepthReport) -> tuple[Gate, ...]:
    """Advice: does the depth camera agree with what everything else says?"""
    limit = np.sqrt(params.max_chi2)
    shares = []
    for error in (found.error_sigma, found.seen_error_sigma):
        known = ~np.isnan(error)
        shares.append(float(np.mean(np.abs(error[known]) <= limit)) if known.any() else None)
    names = ("depths agree at the anchors", "depths agree in this frame")
    return tuple(Gate(name, share, ">=", 0.8, decides=False) for name, share in zip(names, shares))


def _cameras(window: WindowState) -> np.ndarray:
    """T_w_c of every slot, (n, 4, 4)."""
    q, p = np.array([f.q_w_b for f in window.frames]), np.array([f.p_w_b for f in window.frames])
    return se3.from_quaternion_translation(q, p) @ window.T_b_c[0]
