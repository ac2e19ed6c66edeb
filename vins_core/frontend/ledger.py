"""Who is alive and who was lost, and why, while one packet is being worked on: mutable, and local to a `step`."""

from __future__ import annotations

import numpy as np

from ..report import LOSS_REASONS, LossReason
from ..sensors import ImageRef
from ..window.state import Observations
from .state import TrackerState

KEPT = np.uint8(255)
"""The fate of a track that goes on; any other fate is an index into LOSS_REASONS."""
FATES = {reason: np.uint8(i) for i, reason in enumerate(LOSS_REASONS)}


class TrackLedger:
    """Tracks alive, one row each, oldest first and so in order of id; and those lost on the way."""

    def __init__(self, state: TrackerState):
        self.image = state.image
        self.ids, self.uv_px, self.rays, self.age = state.ids, state.uv_px, state.rays, state.age
        self.frame_uv_px = state.frame_uv_px
        self.velocity = np.zeros((len(state.ids), 2), np.float32)  # d(x/z, y/z)/dt, 1/s
        self.next_id = state.next_id
        self._lost = [(self.ids[:0], self.uv_px[:0], self.age[:0], np.zeros(0, np.uint8))]

    def __len__(self) -> int:
        return len(self.ids)

    def end(self, fate: np.ndarray) -> None:
        """Drop all but the KEPT of (n,) uint8; the others were last seen where they are now."""
        kept = fate == KEPT
        if not kept.all():
            self._lost.append((self.ids[~kept], self.uv_px[~kept], self.age[~kept], fate[~kept]))
            for name in ("ids", "uv_px", "rays", "age", "frame_uv_px", "velocity"):
                setattr(self, name, getattr(self, name)[kept])

    def drop(self, gone: np.ndarray, reason: LossReason) -> None:
        """End the tracks in `gone`, (n,) bool."""
        self.end(np.where(gone, FATES[reason], KEPT))

    def move(self, image: ImageRef, uv_px: np.ndarray, rays: np.ndarray) -> None:
        """Every track was found in the next image."""
        if len(self):
            assert self.image is not None
            before, dt_s = self.rays, (image.t_ns - self.image.t_ns) * 1e-9
            same_side = (before[:, 2] * rays[:, 2] > 0)[:, None]  # no velocity for what crosses z = 0
            with np.errstate(divide="ignore", invalid="ignore"):
                velocity = (rays[:, :2] / rays[:, 2:] - before[:, :2] / before[:, 2:]) / dt_s
            self.velocity = np.where(same_side, velocity, 0.0).astype(np.float32)
        self.image, self.uv_px, self.rays, self.age = image, uv_px, rays, self.age + np.int32(1)

    def add(self, uv_px: np.ndarray, rays: np.ndarray) -> None:
        """New tracks in the current image, with ids never used before."""
        n = len(uv_px)
        self.ids = np.concatenate([self.ids, np.arange(self.next_id, self.next_id + n, dtype=np.int64)])
        self.uv_px = np.concatenate([self.uv_px, uv_px])
        self.rays = np.concatenate([self.rays, rays])
        self.age = np.concatenate([self.age, np.ones(n, np.int32)])
        self.frame_uv_px = np.concatenate([self.frame_uv_px, np.full((n, 2), np.nan, np.float32)])
        self.velocity = np.concatenate([self.velocity, np.zeros((n, 2), np.float32)])
        self.next_id += n

    def lost(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Ids, last positions, ages and fates of all that were lost, in the order of losing them."""
        ids, uv_px, age, fate = (np.concatenate(column) for column in zip(*self._lost))
        return ids, uv_px, age, fate

    def count_lost(self, reason: LossReason) -> int:
        return sum(int((fate == FATES[reason]).sum()) for *_, fate in self._lost)

    def state_at_frame(self, right: Observations | None = None) -> TrackerState:
        """The state a frame leaves: the next frame's F-RANSAC compares with where the tracks are now."""
        return TrackerState(self.image, self.ids, self.uv_px, self.rays, self.age, self.uv_px, self.next_id, right)

    def observations(self, min_age: int) -> Observations:
        seen = self.age >= min_age
        return Observations(self.ids[seen], self.rays[seen], self.uv_px[seen], self.velocity[seen])
