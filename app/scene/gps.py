"""GPS in 3D, brought into the odometry's world by the alignment of the frame shown.

fix that counts        green circle         final trajectory   green
kept for the alignment grey diamond         selected fix       yellow 3-sigma ellipsoid
gated                  vermillion star
"""

from __future__ import annotations

import numpy as np
import viser

from vins_core.geometry import poses, so3
from vins_core.report import FixVerdict

from .. import palette
from ..gps import UNKNOWN, VERDICTS
from .frame import SceneFrame
from .nodes import Points, PointShape, Segments
from .trajectory import polyline

LOOKS: dict[FixVerdict, tuple[str, PointShape]] = {
    FixVerdict.USED: (palette.OK, "circle"),
    FixVerdict.GATED: (palette.BAD, "sparkle"),
    FixVerdict.OPEN: (palette.CANDIDATE, "diamond"),
}
SIZE_UNITS = 0.025


class GpsLayer:
    toggles = {"gps.fixes": "GPS fixes", "gps.trajectory": "GPS: final trajectory"}  # noqa: RUF012

    def __init__(self, scene: viser.SceneApi) -> None:
        self._fixes = {
            verdict: Points(scene, f"/gps/{verdict.name.lower()}", palette.rgb(colour), shape, 0.02)
            for verdict, (colour, shape) in LOOKS.items()
        }
        self._final = Segments(scene, "/gps/final", palette.rgb(palette.OK), 2.2)
        self._ellipsoid = scene.add_icosphere(
            "/gps/ellipsoid",
            radius=1.0,
            color=palette.rgb(palette.SELECTION),
            opacity=0.3,
            visible=False,
            cast_shadow=False,
            receive_shadow=False,
        )
        self._on = True

    def update(self, frame: SceneFrame) -> None:
        points = fixes(frame)
        for verdict, node in self._fixes.items():
            node.update(points[verdict], SIZE_UNITS * frame.unit_m)
        self._final.update(polyline(final(frame)))
        found = ellipsoid(frame) if self._on else None
        if self._ellipsoid.visible != (found is not None):
            self._ellipsoid.visible = found is not None
        if found is not None:
            self._ellipsoid.position, axes, self._ellipsoid.wxyz = found
            self._ellipsoid.scale = tuple(axes)

    def show(self, toggle: str, on: bool) -> None:
        if toggle == "gps.trajectory":
            self._final.show(on)
            return
        self._on = on
        for node in self._fixes.values():
            node.show(on)
        if not on:
            self._ellipsoid.visible = False


def fixes(frame: SceneFrame) -> dict[FixVerdict, np.ndarray]:
    """(m, 3) in the odometry's world of those that have come, by verdict."""
    gps = frame.series.gps
    T_o_e = gps.T_o_e(frame.frame)
    if T_o_e is None:
        return {verdict: np.zeros((0, 3)) for verdict in VERDICTS}
    now = np.where(np.isfinite(gps.z_e).all(1), gps.verdicts(frame.frame), UNKNOWN)
    z_o = T_o_e[:3] + so3.rotate(T_o_e[3:], gps.z_e)
    return {verdict: z_o[now == k] for k, verdict in enumerate(VERDICTS)}


def final(frame: SceneFrame) -> np.ndarray:
    """(k, 3) in the odometry's world, NaN between two stretches."""
    track, T_o_e = frame.run.final if len(frame.series.gps) else None, frame.series.gps.T_o_e(frame.frame)
    if track is None or T_o_e is None or not len(track.t_ns):
        return np.zeros((0, 3))
    path = T_o_e[:3] + so3.rotate(T_o_e[3:], track.T_e_b[:, :3])
    cuts = np.flatnonzero(np.diff(track.stretch)) + 1
    return np.insert(path, cuts, np.nan, axis=0)


def ellipsoid(frame: SceneFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """(centre, half axes of 3 sigma, wxyz) of the selected fix."""
    gps, k = frame.series.gps, frame.selection.id
    T_o_e = gps.T_o_e(frame.frame)
    if frame.selection.kind != "fix" or T_o_e is None or not 0 <= k < len(gps) or not np.isfinite(gps.z_e[k]).all():
        return None
    values, vectors = np.linalg.eigh(gps.covariance[k])
    vectors = vectors * np.sign(np.linalg.det(vectors))
    turned = np.concatenate([gps.z_e[k], so3.from_matrix(vectors)])
    T_o_f = poses.compose(T_o_e, turned)
    return T_o_f[:3], 3 * np.sqrt(np.maximum(values, 1e-12)), T_o_f[3:]
