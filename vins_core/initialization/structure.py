"""Structure from motion over the window, up to scale (REFERENCE N2-N6, seeds 000.2.2 and 004.14).

The frame of reference is the camera of the reference frame l.  `Ts_l_c` are camera poses in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import se3
from ..geometry.pnp import solve_pnp
from ..geometry.triangulation import triangulate_pair
from ..window.state import Observations
from .bundle import Adjustment, Rays, Structure, adjust

MIN_PARALLAX_RAD = np.deg2rad(0.2)
"""Rays closer to parallel than this place no point."""


@dataclass(frozen=True)
class Tracks:
    """All tracks of some frames as a table, NaN where a frame does not see a track."""

    ids: np.ndarray  # (M,) int64, increasing
    rays: np.ndarray  # (M, K, 3)

    @staticmethod
    def of(observations: list[Observations]) -> Tracks:
        ids = np.unique(np.concatenate([o.ids for o in observations]))
        rays = np.full((len(ids), len(observations), 3), np.nan)
        for k, o in enumerate(observations):
            rays[np.searchsorted(ids, o.ids), k] = o.rays
        return Tracks(ids, rays)

    @property
    def seen(self) -> np.ndarray:
        """(M, K) bool."""
        return ~np.isnan(self.rays[:, :, 0])

    def common(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Corresponding rays (n, 3) of frames i and j."""
        both = self.seen[:, i] & self.seen[:, j]
        return self.rays[both, i], self.rays[both, j]


@dataclass(frozen=True)
class Reconstruction:
    """Camera poses and points of the window; `lost_slot` >= 0 when that frame could not be placed."""

    Ts_l_c: np.ndarray  # (K, 4, 4)
    ids: np.ndarray  # (P,) tracks with a point
    points: np.ndarray  # (P, 3) in frame l
    adjustment: Adjustment | None
    min_points: int  # fewest known points any placed frame saw
    lost_slot: int = -1


def reconstruct(tracks: Tracks, l: int, T_l_newest: np.ndarray, sigma_rad: float, min_points: int) -> Reconstruction:
    """Places every frame of the window and its points, then adjusts all of them together.

    Triangulate l - newest; forward from l: PnP, triangulate with the newest; triangulate l with the frames between;
    backward from l: PnP, triangulate with l; the remaining tracks from their first and last observation.
    """
    seen = tracks.seen
    newest = seen.shape[1] - 1
    Ts = np.tile(np.eye(4), (newest + 1, 1, 1))
    Ts[newest] = T_l_newest
    points = np.full((len(tracks.ids), 3), np.nan)
    fewest = len(tracks.ids)

    def extend(i: int, j: int) -> None:
        new = seen[:, i] & seen[:, j] & np.isnan(points[:, 0])
        points[new] = triangulate(Ts[i], Ts[j], tracks.rays[new, i], tracks.rays[new, j])

    def place(k: int, neighbour: int) -> bool:
        nonlocal fewest
        known = seen[:, k] & ~np.isnan(points[:, 0])
        fewest = min(fewest, int(np.count_nonzero(known)))
        pnp = solve_pnp(points[known], tracks.rays[known, k], Ts[neighbour], 2.0 * sigma_rad, min_points)
        if pnp is not None:
            Ts[k] = pnp.T_w_c
        return pnp is not None

    lost = Reconstruction(Ts, tracks.ids[:0], points[:0], None, 0)
    for k in range(l, newest):
        if k > l and not place(k, k - 1):
            return _failed(lost, fewest, k)
        extend(k, newest)
    for k in range(l + 1, newest):
        extend(l, k)
    for k in reversed(range(l)):
        if not place(k, k + 1):
            return _failed(lost, fewest, k)
        extend(k, l)
    first, last = np.argmax(seen, 1), newest - np.argmax(seen[:, ::-1], 1)
    for i, j in sorted(set(zip(first.tolist(), last.tolist()))):
        if i < j:
            new = (first == i) & (last == j) & np.isnan(points[:, 0])
            points[new] = triangulate(Ts[i], Ts[j], tracks.rays[new, i], tracks.rays[new, j])

    known = np.flatnonzero(~np.isnan(points[:, 0]))
    point, frame = np.nonzero(seen[known])
    rays = Rays(frame, point, tracks.rays[known][point, frame])
    adjusted = adjust(Structure(Ts[:, :3, 3], Ts[:, :3, :3], points[known]), rays, l, newest, sigma_rad)
    s = adjusted.structure
    return Reconstruction(se3.from_rotation_translation(s.R, s.p), tracks.ids[known], s.points, adjusted, fewest)


def triangulate(T_w_i: np.ndarray, T_w_j: np.ndarray, rays_i: np.ndarray, rays_j: np.ndarray) -> np.ndarray:
    """(n, 3) points seen by two cameras; NaN behind a camera or without parallax."""
    points = triangulate_pair(se3.inverse(T_w_i), se3.inverse(T_w_j), rays_i, rays_j)
    in_front = [
        np.sum(se3.transform(se3.inverse(T), points) * rays, 1) > 0 for T, rays in ((T_w_i, rays_i), (T_w_j, rays_j))
    ]
    parallax = np.linalg.norm(np.cross(rays_i @ T_w_i[:3, :3].T, rays_j @ T_w_j[:3, :3].T), axis=1)
    return np.where((in_front[0] & in_front[1] & (parallax > MIN_PARALLAX_RAD))[:, None], points, np.nan)


def place_frame(
    observations: Observations, ids: np.ndarray, points: np.ndarray, T_guess: np.ndarray, sigma_rad: float
) -> tuple[np.ndarray | None, int]:
    """Camera pose of a frame outside the window from the points it sees (REFERENCE N6), and how many it saw."""
    _, i, j = np.intersect1d(observations.ids, ids, assume_unique=True, return_indices=True)
    pnp = solve_pnp(points[j], observations.rays[i], T_guess, 2.0 * sigma_rad)
    return (None if pnp is None else pnp.T_w_c), len(i)


def _failed(empty: Reconstruction, fewest: int, slot: int) -> Reconstruction:
    return Reconstruction(empty.Ts_l_c, empty.ids, empty.points, None, fewest, slot)
