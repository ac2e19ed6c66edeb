"""Keyframes on laps with known truth: odometry that drifts, loops that do not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vins_core import params
from vins_core.geometry import heading, poses, so3
from vins_core.pose_graph.graph import PoseGraph, begin_session, extend, frozen

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
UPRIGHT = so3.exp(np.array([0.0, -np.pi / 2, 0.0]))
"""An IMU whose x axis points up, so that its Euler pitch is -90 degrees (REFERENCE 23.1)."""


@dataclass(frozen=True)
class World:
    graph: PoseGraph
    truth: np.ndarray  # (n, 7)
    wrong: np.ndarray  # (l,) bool: loops that measure nonsense

    def error_m(self, graph: PoseGraph) -> np.ndarray:
        """(n,) distance of the corrected positions from the truth; both begin at the same pose."""
        return np.linalg.norm(graph.T_corrected[:, :3] - self.truth[:, :3], axis=1)


def settings(**changes) -> params.PoseGraph:
    return replace(params.PoseGraph(), **changes)


def laps(
    n: int = 160,
    lap: int = 50,
    n_loops: int = 30,
    *,
    seed: int = 0,
    step_m: float = 0.004,
    turn_deg: float = 0.1,
    loop_m: float = 0.01,
    loop_deg: float = 0.1,
    wrong: float = 0.0,
    mount: np.ndarray = LEVEL,
) -> World:
    """n keyframes, `lap` a lap; odometry walks by step_m and turn_deg a keyframe, loops go back whole laps."""
    rng = np.random.default_rng(seed)
    truth = trajectory(n, lap)
    later = np.sort(rng.choice(np.arange(lap + 5, n), n_loops, replace=False))
    earlier = later - lap * rng.integers(1, later // lap + 1) + rng.integers(0, 4, n_loops)
    T_loops = poses.between(truth[earlier], truth[later])
    T_loops[:, :3] += rng.normal(0, loop_m, (n_loops, 3))
    T_loops[:, 3:] = so3.retract(T_loops[:, 3:], rng.normal(0, np.deg2rad(loop_deg), (n_loops, 3)))
    is_wrong = rng.random(n_loops) < wrong
    T_loops[is_wrong, :3] += rng.normal(0, 3, (is_wrong.sum(), 3))
    T_vio, T_l_b = drifting(truth, rng, step_m, turn_deg), np.append(np.zeros(3), mount)
    T_loops = poses.compose(poses.inverse(T_l_b), poses.compose(T_loops, T_l_b))
    graph = build(poses.compose(T_vio, T_l_b), np.stack([earlier, later], 1), T_loops)
    return World(graph, poses.compose(truth, T_l_b), is_wrong)


def trajectory(n: int, lap: int) -> np.ndarray:
    """(n, 7) poses of a body that rolls and pitches a little while it goes round."""
    a = 2 * np.pi * np.arange(n) / lap
    p = np.stack([5 * np.cos(a), 5 * np.sin(a), 0.5 * np.sin(3 * a)], 1)
    tilt = so3.exp(np.stack([0.05 * np.sin(5 * a), 0.05 * np.cos(4 * a), 0 * a], 1))
    return np.concatenate([p, so3.multiply(heading.about_gravity(a + np.pi / 2), tilt)], 1)


def drifting(truth: np.ndarray, rng: np.random.Generator, step_m: float, turn_deg: float) -> np.ndarray:
    """Odometry along the truth: each step turned about gravity by a random walk and lengthened at random."""
    n = len(truth)
    turned = heading.about_gravity(np.append(0.0, np.cumsum(rng.normal(0, np.deg2rad(turn_deg), n - 1))))
    steps = so3.rotate(turned[:-1], np.diff(truth[:, :3], axis=0)) + rng.normal(0, step_m, (n - 1, 3))
    p = truth[0, :3] + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, 0)])
    return np.concatenate([p, so3.multiply(turned, truth[:, 3:])], 1)


def build(T_vio: np.ndarray, loops: np.ndarray, T_loops: np.ndarray) -> PoseGraph:
    """A graph of one session."""
    return append(begin_session(PoseGraph()), T_vio, loops, T_loops)


def append(graph: PoseGraph, T_vio: np.ndarray, loops: np.ndarray, T_loops: np.ndarray) -> PoseGraph:
    """Keyframes of the newest session and loops, without merging."""
    k = len(graph) + np.arange(len(T_vio))
    session = np.full(len(k), len(graph.sessions) - 1)
    return extend(graph, 10 * k, k * 100_000_000, session, T_vio, np.asarray(loops).reshape(-1, 2), T_loops)


def displaced(graph: PoseGraph, held: int, seed: int = 0, dof: int = 4) -> PoseGraph:
    """`graph` as if an optimisation had left all keyframes after `held` in the wrong place."""
    rng = np.random.default_rng(seed)
    T = graph.T_corrected.copy()
    n = len(T) - held - 1
    T[held + 1 :, :3] += rng.normal(0, 0.3, (n, 3))
    turns = so3.exp(rng.normal(0, 0.1, (n, 3)) * ([0, 0, 1] if dof == 4 else [1, 1, 1]))
    T[held + 1 :, 3:] = so3.multiply(turns, T[held + 1 :, 3:])
    return replace(graph, optimized=frozen(T))
