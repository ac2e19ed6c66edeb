"""A keyframe as the loop stage keeps it, and the store of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np

from ..geometry import inverse_depth, se3
from ..geometry.camera import CameraModel
from ..window.assemble import tracks_of
from ..window.landmarks import camera_poses
from ..window.state import TRIANGULATED, WindowState
from ..window.timing import seen_at
from .consistency import Node
from .describe import Describer
from .index import InvertedIndex
from .vocabulary import BagOfWords, Vocabulary


@dataclass(frozen=True)
class LoopKeyframe:
    """Points and pose of one keyframe; immutable.

    Its points are, in this order: `n_landmarks` tracks whose position the window knows, the other tracks, FAST corners.
    Positions and pose are those of the window when the keyframe was chosen, in the odometry's world (REFERENCE L1).
    """

    frame: int
    t_ns: int
    T_w_b: np.ndarray  # (7,) p and q wxyz
    T_b_c: np.ndarray  # (4, 4)
    track_ids: np.ndarray  # (tracks,) int64, of the first points
    points_w: np.ndarray  # (n_landmarks, 3) m
    uv_px: np.ndarray  # (n, 2) float32
    rays: np.ndarray  # (n, 3) float32, unit rays in the camera
    descriptors: np.ndarray  # (n, 32) uint8
    bag: BagOfWords
    odometry: np.ndarray | None = None
    """(6, 6) covariance of T_previous_this, the motion since the keyframe before this one, as the window knew it;
    tangent (dp, dtheta): p + dp, q * Exp(dtheta).  None where no odometry joins them: at the start of a session."""
    node: Node | None = None
    """Where consistency has it; from when it is remembered on (step.py)."""

    @property
    def n_landmarks(self) -> int:
        return len(self.points_w)

    @property
    def T_w_c(self) -> np.ndarray:
        """(4, 4)"""
        return se3.from_quaternion_translation(self.T_w_b[3:], self.T_w_b[:3]) @ self.T_b_c


def describe_keyframe(
    window: WindowState,
    slot: int,
    camera: CameraModel,
    image: np.ndarray,
    describer: Describer,
    vocabulary: Vocabulary,
    max_corners: int,
    usable: np.ndarray | None = None,
) -> LoopKeyframe:
    """The keyframe in a slot of the window; `image` is its image as recorded.

    Landmarks are the tracks it sees that are triangulated and anchored in an earlier slot (REFERENCE L1).
    Raises VocabularyError when the vocabulary was made for other descriptors.
    """
    vocabulary.require(describer.name)
    frame = window.frames[slot]
    ids, points_w = landmarks_seen(window, slot)
    seen = seen_at(frame, window.td_s)
    known = np.searchsorted(seen.ids, ids)
    order = np.concatenate([known, np.setdiff1d(np.arange(len(seen)), known)])
    features = describer(image, seen.uv_px[order], max_corners, usable)
    in_view = np.isfinite(camera.lift(features.uv_px)).all(1)  # tracks always are: they live where the lens shows it
    uv_px = features.uv_px[in_view]
    return LoopKeyframe(
        frame.frame,
        frame.t_ns,
        np.concatenate([frame.p_w_b, frame.q_w_b]),
        window.T_b_c[0],
        seen.ids[order],
        points_w,
        uv_px,
        camera.lift(uv_px).astype(np.float32),
        features.descriptors[in_view],
        vocabulary.bag_of(features.descriptors[in_view]),
    )


def landmarks_seen(window: WindowState, slot: int) -> tuple[np.ndarray, np.ndarray]:
    """Ids (n,) and positions (n, 3) of the landmarks that the frame in `slot` sees, increasing in id."""
    tracks, table = tracks_of(window), window.landmarks
    row = np.searchsorted(table.ids, tracks.ids)
    inv_depth = np.where(table.status[row] == TRIANGULATED, table.inv_depth[row], np.nan)
    usable = (inv_depth > 0) & (tracks.anchor < slot)
    usable &= np.isin(tracks.ids, window.frames[slot].observations.ids, assume_unique=True)
    rays = tracks.rays[tracks.start[:-1]][usable]
    points_c = inverse_depth.point(rays, inv_depth[usable])
    return tracks.ids[usable], se3.transform(camera_poses(window)[tracks.anchor[usable]], points_c)


class Keyframes(Sequence[LoopKeyframe]):
    """A list that only grows, shared by all states of a run: each of them refers to a beginning of it.

    `earlier`: keyframes that come before its own, wherever they are kept (a record, a loaded map).
    Its inverted index is derived: made when it is asked for, and kept for the newest length that was; `known` may be
    one of the first of them.
    """

    def __init__(self, earlier: Sequence[LoopKeyframe] = (), known: InvertedIndex | None = None) -> None:
        self._earlier, self._n_earlier = earlier, len(earlier)
        self._own: list[LoopKeyframe] = []
        self._index = known or InvertedIndex()
        self._lock = Lock()

    @property
    def known(self) -> InvertedIndex:
        """The index as far as it has been made."""
        return self._index

    def __len__(self) -> int:
        return self._n_earlier + len(self._own)

    def __getitem__(self, k):
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        if k < 0:
            k += len(self)
        return self._earlier[k] if k < self._n_earlier else self._own[k - self._n_earlier]

    def extended(self, n: int, keyframe: LoopKeyframe) -> Keyframes:
        """The first n and one more: this list itself when it has no others, else a list of its own (a fork)."""
        with self._lock:
            if n == len(self):
                self._own.append(keyframe)
                return self
        fork = Keyframes(_Beginning(self, n))
        fork._own.append(keyframe)
        return fork

    def inverted(self, n: int) -> InvertedIndex:
        """The inverted index of the first n."""
        with self._lock:
            known = self._index if len(self._index) <= n else InvertedIndex()
            if len(known) == 0 and n > 1:
                known = InvertedIndex.of([self[k].bag for k in range(n)])
            while len(known) < n:
                known = known.add(self[len(known)].bag)
            if n >= len(self._index):
                self._index = known
            return known


class _Beginning(Sequence[LoopKeyframe]):
    """The first n of others."""

    def __init__(self, of: Sequence[LoopKeyframe], n: int) -> None:
        self._of, self._n = of, n

    def __len__(self) -> int:
        return self._n

    def __getitem__(self, k):
        return self._of[: self._n][k] if isinstance(k, slice) else self._of[k]
