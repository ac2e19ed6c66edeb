"""A drive with known truth: a road with turns, stereo-like odometry that drifts, GPS fixes with outliers and an outage.

No images: what GPS fusion (vins_core/fusion) gets.  Odometry is the truth's motion between frames with

    scale    Gauss-Markov over the path, kept = exp(-d / length)
    heading  random walk over the path, beside a constant rate
    position white over the path

which together make `drift` of the path, as stereo odometry on KITTI has (translation error over sub-paths of 100 m and
more).  Deterministic by seed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ..fusion.geodesy import EnuFrame
from ..geometry import heading, poses, so3
from ..sensors import GpsFix
from .receiver import START, Receiver, measure

TICK_S = 0.01
"""Truth is laid out this finely."""


@dataclass(frozen=True)
class OdometryError:
    scale_sigma: float = 0.012
    scale_length_m: float = 200.0
    yaw_walk_deg: float = 0.035  # per sqrt(m)
    yaw_rate_deg: float = 0.001  # per m, standard deviation of the constant part
    tilt_walk_deg: float = 0.0  # per sqrt(m), roll and pitch
    position_walk: float = 0.04  # m per sqrt(m)


@dataclass(frozen=True)
class Road:
    length_m: float = 1000.0
    speed_m_s: float = 10.0
    frame_hz: float = 10.0
    start: EnuFrame = START


@dataclass(frozen=True)
class Drive:
    """Truth in the ENU frame at the road's start; odometry begins level at its own origin with heading 0."""

    t_ns: np.ndarray  # (n,) int64
    truth: np.ndarray  # (n, 7) T_start_b
    T_o_b: np.ndarray  # (n, 7)
    fixes: tuple[GpsFix, ...]
    outlier: np.ndarray  # (m,) bool
    p_b_gps: np.ndarray  # (3,)
    outage_ns: tuple[int, int]
    start: EnuFrame

    def truth_in(self, frame: EnuFrame) -> np.ndarray:
        """T_e_b (n, 7) in another ENU frame nearby; that its axes are turned by 0.01 degree a kilometre is left out."""
        p_e = frame.from_geodetic(*self.start.to_geodetic(self.truth[:, :3]))
        return np.concatenate([p_e, self.truth[:, 3:]], 1)

    @property
    def in_outage(self) -> np.ndarray:
        """(n,) bool."""
        return (self.t_ns >= self.outage_ns[0]) & (self.t_ns <= self.outage_ns[1])

    @property
    def relative_drift(self) -> float:
        """Mean error of the odometry over sub-paths of 100 m to 800 m, as a share of their length (KITTI's metric)."""
        path = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.truth[:, :3], axis=0), axis=1)))
        errors = []
        for length in range(100, 900, 100):
            i = np.arange(0, np.searchsorted(path, path[-1] - length), 10)
            j = np.searchsorted(path, path[i] + length)
            seen = poses.between(self.T_o_b[i], self.T_o_b[j])[:, :3]
            errors.append(np.linalg.norm(seen - poses.between(self.truth[i], self.truth[j])[:, :3], axis=1) / length)
        return float(np.mean(np.concatenate(errors)))


def drive(
    seed: int,
    road: Road | None = None,
    odometry: OdometryError | None = None,
    receiver: Receiver | None = None,
) -> Drive:
    """One drive; the same seed gives the same drive."""
    road, odometry, receiver = road or Road(), odometry or OdometryError(), receiver or Receiver()
    road_rng, odometry_rng, gps_rng = (np.random.default_rng([seed, part]) for part in range(3))
    t_s, truth = _truth(road, road_rng)
    every = round(1.0 / (road.frame_hz * TICK_S))
    T_o_b = _drifting(truth[::every], odometry, odometry_rng)
    fixes, outlier = _fixes(t_s, truth, road, receiver, gps_rng)
    frames_ns = np.round(t_s[::every] * 1e9).astype(np.int64)
    begin, end = (round(s * 1e9) for s in receiver.outage_s)
    return Drive(frames_ns, truth[::every], T_o_b, fixes, outlier, np.array(receiver.p_b_gps), (begin, end), road.start)


def _truth(road: Road, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Times (k,) and poses (k, 7): straights and bends in turn, hills, and a car that leans a little in bends."""
    n = round(road.length_m / road.speed_m_s / TICK_S) + 1
    t_s = np.arange(n) * TICK_S
    knots_s = [0.0]
    curvature = [0.0]
    while knots_s[-1] < t_s[-1] + 10.0:
        turn, duration_s = np.deg2rad(rng.uniform(20, 95)) * rng.choice([-1, 1]), rng.uniform(3, 6)
        straight_s, peak = rng.uniform(2, 9), 2 * turn / (duration_s * road.speed_m_s)
        knots_s += [knots_s[-1] + straight_s + share * duration_s for share in (0.0, 0.5, 1.0)]
        curvature += [0.0, peak, 0.0]
    bend = np.interp(t_s, knots_s, curvature)
    yaw = rng.uniform(-np.pi, np.pi) + _integral(bend * road.speed_m_s)
    hill = CubicSpline(np.arange(-10, t_s[-1] + 21, 10.0), rng.normal(0, 2.0, len(np.arange(-10, t_s[-1] + 21, 10.0))))
    slope = hill(t_s, 1) / road.speed_m_s
    along = road.speed_m_s * np.stack([np.cos(yaw), np.sin(yaw)], 1)
    p = np.column_stack([_integral(along[:, 0]), _integral(along[:, 1]), hill(t_s) - hill(0.0)])
    lean = np.stack([0.004 * bend * road.speed_m_s**2, -np.arctan(slope), np.zeros(n)], 1)
    q = so3.multiply(heading.about_gravity(yaw), so3.multiply(so3.exp(lean * [0, 1, 0]), so3.exp(lean * [1, 0, 0])))
    return t_s, np.concatenate([p, q], 1)


def _integral(rate: np.ndarray) -> np.ndarray:
    """By trapezes, from 0."""
    return np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * TICK_S))


def _drifting(truth: np.ndarray, error: OdometryError, rng: np.random.Generator) -> np.ndarray:
    """(n, 7) T_o_b with errors along the way."""
    level = heading.about_gravity(heading.turn(truth[0, 3:]))
    way = so3.rotate(so3.inverse(level), np.diff(truth[:, :3], axis=0))
    d = np.linalg.norm(way, axis=1)
    kept = np.exp(-d / error.scale_length_m)
    scale = np.empty(len(d))
    s = error.scale_sigma * rng.normal()
    for k, noise in enumerate(rng.normal(size=len(d))):
        scale[k] = s
        s = kept[k] * s + error.scale_sigma * np.sqrt(1.0 - kept[k] ** 2) * noise
    walk = np.deg2rad([error.tilt_walk_deg, error.tilt_walk_deg, error.yaw_walk_deg])
    steps = rng.normal(size=(len(d), 3)) * walk * np.sqrt(d)[:, None]
    steps[:, 2] += np.deg2rad(error.yaw_rate_deg) * rng.normal() * d
    turned = np.empty((len(truth), 4))
    turned[0] = so3.exp(np.zeros(3))
    for k in range(len(d)):
        turned[k + 1] = so3.multiply(turned[k], so3.exp(steps[k]))
    white = rng.normal(size=(len(d), 3)) * error.position_walk * np.sqrt(d)[:, None]
    moved = so3.rotate(turned[:-1], (1.0 + scale)[:, None] * way + white)
    p = np.concatenate([np.zeros((1, 3)), np.cumsum(moved, 0)])
    q = so3.multiply(turned, so3.multiply(so3.inverse(level), truth[:, 3:]))
    return np.concatenate([p, so3.normalize(q)], 1)


def _fixes(
    t_s: np.ndarray, truth: np.ndarray, road: Road, receiver: Receiver, rng: np.random.Generator
) -> tuple[tuple[GpsFix, ...], np.ndarray]:
    period = round(1.0 / (receiver.rate_hz * TICK_S))
    at = np.arange(round(receiver.first_s / TICK_S), len(t_s) - 1, period)
    antenna = truth[at, :3] + so3.rotate(truth[at, 3:], np.array(receiver.p_b_gps))
    return measure(receiver, t_s[at], antenna, road.start, rng, rng)
