"""3-sigma ellipsoids: of the window's poses, and of the selected landmark.

A few millimetres cannot be seen in a room, so all of them are enlarged by one factor, which stands beside the newest.
"""

from __future__ import annotations

import numpy as np
import viser

from .. import palette
from .frame import SceneFrame

MOST = 24
"""Ellipsoids that are kept as nodes; a window has at most 21 frames."""


class UncertaintyLayer:
    toggles = {"uncertainty": "3σ of poses and landmark, enlarged"}  # noqa: RUF012

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._nodes: list[viser.IcosphereHandle] = []
        self._label = scene.add_label("/uncertainty/factor", "", visible=False, font_screen_scale=0.8)
        self._on = True

    def update(self, frame: SceneFrame) -> None:
        centres, axes, wxyz, factor = drawn(frame)
        if not self._on:
            centres = centres[:0]
        if self._label.visible != (len(centres) > 0):
            self._label.visible = len(centres) > 0
        if len(centres) and frame.uncertainty is not None:
            k = len(frame.uncertainty.poses.centres) - 1
            self._label.text = f"3σ x {factor:g}" if factor != 1 else "3σ"
            self._label.position = centres[k] - np.array([0, 0, 1.2 * axes[k].max()])
        while len(self._nodes) < min(len(centres), MOST):
            self._nodes.append(
                self._scene.add_icosphere(
                    f"/uncertainty/{len(self._nodes)}",
                    radius=1.0,
                    subdivisions=2,
                    color=palette.rgb(palette.PRIOR),
                    opacity=0.35,
                    visible=False,
                    cast_shadow=False,
                    receive_shadow=False,
                )
            )
        for k, node in enumerate(self._nodes):
            there = k < len(centres)
            if node.visible != there:
                node.visible = there
            if there:
                node.position, node.wxyz, node.scale = centres[k], wxyz[k], tuple(axes[k])

    def show(self, toggle: str, on: bool) -> None:
        self._on = on
        if not on:
            for node in (*self._nodes, self._label):
                node.visible = False


def drawn(frame: SceneFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(centres, half axes, wxyz) of what is drawn, and the factor by which it is enlarged."""
    known = frame.uncertainty
    if known is None:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4)), 1.0
    picked = known.landmark_ids == frame.selection.id if frame.selection.kind == "track" else np.zeros(0, bool)
    parts = [known.poses, known.landmarks]
    rows = [slice(None), np.flatnonzero(picked)]
    centres, axes, wxyz = (
        np.concatenate([getattr(part, name)[row] for part, row in zip(parts, rows)])
        for name in ("centres", "axes", "wxyz")
    )
    factor = enlargement(float(known.poses.axes.max()), 0.05 * frame.unit_m)
    return centres, np.clip(factor * axes, 0.002 * frame.unit_m, 2.0 * frame.unit_m), wxyz, factor


def enlargement(size_m: float, wanted_m: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... that keeps `size_m` within `wanted_m`."""
    steps = np.array([m * 10.0**k for k in range(5) for m in (1, 2, 5)])
    fitting = steps[steps * max(size_m, 1e-9) <= wanted_m]
    return float(fitting[-1]) if len(fitting) else 1.0
