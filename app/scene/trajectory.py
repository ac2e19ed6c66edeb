"""The estimate up to the frame shown and beyond it, and the aligned truth, dashed."""

from __future__ import annotations

import numpy as np
import viser

from .. import palette
from .frame import SceneFrame
from .nodes import Segments

MAX_SEGMENTS = 1500
DASH_UNITS = 0.05
FUTURE = (45, 91, 118)


class TrajectoryLayer:
    toggles = {"trajectory.estimate": "estimate", "trajectory.truth": "ground truth"}  # noqa: RUF012

    def __init__(self, scene: viser.SceneApi) -> None:
        self._future = Segments(scene, "/trajectory/future", FUTURE, 1.4)
        self._past = Segments(scene, "/trajectory/past", palette.rgb(palette.ESTIMATE), 2.6)
        self._truth = Segments(scene, "/trajectory/truth", palette.rgb(palette.TRUTH), 1.4)
        self._truth_of = (0, -1)  # the run and its frames when the truth was last drawn

    def update(self, frame: SceneFrame) -> None:
        p = frame.series.p_w_b
        self._past.update(polyline(p[: frame.frame + 1]))
        self._future.update(polyline(p[frame.frame :]))
        if self._truth_of != (of := (id(frame.run), len(p))):
            self._truth_of = of
            self._truth.update(dashes(frame.series.truth_p, DASH_UNITS * frame.unit_m))

    def show(self, toggle: str, on: bool) -> None:
        for node in (self._truth,) if toggle == "trajectory.truth" else (self._past, self._future):
            node.show(on)


def polyline(points: np.ndarray, most: int = MAX_SEGMENTS) -> np.ndarray:
    """(n, 3) -> (m, 2, 3) segments between consecutive points, at most about `most`; NaN rows break the line."""
    stride = max(1, -(-len(points) // most))
    kept = np.arange(0, len(points), stride)
    if len(points) and kept[-1] != len(points) - 1:
        kept = np.append(kept, len(points) - 1)
    segments = np.stack([points[kept[:-1]], points[kept[1:]]], 1) if len(kept) > 1 else np.zeros((0, 2, 3))
    return segments[np.isfinite(segments).all((1, 2))]


def dashes(points: np.ndarray, dash_m: float) -> np.ndarray:
    """(n, 3) -> (m, 2, 3) segments of a dashed line whose dashes and gaps are about `dash_m` long."""
    points = points[np.isfinite(points).all(1)]
    if len(points) < 2:
        return np.zeros((0, 2, 3))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if along[-1] == 0:
        return np.zeros((0, 2, 3))
    per_dash = 4
    count = int(np.clip(along[-1] / (2 * dash_m), 6, MAX_SEGMENTS / per_dash))
    at = np.linspace(0, along[-1], 2 * count * per_dash + 1)
    fine = np.stack([np.interp(at, along, points[:, k]) for k in range(3)], 1)
    segments = np.stack([fine[:-1], fine[1:]], 1)
    return segments[(np.arange(len(segments)) // per_dash) % 2 == 0]
