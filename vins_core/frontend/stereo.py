"""The same points in the image that a second camera took at the same time (REFERENCE TF6).

Flow goes from left to right and back, as in VINS-Fusion, but not from nowhere: a near point is shifted by many times
what a small window can follow, and it is the near points that a pair of images says most about.  Calibrated cameras
turn a depth into a place in the right image, so a track is looked for at the depth that it had in the frame before, on
a flat pyramid; one without, or not found there, at that of the nearest match, over the full pyramid.  Where nothing is
known at all, the search begins at infinity and comes nearer step by step.

A match must also lie on the epipolar line of its point, which VINS-Fusion does not ask: with T_c1_c0 = [R t],

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

SHIFTS_RAD = np.array([0.0, 0.1, 0.2, 0.3])
"""By how much a point is shifted between the images where a search begins; flow reaches half of a step by itself."""

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
        """(n, 2) float32, where a track was found, also where that was refused; NaN elsewhere."""
        placed = np.isin(self.fate, (KEPT, FATES[RightLoss.FLOW_BACK], FATES[RightLoss.EPIPOLAR]))
        return np.where(placed[:, None], self.uv_px, np.float32(np.nan))

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
    search = _Search(params, right, T_c1_c0, image_0, image_1, tracks.uv_px, tracks.rays)
    known, inv_depth = _known_depths(tracks.ids, before, T_c1_c0)
    search.look(known, inv_depth, params.predict_levels)
    if not len(known):
        for anywhere in _start_depths(T_c1_c0):
            search.look_again(np.full(len(tracks), anywhere))
    search.look_again(search.depths_nearby())
    found = search.fate == KEPT
    velocity = _velocity(tracks.ids, search.rays_1, found, before, pair[0].t_ns)
    return Matches(search.uv_1_px, search.rays_1, velocity, search.fate)


class _Search:
    """Where tracks are in the right image, filled in by one attempt after the other."""

    def __init__(
        self,
        params: Frontend,
        right: CameraCalibration,
        T_c1_c0: np.ndarray,
        image_0: np.ndarray,
        image_1: np.ndarray,
        uv_px: np.ndarray,
        rays: np.ndarray,
    ):
        self._params, self._right, self._T_c1_c0 = params, right, T_c1_c0
        self._images, self._uv_px, self._rays = (image_0, image_1), uv_px, rays
        self._E = so3.skew(T_c1_c0[:3, 3]) @ T_c1_c0[:3, :3]
        self.uv_1_px, self.rays_1 = np.full((len(uv_px), 2), np.nan, np.float32), np.full((len(uv_px), 3), np.nan)
        self.fate = np.full(len(uv_px), FATES[RightLoss.FLOW], np.uint8)

    def look(self, rows: np.ndarray, inv_depth: np.ndarray, levels: int) -> None:
        """Some of the tracks, from where they would be at such inverse depths."""
        if not len(rows):
            return
        from_px, rays_0 = self._uv_px[rows], self._rays[rows]
        R, t = self._T_c1_c0[:3, :3], self._T_c1_c0[:3, 3]
        guess_px = self._right.model.project(rays_0 @ R.T + (inv_depth * rays_0[:, 2])[:, None] * t)
        guess_px = np.where(np.isfinite(guess_px), guess_px, from_px).astype(np.float32)
        uv_px, fate = there_and_back(*self._images, from_px, self._params, levels, guess_px)
        rays_1 = self._right.model.lift(uv_px)
        fate[(fate == KEPT) & ~np.isfinite(rays_1).all(1)] = FATES[RightLoss.BORDER]
        found = np.flatnonzero(fate == KEPT)
        off = epipolar_distance_px(self._E, rays_0[found], rays_1[found]) > self._params.stereo_epipolar_px
        fate[found[off]] = FATES[RightLoss.EPIPOLAR]
        self.uv_1_px[rows], self.rays_1[rows], self.fate[rows] = uv_px, rays_1, fate

    def look_again(self, inv_depth: np.ndarray) -> None:
        """Those of all tracks that are not found yet, over the full pyramid."""
        missing = np.flatnonzero(self.fate != KEPT)
        self.look(missing, inv_depth[missing], self._params.klt_levels)

    def depths_nearby(self) -> np.ndarray:
        """For every track the inverse depth of the nearest match in the left image; infinity without any."""
        found = np.flatnonzero(self.fate == KEPT)
        if not len(found):
            return np.zeros(len(self.fate))
        apart = np.square(self._uv_px[:, None] - self._uv_px[found]).sum(2)
        return inverse_depths(self._T_c1_c0, self._rays[found], self.rays_1[found])[apart.argmin(1)]


def _start_depths(T_c1_c0: np.ndarray) -> np.ndarray:
    """Inverse depths at which a search without any clue begins: at infinity, then nearer and nearer."""
    baseline_m = float(np.linalg.norm(T_c1_c0[:3, 3]))
    return SHIFTS_RAD / baseline_m if baseline_m > 0 else SHIFTS_RAD[:1]


def _known_depths(ids: np.ndarray, before: TrackerState, T_c1_c0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the tracks the last frame's pair saw, and their inverse depths there."""
    if before.right is None or not len(before.right):
        return np.zeros(0, np.int64), np.zeros(0)
    _, rows, then = np.intersect1d(ids, before.right.ids, assume_unique=True, return_indices=True)
    rays_0 = before.rays[np.searchsorted(before.ids, ids[rows])]
    return rows, inverse_depths(T_c1_c0, rays_0, before.right.rays[then])


def inverse_depths(T_c1_c0: np.ndarray, rays_0: np.ndarray, rays_1: np.ndarray) -> np.ndarray:
    """(n,) 1/m along z of the first camera from unit rays in both (n, 3), never below 0.

    The lambda for which R f_0 / f_0.z + lambda t comes closest to being parallel to f_1.
    """
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
