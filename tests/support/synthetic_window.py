"""A window with known truth: a body on a smooth curve, an ideal camera, an IMU with noise and bias.

Frames are spaced `frame_dt_s`; tracks are born, live for a while and end, as from an optical-flow tracker.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from vins_core.factors.preintegration import preintegrate
from vins_core.geometry import se3, so3
from vins_core.params import Params
from vins_core.sensors import ImuNoise, ImuSamples
from vins_core.solver.levenberg_marquardt import solve
from vins_core.window.assemble import assemble, unpack
from vins_core.window.marginalize import marginalize_oldest
from vins_core.window.slide import drop_oldest
from vins_core.window.state import TRIANGULATED, Landmarks, Observations, WindowFrame, WindowState

GRAVITY = 9.81
NOISE = ImuNoise("discrete", acc_n=0.08, gyr_n=0.004, acc_w=4e-5, gyr_w=2e-6)
B_A, B_G = np.array([0.05, -0.03, 0.02]), np.array([0.004, -0.002, 0.003])
T_B_C = se3.from_quaternion_translation(
    so3.multiply(np.array([0.5, -0.5, 0.5, -0.5]), so3.exp(np.array([0.02, -0.01, 0.015]))),
    np.array([0.05, -0.02, 0.03]),
)
"""The camera looks along the body's x axis, slightly misaligned."""


def position(t: np.ndarray) -> np.ndarray:
    t = np.asarray(t, float)
    return np.stack([3 * np.sin(0.7 * t), 3 * (1 - np.cos(0.7 * t)), 0.4 * np.sin(1.9 * t)], -1)


def attitude(t: np.ndarray) -> np.ndarray:
    """q_w_b wxyz: heading along the curve, with some roll and pitch."""
    t = np.asarray(t, float)
    o = np.zeros_like(t)
    yaw, pitch, roll = 0.7 * t + 0.1 * np.sin(2 * t), 0.08 * np.sin(1.3 * t + 0.4), 0.12 * np.sin(2.3 * t)
    about = [np.stack(v, -1) for v in ([o, o, yaw], [o, pitch, o], [roll, o, o])]
    return so3.multiply(so3.multiply(so3.exp(about[0]), so3.exp(about[1])), so3.exp(about[2]))


def velocity(t: np.ndarray, h: float = 1e-4) -> np.ndarray:
    t = np.asarray(t, float)
    return (8 * (position(t + h) - position(t - h)) - (position(t + 2 * h) - position(t - 2 * h))) / (12 * h)


def imu_truth(t: np.ndarray, h: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Angular rate (rad/s) and specific force (m/s^2) in the body frame, by fourth-order differences."""
    t = np.asarray(t, float)
    q = attitude(t)
    rate = (8 * so3.difference(attitude(t + h), q) - 8 * so3.difference(attitude(t - h), q)
            - so3.difference(attitude(t + 2 * h), q) + so3.difference(attitude(t - 2 * h), q)) / (12 * h)  # fmt: skip
    acc = (-position(t + 2 * h) + 16 * position(t + h) - 30 * position(t)
           + 16 * position(t - h) - position(t - 2 * h)) / (12 * h * h)  # fmt: skip
    return rate, so3.rotate(so3.inverse(q), acc + np.array([0, 0, GRAVITY]))


@dataclass(frozen=True)
class Synthetic:
    window: WindowState  # estimates off the truth, as before a solve
    truth: WindowState  # the same measurements at the true states
    noise: ImuNoise


def make(
    seed: int = 0,
    n_frames: int = 11,
    n_tracks: int = 300,
    start_s: float = 1.0,
    frame_dt_s: float = 0.1,
    imu_hz: float = 200.0,
    pixel_sigma: float = 0.7,
    imu_noise: float = 1.0,
    perturbation: float = 1.0,
    outliers: float = 0.0,
    max_angle_deg: float = 45.0,
    longest_track: int = 18,
) -> Synthetic:
    """`pixel_sigma` in px460, `imu_noise` a factor on NOISE, `outliers` the share of wrong observations."""
    rng = np.random.default_rng(seed)
    t = start_s + frame_dt_s * np.arange(n_frames)
    p, q = position(t), attitude(t)
    motions = [None] + [_motion(rng, a, b, imu_hz, imu_noise) for a, b in pairwise(t)]
    ids, slots, rays, inv_depths = _tracks(
        rng, p, q, n_tracks, longest_track, pixel_sigma, outliers, np.deg2rad(max_angle_deg)
    )
    frames = []
    for k in range(n_frames):
        mine = slots == k
        xy = rays[mine, :2] / rays[mine, 2:]
        frames.append(
            WindowFrame(
                frame=100 + k,
                t_ns=round(t[k] * 1e9),
                is_keyframe=True,
                observations=Observations(
                    ids[mine], rays[mine], (460 * xy).astype(np.float32), np.zeros((mine.sum(), 2), np.float32)
                ),
                imu=motions[k],
                p_w_b=p[k],
                q_w_b=q[k],
                v_w_b=velocity(t[k]),
                b_a=B_A,
                b_g=B_G,
            )
        )
    count = np.bincount(ids, minlength=n_tracks)
    known = np.unique(ids)
    landmarks = Landmarks(known, inv_depths[known], np.full(len(known), TRIANGULATED, np.uint8))
    assert count.max() <= n_frames
    truth = WindowState(tuple(frames), landmarks, None, T_B_C[None])
    return Synthetic(perturb(rng, truth, perturbation), truth, NOISE)


def perturb(rng: np.random.Generator, window: WindowState, scale: float) -> WindowState:
    """Estimates off by about 3 cm, 0.6 deg, 5 cm/s, 10 % of depth, and common biases (times `scale`)."""
    db_a, db_g = scale * rng.normal(0, 0.01, 3), scale * rng.normal(0, 0.001, 3)
    frames = tuple(
        replace(
            f,
            p_w_b=f.p_w_b + scale * rng.normal(0, 0.03, 3),
            q_w_b=so3.retract(f.q_w_b, scale * rng.normal(0, 0.01, 3)),
            v_w_b=f.v_w_b + scale * rng.normal(0, 0.05, 3),
            b_a=f.b_a + db_a,
            b_g=f.b_g + db_g,
        )
        for f in window.frames
    )
    table = window.landmarks
    inv_depth = table.inv_depth * np.exp(scale * rng.normal(0, 0.1, len(table)))
    return replace(window, frames=frames, landmarks=replace(table, inv_depth=inv_depth))


def _motion(rng: np.random.Generator, start_s: float, end_s: float, hz: float, noise: float):
    n = round((end_s - start_s) * hz)
    t = np.linspace(start_s, end_s, n + 1)
    gyro, accel = imu_truth(t)
    gyro = gyro + B_G + noise * rng.normal(0, NOISE.gyr_n, gyro.shape)
    accel = accel + B_A + noise * rng.normal(0, NOISE.acc_n, accel.shape)
    return preintegrate(ImuSamples(np.round(t * 1e9).astype(np.int64), gyro, accel), B_A, B_G, NOISE)


def _tracks(rng, p, q, n_tracks, longest, pixel_sigma, outliers, max_angle):
    """Observations sorted by (id, slot), and the true inverse depth of each track in its first frame."""
    n = len(p)
    T_c_w = se3.inverse(se3.from_quaternion_translation(q, p) @ T_B_C)
    ids, slots, rays, inv_depths = [], [], [], np.zeros(n_tracks)
    track = 0
    while track < n_tracks:
        born = int(rng.integers(-8, n - 1))
        seen = np.arange(max(born, 0), min(born + int(rng.integers(4, longest)), n))
        if len(seen) < 2:
            continue
        middle = seen[len(seen) // 2]
        angle, radius = rng.uniform(0, 2 * np.pi), max_angle * np.sqrt(rng.uniform(0, 1))
        ray = np.array([np.cos(angle) * np.sin(radius), np.sin(angle) * np.sin(radius), np.cos(radius)])
        point_w = se3.transform(se3.inverse(T_c_w[middle]), ray * np.exp(rng.uniform(np.log(1.5), np.log(12))))
        points_c = se3.transform(T_c_w[seen], point_w)
        if points_c[0, 2] < 0.3 or (max_angle < 1.5 and (points_c[:, 2] < 0.3).any()):
            continue
        sigma = pixel_sigma / 460 * np.where(rng.random(len(seen)) < outliers, 40.0, 1.0)
        sight = points_c / np.linalg.norm(points_c, axis=1, keepdims=True)
        sight = sight + sigma[:, None] * rng.normal(size=sight.shape)
        rays.append(sight / np.linalg.norm(sight, axis=1, keepdims=True))
        ids.append(np.full(len(seen), track))
        slots.append(seen)
        inv_depths[track] = 1 / points_c[0, 2]
        track += 1
    return np.concatenate(ids), np.concatenate(slots), np.concatenate(rays), inv_depths


def steady(params: Params, seed: int = 0, **options) -> Synthetic:
    """A window in full flight: the prior of the frame that left, solved estimates, and a newest frame predicted."""
    flight = make(seed, n_frames=params.window.size + 2, **options)

    def part(window: WindowState, frames: slice) -> WindowState:
        chosen = window.frames[frames]
        known = np.unique(np.concatenate([f.observations.ids for f in chosen]))
        table = window.landmarks
        rows = np.searchsorted(table.ids, known)
        return replace(window, frames=chosen, landmarks=Landmarks(known, table.inv_depth[rows], table.status[rows]))

    start = part(flight.window, slice(-1))
    assembly = assemble(params, start, GRAVITY)
    window = unpack(start, assembly, solve(params.solver, 30, assembly.problem).states)
    prior, _ = marginalize_oldest(params, window, GRAVITY)
    newest = flight.window.frames[-1]
    last = window.frames[-1]
    newest = replace(newest, b_a=last.b_a, b_g=last.b_g)
    slid = drop_oldest(replace(window, frames=(*window.frames, newest), prior=prior))
    table = flight.truth.landmarks  # landmarks first seen by the newest frames
    rows = np.searchsorted(table.ids, slid.landmarks.ids)
    unknown = ~np.isfinite(slid.landmarks.inv_depth)
    inv_depth = np.where(unknown, table.inv_depth[rows], slid.landmarks.inv_depth)
    landmarks = Landmarks(slid.landmarks.ids, inv_depth, np.full(len(rows), TRIANGULATED, np.uint8))
    truth = part(flight.truth, slice(1, None))
    return Synthetic(replace(slid, landmarks=landmarks), truth, flight.noise)
