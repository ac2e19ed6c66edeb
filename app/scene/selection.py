"""What is selected: rays to the frames that observe a landmark, its uncertainty, its name; a frame's landmarks."""

from __future__ import annotations

import numpy as np
import viser

from vins_core.report import FrameReport

from .. import palette
from .frame import SceneFrame
from .nodes import Segments

MAX_ELLIPSOID_UNITS = 2.0


class SelectionLayer:
    toggles = {"selection": "selection: rays, 3σ"}  # noqa: RUF012

    def __init__(self, scene: viser.SceneApi) -> None:
        colour = palette.rgb(palette.SELECTION)
        self._rays = Segments(scene, "/selection/rays", colour, 1.4)
        self._on = True
        self._ellipsoid = scene.add_icosphere(
            "/selection/ellipsoid",
            radius=1.0,
            color=colour,
            opacity=0.4,
            visible=False,
            cast_shadow=False,
            receive_shadow=False,
        )
        self._label = scene.add_label(
            "/selection/label", "", visible=False, font_screen_scale=0.9, anchor="bottom-left"
        )

    def update(self, frame: SceneFrame) -> None:
        self._rays.update(selection_rays(frame))
        row = _landmark_row(frame.report, frame.selection.id) if frame.selection.kind == "track" else None
        visible = self._on and row is not None
        for node in (self._ellipsoid, self._label):
            if node.visible != visible:
                node.visible = visible
        landmarks = frame.report.landmarks
        if row is None or landmarks is None:
            return
        xyz = landmarks.xyz_w[row].astype(float)
        centre = frame.camera_poses()[landmarks.anchor_slot[row], :3, 3]
        axes = three_sigma(xyz - centre, float(landmarks.inv_depth[row]), float(landmarks.sigma_inv_depth[row]))
        along = (xyz - centre) / np.linalg.norm(xyz - centre)
        self._ellipsoid.scale = tuple(np.clip(axes, 0.004 * frame.unit_m, MAX_ELLIPSOID_UNITS * frame.unit_m))
        self._ellipsoid.wxyz = _turn_z_to(along)
        self._ellipsoid.position = xyz
        self._label.position = xyz
        self._label.text = f"landmark {frame.selection.id} · {landmarks.error_px[row]:.2f} px"

    def show(self, toggle: str, on: bool) -> None:
        self._on = on
        self._rays.show(on)
        if not on:
            self._ellipsoid.visible = self._label.visible = False


def selection_rays(frame: SceneFrame) -> np.ndarray:
    """(n, 2, 3): from every observing frame to the selected landmark, or from a selected frame to its landmarks."""
    landmarks, solve, T_w_c = frame.report.landmarks, frame.report.solve, frame.camera_poses()
    nothing = np.zeros((0, 2, 3))
    if landmarks is None or solve is None or not len(T_w_c):
        return nothing
    centres = T_w_c[:, :3, 3]
    if frame.selection.kind == "track":
        row = _landmark_row(frame.report, frame.selection.id)
        if row is None:
            return nothing
        slots = np.unique(solve.visual_slots[solve.visual_ids == frame.selection.id])
        slots = slots if len(slots) else landmarks.anchor_slot[row : row + 1]
        return np.stack([centres[slots], np.broadcast_to(landmarks.xyz_w[row], (len(slots), 3))], 1)
    if frame.selection.kind == "frame" and frame.selection.other >= 0 and frame.report.window is not None:
        both = np.isin(frame.report.window.frames, (frame.selection.id, frame.selection.other))
        return centres[both][None] if both.sum() == 2 else nothing
    if frame.selection.kind == "frame" and frame.report.window is not None:
        slot = np.flatnonzero(frame.report.window.frames == frame.selection.id)
        if not len(slot):
            return nothing
        seen = solve.visual_ids[(solve.visual_slots == slot[0]).any(1)]
        points = landmarks.xyz_w[np.isin(landmarks.ids, seen)]
        points = points[np.isfinite(points).all(1)]
        return np.stack([np.broadcast_to(centres[slot[0]], points.shape), points], 1)
    return nothing


def three_sigma(from_anchor: np.ndarray, inv_depth: float, sigma_inv_depth: float, pixel_sigma: float = 1.5 / 460):
    """Half axes (across, across, along the anchor's ray) of the 3-sigma ellipsoid, m.

    Along the ray the bound of inverse depth is inverted (depth is not Gaussian): 1/(l - 3s) - 1/l, kept finite.
    """
    distance = float(np.linalg.norm(from_anchor))
    across = 3 * pixel_sigma * distance
    if not np.isfinite(sigma_inv_depth):
        return np.array([across, across, across])
    far = inv_depth / max(inv_depth - 3 * sigma_inv_depth, 0.05 * inv_depth)
    return np.array([across, across, distance * (far - 1)])


def _landmark_row(report: FrameReport, id: int) -> int | None:
    if report.landmarks is None or report.window is None:
        return None
    rows = np.flatnonzero(report.landmarks.ids == id)
    return int(rows[0]) if len(rows) and np.isfinite(report.landmarks.xyz_w[rows[0]]).all() else None


def _turn_z_to(direction: np.ndarray) -> np.ndarray:
    """(4,) wxyz that maps (0, 0, 1) to the unit vector `direction`."""
    x, y, z = direction
    if z < -0.999999:
        return np.array([0.0, 1.0, 0.0, 0.0])
    q = np.array([1 + z, -y, x, 0.0])
    return q / np.linalg.norm(q)
