"""The same points in the image that a second camera took at the same time (REFERENCE TF6).

Flow goes from left to right over the full pyramid, from where a far point would appear, and back.  Between calibrated
cameras a match must also lie on the epipolar line of its point, which VINS-Fusion does not ask: with T_c1_c0 = [R t],

    ray_1' E ray_0 = 0,     E = [t]x R.

A track without a match stays what it is with one camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import se3, so3
from ..params import Frontend
from ..report import RIGHT_LOSSES, Gate, RightLoss
from ..sensors import CameraCalibration, ImageRef, ImageSource
from ..window.state import Observations
from .images import check_size, equalized
from .ledger import KEPT, TrackLedger
from .reject import epipolar_distance_px
from .state import TrackerState
from .track import there_and_back

FATES = {loss: np.uint8(i) for i, loss in enumerate(RIGHT_LOSSES)}


@dataclass(frozen=True)
class Matches:
    """What the second camera sees of the tracks alive, row by row."""

    uv_px: np.ndarray  # (n, 2) float32, where each was looked for last
    rays: np.ndarray  # (n, 3) unit rays in the second camera
    velocity: np.ndarray  # (n, 2) float32, d(x/z, y/z)/dt since the last frame, 1/s; 0 for those not seen there
    fate: np.ndarray  # (n,) uint8, KEPT or an index into RIGHT_LOSSES

    @property
    def found(self) -> np.ndarray:
        """(n,) bool."""
        return self.fate == KEPT

    def reported_px(self) -> np.ndarray:
        """(n, 2) float32, NaN where there is no match."""
        return np.where(self.found[:, None], self.uv_px, np.float32(np.nan))

    def observations(self, ids: np.ndarray) -> Observations:
        """The matches of the tracks `ids` (n,)."""
        seen = self.found
        return Observations(ids[seen], self.rays[seen], self.uv_px[seen], self.velocity[seen])

    def gate(self, params: Frontend) -> Gate:
        share = float(self.found.mean()) if len(self.fate) else None
        limit, knob = params.min_stereo_share, "frontend.min_stereo_share"
        return Gate("stereo matches", share, ">=", limit, knob, decides=False)


def match(
    params: Frontend,
    cameras: tuple[CameraCalibration, CameraCalibration],
    images: ImageSource,
    tracks: TrackLedger,
    before: TrackerState,
    pair: tuple[ImageRef, ImageRef | None],
) -> Matches:
    """Find every track of the left image in the right one; none where that image is missing.

    `before`: as the last frame left it.
    """
    left, right = cameras
    if pair[1] is None or not len(tracks):
        n = len(tracks)
        fate = np.full(n, FATES[RightLoss.NO_IMAGE], np.uint8)
        return Matches(np.full((n, 2), np.nan, np.float32), np.full((n, 3), np.nan), np.zeros((n, 2), np.float32), fate)
    image_0, image_1 = (equalized(images, ref, params) for ref in pair if ref is not None)
    check_size(image_1, right, pair[1])
    T_c1_c0 = se3.inverse(right.T_b_c) @ left.T_b_c

    def look(rows: np.ndarray, inv_depth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels, rays and fates of some of the tracks, looked for where they would be at such inverse depths."""
        from_px, rays_0 = tracks.uv_px[rows], tracks.rays[rows]
        guess_px = right.model.project(rays_0 @ T_c1_c0[:3, :3].T + (inv_depth * rays_0[:, 2])[:, None] * T_c1_c0[:3, 3])
        guess_px = np.where(np.isfinite(guess_px), guess_px, from_px).astype(np.float32)
        uv_px, fate = there_and_back(image_0, image_1, from_px, params, params.klt_levels, guess_px)
        rays_1 = right.model.lift(uv_px)
        fate[(fate == KEPT) & ~np.isfinite(rays_1).all(1)] = FATES[RightLoss.BORDER]
        found = np.flatnonzero(fate == KEPT)
        off = epipolar_distance_px(E, rays_0[found], rays_1[found]) > params.stereo_epipolar_px
        fate[found[off]] = FATES[RightLoss.EPIPOLAR]
        return uv_px, rays_1, fate

    E = so3.skew(T_c1_c0[:3, 3]) @ T_c1_c0[:3, :3]
    uv_px, rays, fate = look(np.arange(len(tracks)), np.zeros(len(tracks)))
    found, missing = np.flatnonzero(fate == KEPT), np.flatnonzero(fate != KEPT)
    if len(found) and len(missing):
        apart = np.square(tracks.uv_px[missing, None] - tracks.uv_px[found]).sum(2)
        inv_depth = _inverse_depth(T_c1_c0, tracks.rays[found], rays[found])[apart.argmin(1)]
        uv_px[missing], rays[missing], fate[missing] = look(missing, inv_depth)
    return Matches(uv_px, rays, _velocity(tracks.ids, rays, fate == KEPT, before, pair[0].t_ns), fate)


def _inverse_depth(T_c1_c0: np.ndarray, rays_0: np.ndarray, rays_1: np.ndarray) -> np.ndarray:
    """(n,) 1/m along z of the first camera, never below 0: where R f_0 / f_0.z + t / z is nearest to parallel to f_1."""
    far, near = np.cross(rays_1, (rays_0 / rays_0[:, 2:]) @ T_c1_c0[:3, :3].T), np.cross(rays_1, T_c1_c0[:3, 3])
    return np.maximum(-(far * near).sum(1) / np.maximum((near * near).sum(1), 1e-12), 0.0)


def _velocity(ids: np.ndarray, rays: np.ndarray, found: np.ndarray, before: TrackerState, t_ns: int) -> np.ndarray:
    velocity, earlier = np.zeros((len(ids), 2), np.float32), before.right
    if earlier is None or before.image is None or t_ns <= before.image.t_ns:
        return velocity
    _, now, then = np.intersect1d(ids, earlier.ids, assume_unique=True, return_indices=True)
    both = found[now] & (rays[now, 2] * earlier.rays[then, 2] > 0)
    now, then = now[both], then[both]
    moved = rays[now, :2] / rays[now, 2:] - earlier.rays[then, :2] / earlier.rays[then, 2:]
    velocity[now] = moved / ((t_ns - before.image.t_ns) * 1e-9)
    return velocity
