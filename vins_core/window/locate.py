"""Where the newest frame is by what it sees of the landmarks: PnP, for windows without IMU and before one is used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..factors.reprojection import FOCAL_PX
from ..geometry import inverse_depth, se3, so3
from ..geometry.pnp import solve_pnp
from ..params import Params
from ..report import Gate
from .assemble import tracks_of
from .landmarks import camera_poses
from .state import OUTLIER, WindowFrame, WindowState

TOLERANCE = 1e-4
"""A pose to start from need not be better: the solve that follows goes on with everything the window knows."""


def locate(params: Params, window: WindowState) -> tuple[WindowState, Gate]:
    """`window` with the pose of its newest frame, and how many landmarks agree on that.

    The search begins where the body would be had it gone on as between the two frames before.  When too few landmarks
    agree, that is the pose.
    """
    *placed, newest = window.frames
    guess = _go_on(placed, newest)
    seen, points_w, rays = _landmarks_in_view(replace(window, frames=tuple(placed)), newest)
    sigma_rad = params.window.pixel_sigma / FOCAL_PX
    T_b_c = window.T_b_c[0]
    found = solve_pnp(points_w, rays, guess @ T_b_c, 2.0 * sigma_rad, TOLERANCE) if len(seen) else None
    agree = found.n_inliers if found else 0
    gate = Gate("landmarks agree on the pose", agree, ">=", params.init.min_pnp_points, "init.min_pnp_points")
    T_w_b = found.T_w_c @ se3.inverse(T_b_c) if found and gate.passed else guess
    newest = replace(newest, p_w_b=T_w_b[:3, 3], q_w_b=so3.from_matrix(T_w_b[:3, :3]))
    return replace(window, frames=(*placed, newest)), gate


def _landmarks_in_view(window: WindowState, newest: WindowFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ids (n,), points in the world (n, 3), and unit rays in the newest frame (n, 3) of the landmarks that it sees."""
    table, tracks = window.landmarks, tracks_of(window)
    known = table.ids[(table.status != OUTLIER) & (table.inv_depth > 0)]  # False for NaN
    known = known[np.isin(known, tracks.ids)]
    seen, _, rows = np.intersect1d(known, newest.observations.ids, assume_unique=True, return_indices=True)
    track = np.searchsorted(tracks.ids, seen)
    anchor_rays = tracks.rays[tracks.start[track]]
    points_c = inverse_depth.point(anchor_rays, table.inv_depth[np.searchsorted(table.ids, seen)])
    return seen, se3.transform(camera_poses(window)[tracks.anchor[track]], points_c), newest.observations.rays[rows]


def _go_on(placed: list[WindowFrame], newest: WindowFrame) -> np.ndarray:
    """T_w_b (4, 4) at constant linear and angular velocity."""
    last = placed[-1]
    p, q = last.p_w_b, last.q_w_b
    if len(placed) > 1:
        before = placed[-2]
        ahead = (newest.t_ns - last.t_ns) / (last.t_ns - before.t_ns)
        p = p + ahead * (last.p_w_b - before.p_w_b)
        q = so3.retract(q, ahead * so3.difference(last.q_w_b, before.q_w_b))
    return se3.from_quaternion_translation(q, p)
