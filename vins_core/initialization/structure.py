"""Structure from motion over the window, up to scale (REFERENCE N4-N6, seeds 000.2.2 and 004.14).

The frame of reference is the camera of the reference frame l.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry import se3
from ..geometry.pnp import solve_pnp
from ..geometry.triangulation import triangulate_pair
from ..params import Init
from ..report import Gate, InitStage, all_pass
from ..window.keyframe import FOCAL_460
from ..window.state import WindowFrame
from .bundle import Adjustment, Structure, adjust
from .motion import Reference
from .tracks import TrackTable

MIN_PARALLAX_RAD = np.deg2rad(0.2)
"""Rays closer to parallel than this place no point."""


@dataclass(frozen=True)
class Reconstruction:
    Ts_l_c: np.ndarray  # (K, 4, 4) cameras of the window
    rows: np.ndarray  # (P,) rows of the track table that have a point
    points: np.ndarray  # (P, 3)
    rms_rad: float  # reprojection error


def reconstruct(
    params: Init, tracks: TrackTable, reference: Reference, sigma_rad: float, max_error_rad: float
) -> tuple[Reconstruction | None, InitStage]:
    """Places every frame of the window and its points, then adjusts all of them together.

    Points whose mean error stays above `max_error_rad` are dropped and the rest adjusted again.
    """
    chain = _chain(tracks, reference, sigma_rad, params.min_pnp_points)
    Ts, points = chain.Ts_l_c, chain.points
    gates: tuple[Gate, ...] = _points_gates(params, chain.fewest_known, chain.fewest_agreeing)
    if chain.lost_slot is not None:
        why = (
            f"the frame in slot {chain.lost_slot} could not be placed: "
            f"it sees {chain.fewest_known} known points, {chain.fewest_agreeing} agree on a pose"
        )
        return None, InitStage("structure", gates, why)

    rows = np.flatnonzero(~np.isnan(points[:, 0]))
    adjusted = _adjust(tracks, rows, Structure(Ts[:, :3, 3], Ts[:, :3, :3], points[rows]), reference, sigma_rad)
    good = _mean_error(tracks, rows, adjusted) <= max_error_rad
    share = float(np.mean(good)) if len(good) else 0.0
    iterations = adjusted.iterations
    if 0.0 < share < 1.0:
        rows, s = rows[good], adjusted.structure
        adjusted = _adjust(tracks, rows, Structure(s.p, s.R, s.points[good]), reference, sigma_rad)
        iterations += adjusted.iterations
    rms_px = FOCAL_460 * adjusted.rms_rad
    cost_decides = not adjusted.converged
    gates += (
        Gate("consistent_points", share, ">=", params.min_consistent_share, "init.min_consistent_share"),
        Gate("reprojection", rms_px, "<=", params.max_reprojection_px, "init.max_reprojection_px", "px460"),
        Gate("cost", adjusted.cost, "<=", params.max_structure_cost, "init.max_structure_cost", decides=cost_decides),
    )
    outcome = ""
    if not all_pass(gates):
        outcome = (
            f"poses and points miss the tracks by {rms_px:.1f} px, {100 * share:.0f} % of the points fit: "
            "moving objects, wrong intrinsics, or a wrong relative pose"
        )
    stage = InitStage("structure", gates, outcome, {"points": float(len(rows)), "iterations": float(iterations)})
    s = adjusted.structure
    built = Reconstruction(se3.from_rotation_translation(s.R, s.p), rows, s.points, adjusted.rms_rad)
    return (built if stage.passed else None), stage


def place_between(
    params: Init,
    tracks: TrackTable,
    built: Reconstruction,
    window: Sequence[WindowFrame],
    history: Sequence[WindowFrame],
    sigma_rad: float,
) -> tuple[np.ndarray | None, InitStage]:
    """N6: camera poses (F, 4, 4) of all frames in time; those the window did not keep by PnP on its points."""
    slots = {f.frame: k for k, f in enumerate(window)}
    ids = tracks.ids[built.rows]
    Ts = np.empty((len(history), 4, 4))
    known, agreeing = [], []
    for k, frame in enumerate(history):
        if frame.frame in slots:
            Ts[k] = built.Ts_l_c[slots[frame.frame]]
            continue
        _, i, j = np.intersect1d(frame.observations.ids, ids, assume_unique=True, return_indices=True)
        pnp = solve_pnp(built.points[j], frame.observations.rays[i], Ts[k - 1], 2.0 * sigma_rad)
        known.append(len(i))
        agreeing.append(pnp.n_inliers if pnp else 0)
        if pnp is None or agreeing[-1] < params.min_pnp_points:
            why = (
                f"frame {frame.frame}, which the window did not keep, could not be placed: "
                f"it sees {known[-1]} known points, {agreeing[-1]} agree on a pose"
            )
            gates = _points_gates(params, known[-1], agreeing[-1])
            return None, InitStage("frames between", gates, why, {"frames": float(len(known))})
        Ts[k] = pnp.T_w_c
    gates = _points_gates(params, min(known), min(agreeing)) if known else ()
    return Ts, InitStage("frames between", gates, "", {"frames": float(len(known))})


def _points_gates(params: Init, known: int, agreeing: int) -> tuple[Gate, ...]:
    return tuple(
        Gate(name, n, ">=", params.min_pnp_points, "init.min_pnp_points")
        for name, n in (("known_points", known), ("agreeing_points", agreeing))
    )


@dataclass
class _Chain:
    """First poses and points; the frame that placing stopped at, if any."""

    Ts_l_c: np.ndarray  # (K, 4, 4)
    points: np.ndarray  # (M, 3), NaN unknown
    fewest_known: int  # points that a frame saw
    fewest_agreeing: int  # points that agreed on its pose
    lost_slot: int | None = None


def _chain(tracks: TrackTable, reference: Reference, sigma_rad: float, min_points: int) -> _Chain:
    """Place the frames one after the other.

    Triangulate l with the newest; forward from l: PnP, triangulate with the newest; triangulate l with the frames in
    between; backward from l: PnP, triangulate with l; the remaining tracks from their first and last observation.
    """
    seen, l, newest, n = tracks.seen, reference.slot, tracks.n_frames - 1, len(tracks.ids)
    chain = _Chain(np.tile(np.eye(4), (newest + 1, 1, 1)), np.full((n, 3), np.nan), n, n)
    Ts, points = chain.Ts_l_c, chain.points
    Ts[newest] = reference.pose.T_a_b

    def extend(i: int, j: int, among: np.ndarray) -> None:
        new = among & seen[:, i] & seen[:, j] & np.isnan(points[:, 0])
        points[new] = _triangulate(Ts[i], Ts[j], tracks.rays[new, i], tracks.rays[new, j])

    def place(k: int, neighbour: int) -> bool:
        known = seen[:, k] & ~np.isnan(points[:, 0])
        pnp = solve_pnp(points[known], tracks.rays[known, k], Ts[neighbour], 2.0 * sigma_rad)
        agreeing = pnp.n_inliers if pnp else 0
        chain.fewest_known = min(chain.fewest_known, int(np.count_nonzero(known)))
        chain.fewest_agreeing = min(chain.fewest_agreeing, agreeing)
        if pnp is None or agreeing < min_points:
            chain.lost_slot = k
            return False
        Ts[k] = pnp.T_w_c
        return True

    every = np.ones(n, bool)
    for k in range(l, newest):
        if k > l and not place(k, k - 1):
            return chain
        extend(k, newest, every)
    for k in range(l + 1, newest):
        extend(l, k, every)
    for k in reversed(range(l)):
        if not place(k, k + 1):
            return chain
        extend(k, l, every)
    first, last = np.argmax(seen, 1), newest - np.argmax(seen[:, ::-1], 1)
    for i, j in sorted(set(zip(first.tolist(), last.tolist()))):
        if i < j:
            extend(i, j, (first == i) & (last == j))
    return chain


def _triangulate(T_w_i: np.ndarray, T_w_j: np.ndarray, rays_i: np.ndarray, rays_j: np.ndarray) -> np.ndarray:
    """(n, 3) points seen by two cameras; NaN behind a camera or without parallax."""
    points = triangulate_pair(se3.inverse(T_w_i), se3.inverse(T_w_j), rays_i, rays_j)
    usable = np.linalg.norm(np.cross(rays_i @ T_w_i[:3, :3].T, rays_j @ T_w_j[:3, :3].T), axis=1) > MIN_PARALLAX_RAD
    for T, rays in ((T_w_i, rays_i), (T_w_j, rays_j)):
        usable &= np.sum(se3.transform(se3.inverse(T), points) * rays, axis=1) > 0
    return np.where(usable[:, None], points, np.nan)


def _adjust(
    tracks: TrackTable, rows: np.ndarray, structure: Structure, reference: Reference, sigma_rad: float
) -> Adjustment:
    return adjust(structure, tracks.observations(rows), reference.slot, tracks.n_frames - 1, sigma_rad)


def _mean_error(tracks: TrackTable, rows: np.ndarray, adjusted: Adjustment) -> np.ndarray:
    """(P,) rad."""
    point = np.nonzero(tracks.seen[rows])[0]
    return np.bincount(point, adjusted.error_rad, len(rows)) / np.bincount(point, minlength=len(rows))
