"""The whole 3D view of one tab: its layers, its toggles, its viewpoint."""

from __future__ import annotations

import numpy as np
import viser

from vins_core.report import LandmarkStatus

from .comparison import ComparisonLayer
from .frame import Layer, SceneFrame
from .gps import GpsLayer
from .ground import GroundLayer
from .landmarks import LandmarkLayer, by_status
from .loops import LoopLayer
from .selection import SelectionLayer
from .trajectory import TrajectoryLayer
from .uncertainty import UncertaintyLayer
from .window import WindowLayer

LAYERS = (
    TrajectoryLayer,
    WindowLayer,
    LandmarkLayer,
    SelectionLayer,
    ComparisonLayer,
    UncertaintyLayer,
    LoopLayer,
    GpsLayer,
)
TOGGLES: dict[str, str] = {name: title for layer in (*LAYERS, GroundLayer) for name, title in layer.toggles.items()}
"""Every layer that can be switched, with the title of its checkbox."""
OFF = frozenset({"uncertainty", "loops.refused"})
"""Layers that are off unless a layout asks for them; all others are on."""

VIEW = np.array([0.5, 0.75, -0.62])
"""Direction of the overview."""
COVERED = 0.26
"""Share of the 3D view's height that the timeline covers, below."""


class SceneView:
    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._ground = GroundLayer(client.scene)
        self._layers: list[Layer] = [self._ground, *(layer(client.scene) for layer in LAYERS)]
        self._on = dict.fromkeys(TOGGLES, True)

    def shows(self, toggle: str) -> bool:
        return self._on[toggle]

    def update(self, frame: SceneFrame) -> None:
        for layer in self._layers:
            layer.update(frame)

    def show(self, toggle: str, on: bool) -> None:
        if self._on[toggle] != on:
            self._on[toggle] = on
            next(layer for layer in self._layers if toggle in layer.toggles).show(toggle, on)

    def fit(self, frame: SceneFrame, aspect: float) -> None:
        """Look at the whole run from above and aside; `aspect` is the view's width over its height."""
        camera, points = self._client.camera, worth_seeing(frame)
        camera.position, camera.look_at = overview(points, float(camera.fov), aspect)
        if len(points):
            self._ground.lower_to(float(points[:, 2].min()))

    def follow(self, frame: SceneFrame) -> None:
        """Look over the newest camera's shoulder."""
        T_w_c = frame.camera_poses()
        if len(T_w_c):
            camera = self._client.camera
            camera.position, camera.look_at = shoulder(T_w_c[-1], frame.unit_m)


def worth_seeing(frame: SceneFrame, looks: int = 4) -> np.ndarray:
    """(n, 3): the trajectory, and the bulk of the nearer landmarks of a few frames spread over the run."""
    p = frame.series.p_w_b
    solved = np.flatnonzero(np.isfinite(p[:, 0]))
    near = [np.zeros((0, 3))]
    for k in solved[np.linspace(0, len(solved) - 1, looks).astype(int)] if len(solved) else ():
        xyz = by_status(frame.run.report(int(k)).landmarks)[LandmarkStatus.TRIANGULATED].astype(float)
        distance = np.linalg.norm(xyz - p[k], axis=1)
        near.append(xyz[distance <= np.median(distance)] if len(xyz) else xyz)
    bulk = np.concatenate(near)
    if len(bulk):
        low, high = np.percentile(bulk, [8, 92], axis=0)
        bulk = bulk[((bulk >= low) & (bulk <= high)).all(1)]
    return np.concatenate([p[solved], bulk])


def overview(points: np.ndarray, fov: float, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """(position, look_at) of the nearest camera that sees all points above the timeline, from above and aside.

    A point at (x, y) across and z along the view from the centre is inside at distance d when
    |x| <= (z + d) tan(fov_x / 2), and alike for y.
    """
    if not len(points):
        return np.array([-3.0, -3.5, 3.0]), np.zeros(3)
    centre = (points.min(0) + points.max(0)) / 2
    forward = VIEW / np.linalg.norm(VIEW)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    x, y, z = ((points - centre) @ axis for axis in (right, up, forward))
    high = np.tan(fov / 2)
    wide, free = high * aspect, high * (1 - COVERED)
    distance = max((np.abs(x) / wide - z).max(), (np.abs(y) / free - z).max(), 0.5) * 1.08
    look_at = centre - up * distance * high * COVERED
    return look_at - forward * distance, look_at


def shoulder(T_w_c: np.ndarray, unit_m: float) -> tuple[np.ndarray, np.ndarray]:
    """(position, look_at) behind, beside and above a camera."""
    p, forward = T_w_c[:3, 3], T_w_c[:3, 2]
    flat = np.array([forward[0], forward[1], 0.0])
    flat /= max(float(np.linalg.norm(flat)), 1e-6)
    left = np.cross([0, 0, 1.0], flat)
    return p + unit_m * (-0.6 * flat + 0.3 * left + np.array([0, 0, 0.4])), p + 0.25 * unit_m * forward
