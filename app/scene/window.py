"""The sliding window: a frustum per frame, the newest with its image, and IMU edges by residual."""

from __future__ import annotations

import numpy as np
import viser

from vins_core.geometry import so3
from vins_core.sensors import CameraCalibration

from .. import palette
from .frame import SceneFrame, vertical_fov
from .nodes import Segments

ODD_SIGMA, BAD_SIGMA = 1.5, 4.0
"""IMU residuals per degree of freedom between which an edge turns from the IMU's colour to that of a failure."""


class WindowLayer:
    toggles = {"window.frustums": "window frustums", "imu.edges": "IMU edges by residual"}  # noqa: RUF012

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._frustums: list[viser.CameraFrustumHandle] = []
        self._newest: viser.CameraFrustumHandle | None = None
        self._second: viser.CameraFrustumHandle | None = None
        self._edges = Segments(scene, "/imu/edges", None, 4.0)
        self._on = True

    def update(self, frame: SceneFrame) -> None:
        T_w_c = frame.camera_poses()
        window = frame.report.window
        self._draw_frustums(frame, T_w_c)
        if window is None or len(T_w_c) < 2:
            self._edges.update(np.zeros((0, 2, 3)), np.zeros((0, 3), np.uint8))
            return
        sigma = frame.report.solve.imu_sigma if frame.report.solve else None
        segments = np.stack([window.p_w_b[:-1], window.p_w_b[1:]], 1)
        self._edges.update(segments, imu_colours(sigma, len(segments)))

    def show(self, toggle: str, on: bool) -> None:
        if toggle == "imu.edges":
            self._edges.show(on)
            return
        self._on = on
        for node in self._frustums:
            node.visible = on
        if self._newest:
            self._newest.visible = on
        if self._second:
            self._second.visible = on

    def _draw_frustums(self, frame: SceneFrame, T_w_c: np.ndarray) -> None:
        n = len(T_w_c)
        while len(self._frustums) < n - 1:
            self._frustums.append(self._frustum(frame.camera, f"/window/{len(self._frustums)}", palette.ESTIMATE, 1.6))
        if n and self._newest is None:
            self._newest = self._frustum(frame.camera, "/window/newest", palette.SELECTION, 2.4)
        scale = frustum_scale(T_w_c, frame.unit_m)
        window = frame.report.window
        for slot, node in enumerate(self._frustums):
            visible = self._on and slot < n - 1
            if node.visible != visible:
                node.visible = visible
            if slot < n - 1 and window is not None:
                picked = frame.selection.is_frame(int(window.frames[slot]))
                _place(node, T_w_c[slot], scale, palette.SELECTION if picked else palette.ESTIMATE)
        if self._newest is not None:
            visible = self._on and n > 0
            if self._newest.visible != visible:
                self._newest.visible = visible
            if n:
                _place(self._newest, T_w_c[-1], 2.2 * scale, palette.SELECTION)
                self._newest.image = frame.thumbnail
        self._draw_second(frame, 2.2 * scale)

    def _draw_second(self, frame: SceneFrame, scale: float) -> None:
        """The newest frame's second camera, without its image: both would hide each other."""
        T_w_c, camera = frame.second_camera_pose(), frame.second_camera
        if self._second is None and T_w_c is not None and camera is not None:
            self._second = self._frustum(camera, "/window/second", palette.SELECTION, 1.2)
        if self._second is None:
            return
        visible = self._on and T_w_c is not None
        if self._second.visible != visible:
            self._second.visible = visible
        if T_w_c is not None:
            _place(self._second, T_w_c, scale, palette.SELECTION)

    def _frustum(
        self, camera: CameraCalibration, name: str, colour: str, thickness: float
    ) -> viser.CameraFrustumHandle:
        fov, aspect = vertical_fov(camera)
        return self._scene.add_camera_frustum(
            name,
            fov,
            aspect,
            thickness=thickness,
            thickness_units="screen",
            color=palette.rgb(colour),
            format="jpeg",
            cast_shadow=False,
            receive_shadow=False,
        )


def frustum_scale(T_w_c: np.ndarray, unit_m: float) -> float:
    """Metres: half the median distance between the window's frames, within what the scene's size allows."""
    spacing = np.linalg.norm(np.diff(T_w_c[:, :3, 3], axis=0), axis=1)
    wanted = 0.8 * float(np.median(spacing)) if len(spacing) else 0.0
    # in steps, so that nothing pulses while stepping
    return float(2 ** (np.round(2 * np.log2(np.clip(wanted, 0.015 * unit_m, 0.06 * unit_m))) / 2))


def imu_colours(sigma: np.ndarray | None, n: int) -> np.ndarray:
    """(n, 5) residuals in sigma -> (n, 3) uint8, judged by the worst of p, q, v, ba, bg per degree of freedom."""
    good, bad = np.array(palette.rgb(palette.IMU)), np.array(palette.rgb(palette.BAD))
    if sigma is None:
        return np.tile(good, (n, 1)).astype(np.uint8)
    worst = np.nan_to_num(sigma / np.sqrt(3.0), nan=BAD_SIGMA).max(1)
    share = np.clip((worst - ODD_SIGMA) / (BAD_SIGMA - ODD_SIGMA), 0, 1)[:, None]
    return (good + share * (bad - good)).astype(np.uint8)


def _place(node: viser.CameraFrustumHandle, T: np.ndarray, scale: float, colour: str) -> None:
    node.position = T[:3, 3]
    node.wxyz = so3.from_matrix(T[:3, :3])
    if node.scale != scale:
        node.scale = scale
    if tuple(node.color) != palette.rgb(colour):
        node.color = palette.rgb(colour)
