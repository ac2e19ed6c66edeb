"""Where the IMU says the next frame is: dead reckoning from one frame to the next, and moving a whole window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..factors.preintegration import Preintegration
from ..geometry import so3
from ..report import PoseEstimate
from .state import WindowFrame, WindowState


def predict(frame: WindowFrame, imu: Preintegration, gravity_m_s2: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, attitude and velocity one interval after `frame` (seed 004.10):

    p' = p + v dt - g dt^2 / 2 + R dp,   q' = q * dq,   v' = v - g dt + R dv,   g = (0, 0, |g|).
    """
    g, dt = np.array([0.0, 0.0, gravity_m_s2]), imu.dt_s
    p = frame.p_w_b + frame.v_w_b * dt - 0.5 * g * dt * dt + so3.rotate(frame.q_w_b, imu.delta_p)
    q = so3.normalize(so3.multiply(frame.q_w_b, imu.delta_q))
    v = frame.v_w_b - g * dt + so3.rotate(frame.q_w_b, imu.delta_v)
    return p, q, v


def heading_between(q_from: np.ndarray, q_to: np.ndarray) -> float:
    """The turn about gravity that best takes attitude `q_from` to `q_to`, rad.

    It maximises trace(Rz(angle)' R_to R_from'), and unlike a difference of Euler yaws has no singular pitch
    (REFERENCE O9, 23.1).
    """
    D = so3.to_matrix(q_to) @ so3.to_matrix(q_from).T
    return float(np.arctan2(D[1, 0] - D[0, 1], D[0, 0] + D[1, 1]))


def move(window: WindowState, angle_rad: float, pivot: np.ndarray, target: np.ndarray) -> WindowState:
    """The same window turned about gravity around `pivot` and shifted so that `pivot` comes to `target`.

    Only a window without prior may be moved far: a prior remembers where it was linearised.
    """
    turn = so3.exp(np.array([0.0, 0.0, angle_rad]))
    frames = tuple(
        replace(
            f,
            p_w_b=so3.rotate(turn, f.p_w_b - pivot) + target,
            q_w_b=so3.normalize(so3.multiply(turn, f.q_w_b)),
            v_w_b=so3.rotate(turn, f.v_w_b),
        )
        for f in window.frames
    )
    return replace(window, frames=frames)


def continue_from(window: WindowState, pose: PoseEstimate) -> WindowState:
    """A freshly initialised window, placed so that its oldest frame starts at `pose`: position and heading.

    A window without IMU, which has but one frame then, takes all of it.
    """
    oldest = window.frames[0]
    if not window.inertial:
        return replace(window, frames=(replace(oldest, p_w_b=pose.p_w_b, q_w_b=pose.q_w_b), *window.frames[1:]))
    return move(window, heading_between(oldest.q_w_b, pose.q_w_b), oldest.p_w_b, pose.p_w_b)
