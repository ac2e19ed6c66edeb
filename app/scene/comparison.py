"""What would have been, in pink and dashed: the run compared with, and the window solved again."""

from __future__ import annotations

import numpy as np
import viser

from .. import palette
from .frame import SceneFrame, vertical_fov, window_camera_poses
from .nodes import Points, Segments
from .trajectory import DASH_UNITS, dashes, polyline
from .window import frustum_scale

_DASHES = 3
"""Dashes of an edge of a frustum."""


class ComparisonLayer:
    toggles = {"compare.run": "run compared with", "what_if.window": "window solved again"}  # noqa: RUF012

    def __init__(self, scene: viser.SceneApi) -> None:
        colour = palette.rgb(palette.FORK)
        self._path = Segments(scene, "/compare/path", colour, 2.4)
        self._apart = Segments(scene, "/compare/apart", colour, 1.4)
        self._there = Points(scene, "/compare/there", colour, "diamond", 0.03)
        self._window = Segments(scene, "/what_if/window", colour, 2.0)

    def update(self, frame: SceneFrame) -> None:
        other = frame.other
        nothing = np.zeros((0, 2, 3))
        path, apart, there = nothing, nothing, np.zeros((0, 3))
        if other is not None:
            path = dashes(other.p_w_b, DASH_UNITS * frame.unit_m)
            k = other.at(frame.frame)
            if k is not None and np.isfinite(other.p_w_b[k]).all():
                there = other.p_w_b[k : k + 1]
                apart = np.stack([frame.series.p_w_b[frame.frame : frame.frame + 1], there], 1)
                apart = apart[np.isfinite(apart).all((1, 2))]
        self._path.update(path)
        self._apart.update(apart)
        self._there.update(there.astype(np.float32), 0.02 * frame.unit_m)
        self._window.update(resolved_window(frame))

    def show(self, toggle: str, on: bool) -> None:
        for node in (self._window,) if toggle == "what_if.window" else (self._path, self._apart, self._there):
            node.show(on)


def resolved_window(frame: SceneFrame) -> np.ndarray:
    """(n, 2, 3) dashed pyramids of the window solved again, and the path through them."""
    window = frame.resolved
    if window is None:
        return np.zeros((0, 2, 3))
    T_w_c = window_camera_poses(window, frame.camera.T_b_c)
    fov, aspect = vertical_fov(frame.camera)
    size = frustum_scale(T_w_c, frame.unit_m)
    pyramids = [pyramid(T, fov, aspect, size) for T in T_w_c]
    return np.concatenate([*(dash_edges(edges) for edges in pyramids), dash_edges(polyline(window.p_w_b))])


def pyramid(T_w_c: np.ndarray, fov: float, aspect: float, size: float) -> np.ndarray:
    """(8, 2, 3) edges of a camera's frustum of the size that viser gives it: of one volume for any field of view."""
    y = np.tan(fov / 2)
    x = y * aspect
    corners = np.array([[x, y, 1], [-x, y, 1], [-x, -y, 1], [x, -y, 1]]) * size / np.cbrt(x * y / 3)
    world = corners @ T_w_c[:3, :3].T + T_w_c[:3, 3]
    tip = np.broadcast_to(T_w_c[:3, 3], world.shape)
    return np.concatenate([np.stack([tip, world], 1), np.stack([world, np.roll(world, 1, axis=0)], 1)])


def dash_edges(edges: np.ndarray) -> np.ndarray:
    """(n, 2, 3) -> (n * _DASHES, 2, 3): every edge as dashes with gaps of their length between them."""
    at = np.arange(2 * _DASHES).reshape(_DASHES, 2) / (2 * _DASHES - 1)
    a, b = edges[:, None, :1], edges[:, None, 1:]
    return (a + (b - a) * at[None, :, :, None]).reshape(-1, 2, 3)
