"""What the layers of the 3D view draw from: one frame of a run, and the sizes that suit its scene."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from vins_core.geometry import se3
from vins_core.report import FrameReport, WindowReport
from vins_core.sensors import CameraCalibration

from ..comparison import OtherRun
from ..context import RunView, Selection
from ..series import RunSeries

if TYPE_CHECKING:
    from ..graph import GraphView
    from ..loops import LoopsView
    from ..uncertainty import Uncertainty

MAX_FRUSTUM_FOV = np.deg2rad(110.0)


@dataclass(frozen=True)
class SceneFrame:
    run: RunView
    frame: int
    report: FrameReport
    selection: Selection
    thumbnail: np.ndarray | None  # (rows, columns, 3) uint8
    passed: np.ndarray  # (m, 3) landmarks that left the window
    unit_m: float  # see `scene_unit`
    other: OtherRun | None = None  # the run compared with
    resolved: WindowReport | None = None  # this frame's window, solved with other parameters
    uncertainty: Uncertainty | None = None  # of this frame's window, once it is worked out
    graph: GraphView | None = None  # the pose graph, once it is worked out
    loops: LoopsView | None = None  # why loops close and do not

    @property
    def series(self) -> RunSeries:
        return self.run.series

    @property
    def camera(self) -> CameraCalibration:
        """Mounted as this frame estimated it, where it did."""
        camera, known = self.run.header.calibration.cameras[0], self.report.calibration
        return camera if known is None else replace(camera, T_b_c=known.T_b_c[0])

    @property
    def second_camera(self) -> CameraCalibration | None:
        return next(iter(self.run.header.calibration.cameras[1:2]), None)

    def second_camera_pose(self) -> np.ndarray | None:
        """(4, 4) T_w_c of the newest frame's second camera; None without one, and without a window."""
        window, camera = self.report.window, self.second_camera
        if window is None or camera is None:
            return None
        known = self.report.calibration
        return window_camera_poses(window, camera.T_b_c if known is None else known.T_b_c[1])[-1]

    def camera_poses(self) -> np.ndarray:
        """(n, 4, 4) T_w_c of the window's frames, none without a window."""
        if self.report.window is None:
            return np.zeros((0, 4, 4))
        return window_camera_poses(self.report.window, self.camera.T_b_c)


class Layer(Protocol):
    """A part of the 3D view: one or several toggles, drawn from a frame."""

    toggles: dict[str, str]  # name -> title of its checkbox

    def update(self, frame: SceneFrame) -> None: ...

    def show(self, toggle: str, on: bool) -> None: ...


def window_camera_poses(window: WindowReport, T_b_c: np.ndarray) -> np.ndarray:
    return se3.from_quaternion_translation(window.q_w_b, window.p_w_b) @ T_b_c


def vertical_fov(camera: CameraCalibration) -> tuple[float, float]:
    """(radians, width over height) of the pyramid that stands for the camera, whatever its model."""
    model = camera.model
    middle = np.array([[model.width / 2, 0.5], [model.width / 2, model.height - 0.5]])
    top, bottom = model.lift(middle)
    fov = float(np.arccos(np.clip(top @ bottom, -1, 1))) if np.isfinite([top, bottom]).all() else MAX_FRUSTUM_FOV
    return min(fov, float(MAX_FRUSTUM_FOV)), model.width / model.height


def scene_unit(report: FrameReport) -> float:
    """Metres that look right for marks in this scene: the median distance from the newest camera to its landmarks."""
    if report.landmarks is None or report.window is None:
        return 3.0
    xyz = report.landmarks.xyz_w
    distance = np.linalg.norm(xyz[np.isfinite(xyz).all(1)] - report.window.p_w_b[-1], axis=1)
    return float(np.clip(np.median(distance), 0.5, 30.0)) if len(distance) else 3.0
