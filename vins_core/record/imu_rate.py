"""A recorded run at the rate of its IMU: what it knew at each sample, and nothing that came later."""

from __future__ import annotations

import numpy as np

from ..geometry import poses
from ..report import PoseEstimate
from ..sensors import Trajectory
from ..window.imu_rate import carry_on, moved_estimate
from .reader import RunReader


def imu_rate_trajectory(run: RunReader) -> Trajectory:
    """The body at every IMU sample from the first pose on, in the world of the graph as its last optimisation had it.

    At a frame its own estimate, at the samples between two frames what the IMU made of the one before.  Stamps are
    those of the IMU's clock: t_image + td for frames.  Restarts leave a gap.  Raises RunError without IMU samples.
    """
    gravity, drift = np.array([0.0, 0.0, -run.header.calibration.gravity_m_s2]), poses.IDENTITY
    rows: list[tuple[np.ndarray, ...]] = []
    newest: PoseEstimate | None = None
    for k, summary in enumerate(run.summaries):
        if newest is None and summary.pose is None:
            continue
        imu = run.packet(k).imu
        if newest is not None:
            states = carry_on(newest, imu, gravity)
            rows.append(tuple(x[1:-1] for x in (states.t_ns, states.p_w_b, states.q_w_b, states.v_w_b)))
        if summary.closure is not None:
            drift = summary.closure.drift
        newest = summary.pose and moved_estimate(summary.pose, drift)
        if newest is not None and len(imu):
            rows.append((imu.t_ns[-1:], newest.p_w_b[None], newest.q_w_b[None], newest.v_w_b[None]))
    if not rows:
        return Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)))
    return Trajectory(*(np.concatenate(column) for column in zip(*rows)))
