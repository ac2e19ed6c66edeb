"""How the simulated body moves: each motion is a plain function of time (see `trajectory.Channels`).

Angles follow the forward-left-up convention: yaw turns left, positive pitch looks down, positive roll leans right.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry import so3
from . import suite
from .trajectory import Channels, attitude

REST_S = 0.5  # every moving scenario starts at rest
RISE_S = 1.0  # and reaches its speed within this time
LOOP_RADII_M = (2.4, 1.8)
LOOP_PERIOD_S = 20.0
HEIGHT_M = 1.5
LAP_S, DOORWAY_S, CORRIDOR_S = 11.0, 3.0, 5.0  # in a room, through its doorway, along the corridor


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


def drive(radii_m: tuple[float, float], period_s: float, height_m: float, start_s: float = REST_S) -> Channels:
    """A vehicle on an ellipse, turning left, with its nose along the way, on a road that is not quite even."""

    def channels(t_s: np.ndarray) -> np.ndarray:
        angle = 2 * np.pi * run_up(t_s, start_s, 2 * RISE_S) / period_s
        a, b = radii_m
        yaw = np.unwrap(np.arctan2(b * np.cos(angle), -a * np.sin(angle)))
        path = np.stack([a * np.cos(angle), b * np.sin(angle), np.full_like(angle, height_m), yaw], -1)
        bumps = np.array([0.0, 0.0, 0.25, 0.0, 0.15, 0.15]) * sway(t_s)
        return np.hstack([path, np.zeros((len(t_s), 2))]) + switch_on(t_s, start_s, 2 * RISE_S)[:, None] * bumps

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


def progress(t_s: np.ndarray, start_s: float, end_s: float, rise_s: float = RISE_S) -> np.ndarray:
    """From 0 at `start_s` to 1 at `end_s`, at a steady rate but for soft ends."""
    return (run_up(t_s, start_s, rise_s) - run_up(t_s, end_s - rise_s, rise_s)) / (end_s - rise_s - start_s)


def rounds(
    visits: Sequence[int], start_deg: float = 0.0, radius_m: float = 1.2, height_m: float = 1.4, start_s: float = REST_S
) -> Channels:
    """One lap in each of some rooms of a suite, looking inwards; between two of them out to the corridor and along it.

    The first lap begins at `start_deg` and ends, like all of them, at the door.
    """
    laps: list[tuple[float, float, float]] = []
    ways: list[tuple[float, int, int]] = []
    t_s = start_s
    for before, room in zip([None, *visits], visits):
        if before is not None:
            ways.append((t_s, before, room))
            t_s += 2 * DOORWAY_S + CORRIDOR_S
        turned_deg = 360.0 if laps else 360.0 - start_deg
        laps.append((t_s, t_s + LAP_S * turned_deg / 360.0, np.radians(turned_deg)))
        t_s = laps[-1][1]

    def channels(t_s: np.ndarray) -> np.ndarray:
        angle = np.radians(start_deg) + sum(turn * progress(t_s, *span) for *span, turn in laps)
        position = np.tile(suite.centre_m(visits[0]), (len(t_s), 1))
        position += radius_m * np.stack([np.cos(angle), np.sin(angle)], -1)
        yaw = angle + np.pi
        for t, before, room in ways:
            out = progress(t_s, t, t + DOORWAY_S)
            along = progress(t_s, t + DOORWAY_S, t + DOORWAY_S + CORRIDOR_S)
            back = progress(t_s, t + DOORWAY_S + CORRIDOR_S, t + 2 * DOORWAY_S + CORRIDOR_S)
            position[:, 0] += (suite.CORRIDOR_X_M - suite.ROOM_X_M - radius_m) * (out - back)
            position[:, 1] += (room - before) * suite.PITCH_M * along
            glance = progress(t_s, t + DOORWAY_S - 1.0, t + DOORWAY_S + 1.5)
            glance -= progress(t_s, t + DOORWAY_S + CORRIDOR_S - 1.5, t + DOORWAY_S + CORRIDOR_S + 1.0)
            yaw -= np.sign(room - before) * np.radians(55.0) * glance
        gaze = np.stack([yaw, np.zeros_like(yaw), np.zeros_like(yaw)], -1)
        path = np.column_stack([position, np.full(len(t_s), height_m), gaze])
        return path + switch_on(t_s, start_s, RISE_S)[:, None] * sway(t_s)

    return channels
