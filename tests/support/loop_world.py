"""A world of points that carry their descriptors: keyframes of it without images, with a vocabulary that fits."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from vins_core.geometry import poses, se3, so3
from vins_core.loop import step
from vins_core.loop.keyframe import LoopKeyframe
from vins_core.loop.train import train
from vins_core.loop.vocabulary import Vocabulary

LOOKING_AHEAD = se3.from_rotation_translation(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.1, 0.02, -0.03])
)
"""T_b_c of a camera that looks along the body's x axis: a level body has a level camera."""
FOCAL, WIDTH, HEIGHT = 400.0, 640, 480
PX = 1.0 / 460.0
PLACES = 40
ODOMETRY = np.diag([1e-4] * 3 + [1e-6] * 3)
"""Covariance of the motion between any two keyframes: 1 cm and 0.06 degrees."""


@lru_cache(maxsize=4)
def world(place: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points (400, 3) in front of the origin and their descriptors (400, 32); another place has other ones."""
    rng = np.random.default_rng([7, place])
    points = np.stack([rng.uniform(4, 9, 400), rng.uniform(-6, 6, 400), rng.uniform(-3, 3, 400)], 1)
    return points, rng.integers(0, 256, (400, 32), np.uint8)


@lru_cache(maxsize=1)
def vocabulary() -> Vocabulary:
    return train([world(place)[1] for place in range(PLACES)], "orb-upright")


def pose(p=(0.0, 0.0, 0.0), yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0) -> np.ndarray:
    """T_w_b (7,)."""
    about = [np.radians(a) * axis for a, axis in zip((yaw_deg, pitch_deg, roll_deg), np.eye(3)[::-1])]
    q = so3.multiply(so3.multiply(so3.exp(about[0]), so3.exp(about[1])), so3.exp(about[2]))
    return np.concatenate([p, q])


def keyframe(
    T_w_b: np.ndarray,
    *,
    place: int = 0,
    number: int = 0,
    n_landmarks: int = 60,
    n_points: int = 300,
    noise_px: float = 0.0,
    flips: int = 0,
    drift: np.ndarray | None = None,
    T_b_c: np.ndarray = LOOKING_AHEAD,
    seed: int = 0,
) -> LoopKeyframe:
    """What a camera at `T_w_b` sees of a place: rays with `noise_px` of noise (px460), `flips` bits wrong in each.

    `drift` (7,) is by how much the odometry's world is off: positions and pose are told in that world.
    """
    rng = np.random.default_rng([11, place, number, seed])
    points, descriptors = world(place)
    local = se3.transform(se3.inverse(_matrix(T_w_b) @ T_b_c), points)
    plane = local[:, :2] / np.maximum(local[:, 2:], 1e-6)
    uv_px = FOCAL * plane + [WIDTH / 2, HEIGHT / 2]
    seen = (local[:, 2] > 0.1) & np.all((uv_px > 0) & (uv_px < [WIDTH, HEIGHT]), axis=1)
    rows = rng.permutation(np.flatnonzero(seen))[:n_points]
    plane = plane[rows] + rng.normal(0, noise_px * PX, (len(rows), 2)) if noise_px else plane[rows]
    rays = np.concatenate([plane, np.ones((len(rows), 1))], 1)
    bits = np.unpackbits(descriptors[rows], axis=1)
    for row in bits if flips else ():
        row[rng.permutation(256)[:flips]] ^= 1
    described = np.packbits(bits, axis=1)
    drift = poses.IDENTITY if drift is None else drift
    landmarks = points[rows[:n_landmarks]]
    return LoopKeyframe(
        number,
        number * 100_000_000,
        poses.compose(drift, T_w_b),
        T_b_c,
        rows[:n_landmarks].astype(np.int64),
        se3.transform(_matrix(drift), landmarks),
        uv_px[rows].astype(np.float32),
        (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32),
        described,
        vocabulary().bag_of(described),
        ODOMETRY,
    )


def remembered(keyframes: list[LoopKeyframe]) -> step.LoopState:
    state = step.begin(vocabulary().limits)
    for k in keyframes:
        state = step.remember(state, k)
    return state


def _matrix(T: np.ndarray) -> np.ndarray:
    return se3.from_quaternion_translation(T[3:], T[:3])
