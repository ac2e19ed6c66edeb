"""Synthetic windows (synthetic_window.py, synthetic_stereo.py) whose images were taken later than stamped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import synthetic_stereo as ss
import synthetic_window as sw

from vins_core.geometry import inverse_depth, se3
from vins_core.window.assemble import gather_tracks
from vins_core.window.state import Calibrates, Observations, WindowState

H_S = 1e-3


def make(td_s: float, seed: int = 0, stereo: bool = False, noise_px: float = 0.3, **options: float) -> sw.Synthetic:
    """Frames whose IMU was cut by a time offset of 0, and whose rays are those of `td_s` later, with velocities."""
    flight = (ss if stereo else sw).make(seed, **options)
    rng, truth = np.random.default_rng([seed, 2]), flight.truth
    Ts_b_c = truth.T_b_c
    points = _points(truth)

    def seen(o: Observations, t_s: float, camera: int) -> Observations:
        points_w = np.array([points[i] for i in o.ids.tolist()]).reshape(-1, 3)
        before, at, after = (_rays(points_w, t_s + td_s + h, Ts_b_c[camera]) for h in (-H_S, 0.0, H_S))
        velocity = (after[:, :2] / after[:, 2:] - before[:, :2] / before[:, 2:]) / (2 * H_S)
        rays = at + noise_px / 460 * rng.normal(size=at.shape)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        right = None if o.right is None else seen(o.right, t_s, 1)
        return replace(o, rays=rays, velocity=velocity.astype(np.float32), right=right)

    late = [seen(f.observations, f.t_ns * 1e-9, 0) for f in truth.frames]
    window, truth = (
        replace(
            part,
            frames=tuple(replace(f, observations=o) for f, o in zip(part.frames, late)),
            calibrates=Calibrates(td=True),
        )
        for part in (flight.window, truth)
    )
    return replace(flight, window=window, truth=replace(truth, td_s=td_s))


def _points(window: WindowState) -> dict[int, np.ndarray]:
    """Of each track, in the world."""
    tracks, table = gather_tracks(window.frames), window.landmarks
    inv_depth = table.inv_depth[np.searchsorted(table.ids, tracks.ids)]
    points_c = inverse_depth.point(tracks.rays[tracks.start[:-1]], inv_depth)
    T_w_c = ss.poses_of(window.frames) @ window.T_b_c[0]
    return dict(zip(tracks.ids.tolist(), se3.transform(T_w_c[tracks.anchor], points_c)))


def _rays(points_w: np.ndarray, t_s: float, T_b_c: np.ndarray) -> np.ndarray:
    T_w_c = se3.from_quaternion_translation(sw.attitude(t_s), sw.position(t_s)) @ T_b_c
    points = se3.transform(se3.inverse(T_w_c), points_w)
    return points / np.linalg.norm(points, axis=1, keepdims=True)
