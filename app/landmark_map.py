"""The landmarks a run has left behind, frame by frame: what the window saw and marginalised.

A landmark joins the map at the first frame that no longer knows it, where it was last estimated.  The map only
grows, so the map at any frame is a prefix, and stepping backwards is free.
"""

from __future__ import annotations

import numpy as np

from vins_core.report import LANDMARK_STATUSES, FrameReport, LandmarkStatus

_TRIANGULATED = LANDMARK_STATUSES.index(LandmarkStatus.TRIANGULATED)
MAX_POINTS = 20_000
"""More are thinned out when drawn."""


class LandmarkMap:
    """Filled in frame order by `extend`; read by `at`."""

    def __init__(self) -> None:
        self.frames = 0
        self._known: dict[int, np.ndarray] = {}  # id -> (3,), in the newest frame read
        self._points: list[np.ndarray] = []
        self._length: list[int] = []  # per frame: length of the map at it
        self._stacked = np.zeros((0, 3), np.float32)

    def extend(self, report: FrameReport) -> None:
        """Add the next frame; reports come in order, each once."""
        known: dict[int, np.ndarray] = {}
        if report.landmarks is not None:
            good = (report.landmarks.status == _TRIANGULATED) & np.isfinite(report.landmarks.xyz_w).all(1)
            known = dict(zip(report.landmarks.ids[good].tolist(), report.landmarks.xyz_w[good]))
            alive = set(report.landmarks.ids.tolist())
        else:
            alive = set()
        self._points += [xyz for id, xyz in self._known.items() if id not in alive]
        # a landmark that is an outlier or without depth now keeps its last good place until it goes
        self._known = {id: xyz for id, xyz in self._known.items() if id in alive} | known
        self._length.append(len(self._points))
        self.frames += 1

    def at(self, frame: int) -> np.ndarray:
        """(m, 3) float32, the landmarks gone by `frame`; complete once that frame has been read."""
        if not self._length:
            return self._stacked
        n = self._length[min(frame, self.frames - 1)]
        if len(self._stacked) < n:
            self._stacked = np.array(self._points, np.float32).reshape(-1, 3)
        return self._stacked[:n][:: -(-n // MAX_POINTS) or 1]
