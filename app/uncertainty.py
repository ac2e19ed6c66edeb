"""How well a solved window knows its poses and landmarks, as ellipsoids of 3 sigma."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vins_core import examine
from vins_core.geometry import so3
from vins_core.solver.covariance import ellipsoid

from .context import RunView


@dataclass(frozen=True)
class Ellipsoids:
    centres: np.ndarray  # (n, 3) m, in w
    axes: np.ndarray  # (n, 3) half axes, m
    wxyz: np.ndarray  # (n, 4)


@dataclass(frozen=True)
class Uncertainty:
    """Relative to position and yaw of the oldest frame, which nothing measures."""

    poses: Ellipsoids  # one a frame of the window
    landmarks: Ellipsoids
    landmark_ids: np.ndarray  # (m,) track ids of `landmarks`


def uncertainty(run: RunView, frame: int) -> Uncertainty | None:
    """None where the window was not solved, or does not determine its states."""
    known, report = examine.uncertainty(run.reader, frame), run.report(frame)
    if known is None or report.window is None or report.landmarks is None:
        return None
    marks, spread = report.landmarks, known.covariances
    row = {int(id): k for k, id in enumerate(marks.ids)}
    kept = [k for k, id in enumerate(known.ids.tolist()) if id in row]
    kept = [k for k in kept if np.isfinite(spread.landmarks_w[k]).all()]
    ids = known.ids[kept]
    places = marks.xyz_w[[row[int(id)] for id in ids]].astype(float).reshape(-1, 3)
    return Uncertainty(
        _ellipsoids(report.window.p_w_b, spread.poses[:, :3, :3]), _ellipsoids(places, spread.landmarks_w[kept]), ids
    )


def _ellipsoids(centres: np.ndarray, covariance: np.ndarray) -> Ellipsoids:
    if not len(centres):
        return Ellipsoids(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4)))
    axes, turn = ellipsoid(covariance)
    return Ellipsoids(centres, axes, so3.from_matrix(turn))
