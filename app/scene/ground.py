"""What gives the 3D view its bearings: a level grid under the scene, the world's axes, and gravity."""

from __future__ import annotations

import numpy as np
import viser

from .. import palette
from .frame import SceneFrame

CELL, SECTION = (42, 48, 56), (58, 66, 77)


class GroundLayer:
    toggles = {"grid": "grid", "axes": "world axes and gravity"}  # noqa: RUF012

    def __init__(self, scene: viser.SceneApi) -> None:
        self._grid = scene.add_grid(
            "/grid",
            width=20,
            height=20,
            cell_size=1,
            section_size=5,
            cell_color=CELL,
            section_color=SECTION,
            cell_thickness=0.6,
            section_thickness=1.0,
            shadow_opacity=0.0,
        )
        self._axes = scene.add_frame(
            "/axes", axes_length=0.5, axes_radius=0.008, origin_radius=0.012, origin_color=SECTION
        )
        self._gravity = scene.add_line_segments(
            "/axes/gravity",
            np.array([[[0, 0, 0], [0, 0, -0.5]]], np.float32),
            np.array(palette.rgb(palette.IMU), np.uint8),
            thickness=3.0,
            thickness_units="screen",
        )
        self._label = scene.add_label("/axes/g", "g", position=(0, 0, -0.55), font_screen_scale=0.8)
        self._cell = 1.0

    def update(self, frame: SceneFrame) -> None:
        cell = grid_cell(frame.unit_m)
        if cell != self._cell:
            self._cell = cell
            self._grid.cell_size, self._grid.section_size = cell, 5 * cell
            self._grid.width = self._grid.height = 20 * cell
            self._axes.axes_length, self._axes.axes_radius = 0.5 * cell, 0.008 * cell
            self._axes.origin_radius = 0.012 * cell
            self._gravity.points = np.array([[[0, 0, 0], [0, 0, -0.5 * cell]]], np.float32)
            self._label.position = (0, 0, -0.55 * cell)

    def lower_to(self, z_m: float) -> None:
        """Put the grid at this height, so that it lies under what is drawn."""
        self._grid.position = (0, 0, z_m)

    def show(self, toggle: str, on: bool) -> None:
        if toggle == "grid":
            self._grid.visible = on
        else:
            self._axes.visible = self._gravity.visible = self._label.visible = on


def grid_cell(unit_m: float) -> float:
    """Side of a grid cell: 1, 2 or 5 times a power of ten, about a quarter of the scene's unit."""
    wanted = unit_m / 4
    steps = np.array([1, 2, 5, 10]) * 10 ** np.floor(np.log10(wanted))
    return float(steps[np.abs(np.log(steps / wanted)).argmin()])
