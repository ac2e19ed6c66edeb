"""Landmarks by state, each with its own shape and colour."""

from __future__ import annotations

import numpy as np
import viser

from vins_core.report import LANDMARK_STATUSES, LandmarkReport, LandmarkStatus

from .. import palette
from .frame import SceneFrame
from .nodes import Points, PointShape

PASSED = (91, 58, 120)  # the prior's purple, darker: landmarks that left the window recede
STYLES: dict[LandmarkStatus, tuple[PointShape, tuple[int, int, int], float]] = {
    LandmarkStatus.CANDIDATE: ("diamond", palette.rgb(palette.CANDIDATE), 0.012),
    LandmarkStatus.TRIANGULATED: ("circle", palette.rgb(palette.ESTIMATE), 0.0095),
    LandmarkStatus.OUTLIER: ("sparkle", palette.rgb(palette.BAD), 0.02),
    LandmarkStatus.MARGINALIZED: ("square", PASSED, 0.0065),
}
"""Shape, colour, and size as a share of the scene's unit."""


class LandmarkLayer:
    toggles = {f"landmarks.{status}": f"{status} landmarks" for status in STYLES}  # noqa: RUF012

    def __init__(self, scene: viser.SceneApi) -> None:
        self._clouds = {
            status: Points(scene, f"/landmarks/{status}", colour, shape, size)
            for status, (shape, colour, size) in STYLES.items()
        }

    def update(self, frame: SceneFrame) -> None:
        groups = by_status(frame.report.landmarks)
        gone = groups[LandmarkStatus.MARGINALIZED]
        groups[LandmarkStatus.MARGINALIZED] = np.concatenate([frame.passed, gone])
        for status, points in groups.items():
            self._clouds[status].update(points, STYLES[status][2] * frame.unit_m)

    def show(self, toggle: str, on: bool) -> None:
        self._clouds[LandmarkStatus(toggle.removeprefix("landmarks."))].show(on)


def by_status(landmarks: LandmarkReport | None) -> dict[LandmarkStatus, np.ndarray]:
    """(n, 3) positions per status; landmarks without one are left out."""
    if landmarks is None:
        return {status: np.zeros((0, 3), np.float32) for status in STYLES}
    placed = np.isfinite(landmarks.xyz_w).all(1)
    return {
        status: landmarks.xyz_w[placed & (landmarks.status == LANDMARK_STATUSES.index(status))] for status in STYLES
    }
