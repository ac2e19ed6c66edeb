"""Batched nodes of the 3D view that are updated in place and send only what changed."""

from __future__ import annotations

from typing import Literal

import numpy as np
import viser

PointShape = Literal["square", "diamond", "circle", "rounded", "sparkle"]


class Segments:
    """Line segments of one thickness in screen px.  Without segments the node is hidden."""

    def __init__(self, scene: viser.SceneApi, name: str, colour: tuple[int, int, int] | None, thickness: float) -> None:
        """`colour` None: every update brings a colour for each segment (viser cannot change between the two)."""
        self._on, self._any = True, False
        first = np.zeros((1, 2, 3), np.uint8) if colour is None else np.array(colour, np.uint8)
        self._node = scene.add_line_segments(
            name, np.zeros((1, 2, 3)), first, thickness=thickness, thickness_units="screen", visible=False
        )

    def update(self, segments: np.ndarray, colours: np.ndarray | None = None) -> None:
        """(n, 2, 3) segments, and (n, 3) uint8 colours if the node has none of its own."""
        segments = np.ascontiguousarray(segments, np.float32)
        self._any = len(segments) > 0
        if self._any and not np.array_equal(self._node.points, segments):
            self._node.points = segments
        if self._any and colours is not None:
            ends = np.repeat(_linear(colours)[:, None], 2, 1)
            if not np.array_equal(self._node.colors, ends):
                self._node.colors = ends
        self.show(self._on)

    def show(self, on: bool) -> None:
        self._on = on
        if self._node.visible != (on and self._any):
            self._node.visible = on and self._any


def _linear(colours: np.ndarray) -> np.ndarray:
    """sRGB -> linear light, uint8: viser takes the colours of single segments as linear, all others as sRGB."""
    c = colours / 255.0
    return np.round(255 * np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)).astype(np.uint8)


class Points:
    """A point cloud of one colour and shape.  Without points the node is hidden."""

    def __init__(
        self, scene: viser.SceneApi, name: str, colour: tuple[int, int, int], shape: PointShape, size: float
    ) -> None:
        self._on, self._any = True, False
        self._node = scene.add_point_cloud(
            name,
            np.zeros((1, 3), np.float32),
            np.array(colour, np.uint8),
            point_size=size,
            point_shape=shape,
            point_shading="flat",
            precision="float32",
            visible=False,
        )

    def update(self, points: np.ndarray, size: float) -> None:
        """(n, 3) points, `size` in metres."""
        self._any = len(points) > 0
        if self._any:
            if not np.array_equal(self._node.points, points):
                self._node.points = np.ascontiguousarray(points, np.float32)
            if self._node.point_size != size:
                self._node.point_size = size
        self.show(self._on)

    def show(self, on: bool) -> None:
        self._on = on
        if self._node.visible != (on and self._any):
            self._node.visible = on and self._any
