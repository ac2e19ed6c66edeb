"""Synthetic windows (synthetic_window.py) whose landmarks a second camera sees as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import synthetic_window as sw

from vins_core.geometry import se3, so3
from vins_core.sensors import ImuNoise
from vins_core.window.assemble import gather_tracks
from vins_core.window.state import Observations, WindowFrame, WindowState

T_C0_C1 = se3.from_quaternion_translation(so3.exp(np.array([0.01, -0.02, 0.015])), np.array([0.12, 0.003, -0.004]))
"""The second camera sits 12 cm to the right, a little askew."""


def make(seed: int = 0, right_sigma_px: float = 0.7, share: float = 0.8, **options: float) -> sw.Synthetic:
    """As `synthetic_window.make`; the second camera sees `share` of the observations."""
    flight = sw.make(seed, **options)
    tracks, rng = gather_tracks(flight.truth.frames), np.random.default_rng([seed, 1])
    T_w_c0 = poses_of(flight.truth.frames) @ sw.T_B_C
    table = flight.truth.landmarks
    rays = tracks.rays[tracks.start[:-1]]
    points_c = rays / (rays[:, 2:] * table.inv_depth[np.searchsorted(table.ids, tracks.ids)][:, None])
    points_w = se3.transform(T_w_c0[tracks.anchor], points_c)

    def second(slot: int, frame: WindowFrame) -> WindowFrame:
        o = frame.observations
        point = points_w[np.searchsorted(tracks.ids, o.ids)]
        local = se3.transform(se3.inverse(T_w_c0[slot] @ T_C0_C1), point)
        seen = (rng.random(len(o)) < share) & (local[:, 2] > 0.2)
        sight = local[seen] / np.linalg.norm(local[seen], axis=1, keepdims=True)
        sight = sight + right_sigma_px / 460 * rng.normal(size=sight.shape)
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        xy = (460 * sight[:, :2] / sight[:, 2:]).astype(np.float32)
        right = Observations(o.ids[seen], sight, xy, np.zeros_like(xy))
        return replace(frame, observations=replace(o, right=right))

    frames = tuple(second(slot, frame) for slot, frame in enumerate(flight.truth.frames))
    Ts_b_c = np.stack([sw.T_B_C, sw.T_B_C @ T_C0_C1])
    estimated = tuple(replace(a, observations=b.observations) for a, b in zip(flight.window.frames, frames))
    return sw.Synthetic(
        replace(flight.window, frames=estimated, T_b_c=Ts_b_c),
        replace(flight.truth, frames=frames, T_b_c=Ts_b_c),
        flight.noise,
    )


def without_imu(window: WindowState) -> WindowState:
    frames = tuple(replace(f, imu=None, b_a=np.zeros(3), b_g=np.zeros(3)) for f in window.frames)
    return replace(window, frames=frames, prior=None, inertial=False)


def poses_of(frames: tuple[WindowFrame, ...]) -> np.ndarray:
    """T_w_b (n, 4, 4)."""
    return se3.from_quaternion_translation(np.array([f.q_w_b for f in frames]), np.array([f.p_w_b for f in frames]))


NOISE: ImuNoise = sw.NOISE
