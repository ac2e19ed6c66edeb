"""An exact motion: one quintic spline of position and attitude angles, so every derivative is analytic.

Frames: `w` world, z up; `f` the vehicle's forward-left-up frame; `b` body = IMU, fixed in `f` by `q_f_b`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from ..geometry import so3

KNOT_INTERVAL_S = 0.02
DEGREE = 5
MARGIN = 64  # knots beyond both ends, so that the end conditions are not felt

Channels = Callable[[np.ndarray], np.ndarray]
"""Times in seconds (n,) -> (n, 6): x, y, z of the body in metres, then yaw, pitch, roll of `f` in radians."""


@dataclass(frozen=True)
class Kinematics:
    """The state of the body at times `t_s`, without any error."""

    t_s: np.ndarray  # (n,)
    p_w_b: np.ndarray  # (n, 3) m
    q_w_b: np.ndarray  # (n, 4) wxyz
    v_w_b: np.ndarray  # (n, 3) m/s
    a_w_b: np.ndarray  # (n, 3) m/s^2, of the body's origin, without gravity
    omega_b_rad_s: np.ndarray  # (n, 3) angular velocity, in body coordinates

    def specific_force_m_s2(self, gravity_m_s2: float) -> np.ndarray:
        """What an ideal accelerometer measures: R_b_w (a_w_b - g_w), g_w = (0, 0, -gravity), in b, (n, 3)."""
        return so3.rotate(so3.inverse(self.q_w_b), self.a_w_b + np.array([0.0, 0.0, gravity_m_s2]))


@dataclass(frozen=True)
class Motion:
    """The spline *is* the motion: position, velocity, acceleration and angular velocity agree to rounding."""

    spline: BSpline  # (6 channels) over time in seconds
    q_f_b: np.ndarray  # (4,)

    @staticmethod
    def from_channels(channels: Channels, duration_s: float, q_f_b: np.ndarray) -> Motion:
        """The C^4 spline through `channels` at 50 Hz, valid from 0 to `duration_s`."""
        count = int(np.ceil(duration_s / KNOT_INTERVAL_S)) + 2 * MARGIN
        t_s = (np.arange(count) - MARGIN) * KNOT_INTERVAL_S
        return Motion(make_interp_spline(t_s, channels(t_s), k=DEGREE), q_f_b)

    def at(self, t_s: np.ndarray) -> Kinematics:
        """Kinematics at times (n,).

        For R_w_f = Rz(yaw) Ry(pitch) Rx(roll) the angular velocity in `f` is
        (roll' - yaw' sin(pitch), pitch' cos(roll) + yaw' cos(pitch) sin(roll), yaw' cos(pitch) cos(roll) - pitch'
        sin(roll)).
        """
        t_s = np.asarray(t_s, float)
        value, rate, acceleration = (self.spline(t_s, derivative) for derivative in range(3))
        _, pitch, roll = value[:, 3:].T
        yaw_rate, pitch_rate, roll_rate = rate[:, 3:].T
        omega_f = np.stack(
            [
                roll_rate - yaw_rate * np.sin(pitch),
                pitch_rate * np.cos(roll) + yaw_rate * np.cos(pitch) * np.sin(roll),
                yaw_rate * np.cos(pitch) * np.cos(roll) - pitch_rate * np.sin(roll),
            ],
            -1,
        )
        return Kinematics(
            t_s,
            value[:, :3],
            so3.normalize(so3.multiply(attitude(value[:, 3:]), self.q_f_b)),
            rate[:, :3],
            acceleration[:, :3],
            so3.rotate(so3.inverse(self.q_f_b), omega_f),
        )


def attitude(angles_rad: np.ndarray) -> np.ndarray:
    """(n, 3) yaw, pitch, roll -> q_w_f (n, 4) = qz(yaw) qy(pitch) qx(roll)."""
    yaw, pitch, roll = (so3.exp(angles_rad[..., i : i + 1] * axis) for i, axis in enumerate(np.eye(3)[::-1]))
    return so3.multiply(so3.multiply(yaw, pitch), roll)
