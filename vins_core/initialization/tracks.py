"""The tracks of the window as a dense table, which is what structure from motion asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..window.state import WindowFrame
from .bundle import Rays


@dataclass(frozen=True)
class TrackTable:
    ids: np.ndarray  # (M,) int64, increasing
    rays: np.ndarray  # (M, K, 3) unit rays, NaN where a frame does not see a track

    @staticmethod
    def of(frames: Sequence[WindowFrame]) -> TrackTable:
        ids = np.unique(np.concatenate([f.observations.ids for f in frames]))
        rays = np.full((len(ids), len(frames), 3), np.nan)
        for k, frame in enumerate(frames):
            rays[np.searchsorted(ids, frame.observations.ids), k] = frame.observations.rays
        return TrackTable(ids, rays)

    @property
    def n_frames(self) -> int:
        return self.rays.shape[1]

    @property
    def seen(self) -> np.ndarray:
        """(M, K) bool."""
        return ~np.isnan(self.rays[:, :, 0])

    def common(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Corresponding rays (n, 3) of frames i and j."""
        both = self.seen[:, i] & self.seen[:, j]
        return self.rays[both, i], self.rays[both, j]

    def observations(self, rows: np.ndarray) -> Rays:
        """What all frames see of the tracks in `rows`, which become points 0, 1, ..."""
        point, frame = np.nonzero(self.seen[rows])
        return Rays(frame, point, self.rays[rows][point, frame])
