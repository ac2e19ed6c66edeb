"""How the simulated body moves: each motion is a plain function of time (see `trajectory.Channels`).

Angles follow the forward-left-up convention: yaw turns left, positive pitch looks down, positive roll leans right.
"""

from __future__ import annotations

import numpy as np

from ..geometry import so3
from .trajectory import Channels, attitude

REST_S = 0.5  # every moving scenario starts at rest
RISE_S = 1.0  # and reaches its speed within this time
LOOP_RADII_M = (2.4, 1.8)
LOOP_PERIOD_S = 20.0
HEIGHT_M = 1.5


def switch_on(t_s: np.ndarray, start_s: float, rise_s: float) -> np.ndarray:
    """0 before `start_s`, 1 after `start_s + rise_s`, three times continuously differentiable between."""
    x = np.clip((t_s - start_s) / rise_s, 0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)


def run_up(t_s: np.ndarray, start_s: float, rise_s: float) -> np.ndarray:
    """The integral of `switch_on`: a clock in seconds that starts softly at `start_s` and then keeps time."""
    x = np.clip((t_s - start_s) / rise_s, 0.0, 1.0)
    return rise_s * x**5 * (7.0 - 14.0 * x + 10.0 * x**2 - 2.5 * x**3) + np.maximum(t_s - start_s - rise_s, 0.0)


def sway(t_s: np.ndarray) -> np.ndarray:
    """What a hand adds to a path: (n, 6) with 1-3 m/s^2 and a few degrees, no two channels in step."""
    amplitude = np.array([0.06, 0.06, 0.09, 0.07, 0.05, 0.06])  # m, rad
    frequency_hz = np.array([0.61, 0.53, 0.67, 0.37, 0.47, 0.43])
    phase = np.array([0.3, 1.9, 0.0, 2.6, 1.1, 0.6])
    return amplitude * (np.sin(2 * np.pi * frequency_hz * t_s[:, None] + phase) - np.sin(phase))


def loop(start_s: float = REST_S, period_s: float = LOOP_PERIOD_S) -> Channels:
    """Laps around the room, looking forward and outwards so that the start is seen again only at the end of a lap."""

    def channels(t_s: np.ndarray) -> np.ndarray:
        angle = 2 * np.pi * run_up(t_s, start_s, RISE_S) / period_s
        a, b = LOOP_RADII_M
        tangent = np.unwrap(np.arctan2(b * np.cos(angle), -a * np.sin(angle)))
        path = np.stack([a * np.cos(angle), b * np.sin(angle), np.full_like(angle, HEIGHT_M)], -1)
        yaw = tangent - np.radians(60.0)
        gaze = np.stack([yaw, np.zeros_like(yaw), np.zeros_like(yaw)], -1)
        return np.hstack([path, gaze]) + switch_on(t_s, start_s, RISE_S)[:, None] * sway(t_s)

    return channels


def standstill() -> Channels:
    """On a tripod: nothing moves."""

    def channels(t_s: np.ndarray) -> np.ndarray:
        return np.tile([LOOP_RADII_M[0], 0.0, HEIGHT_M, np.radians(30.0), 0.0, 0.0], (len(t_s), 1))

    return channels


def pure_rotation(p_f_c: np.ndarray) -> Channels:
    """Turning about the camera's centre, which lies at `p_f_c` (3,) m from the body's origin: no parallax at all."""
    centre = np.array([-2.2, -1.2, HEIGHT_M])

    def channels(t_s: np.ndarray) -> np.ndarray:
        turned = run_up(t_s, REST_S, RISE_S)
        angles = np.stack(
            [0.5 * turned, 0.12 * np.sin(1.3 * turned), 0.10 * np.sin(0.9 * turned)],
            -1,
        )
        return np.hstack([centre - so3.rotate(attitude(angles), p_f_c), angles])

    return channels


def constant_velocity(until_s: float, speed_m_s: float = 0.6) -> Channels:
    """A straight glide without rotation or acceleration until `until_s`, then back and forth, swaying."""

    def channels(t_s: np.ndarray) -> np.ndarray:
        swinging = run_up(t_s, until_s, RISE_S)
        rate = 2 * np.pi / 9.0
        path = np.zeros((len(t_s), 6))
        path[:, :4] = [-3.2, -2.8, HEIGHT_M, np.radians(60.0)]
        path[:, 0] += speed_m_s * (t_s - swinging + np.sin(rate * swinging) / rate)
        return path + switch_on(t_s, until_s, RISE_S)[:, None] * sway(t_s)

    return channels
