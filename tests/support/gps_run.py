"""GPS fusion over a simulated drive, live and final, and how far both are from the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vins_core import params
from vins_core.fusion.smooth import Smoothed, smooth
from vins_core.fusion.state import GpsState, OdometryPose
from vins_core.fusion.step import step
from vins_core.geometry import heading
from vins_core.report import FixVerdict, GpsReport
from vins_core.simulation.drive import Drive


def settings(**changes) -> params.Gps:
    return params.replace(params.Params(), {f"gps.{k}": v for k, v in changes.items()}).gps


def steps(gps: params.Gps, drive: Drive, state: GpsState | None = None) -> Iterator[tuple[GpsState, GpsReport]]:
    """Frame by frame, each with the fixes that came since the last."""
    state, first = state or GpsState(), 0
    stamps = np.array([f.t_ns for f in drive.fixes], np.int64)
    for t_ns, T_o_b in zip(drive.t_ns.tolist(), drive.T_o_b):
        last = int(np.searchsorted(stamps, t_ns, side="right"))
        state, report = step(gps, drive.p_b_gps, state, OdometryPose(t_ns, T_o_b), drive.fixes[first:last])
        first = last
        yield state, report


@dataclass(frozen=True)
class Track:
    """Poses in `e` beside the truth; NaN where there is none."""

    T_e_b: np.ndarray  # (n, 7)
    covariance: np.ndarray  # (n, 6, 6)
    truth: np.ndarray  # (n, 7)

    @property
    def known(self) -> np.ndarray:
        return np.isfinite(self.T_e_b[:, 0])

    @property
    def error_m(self) -> np.ndarray:
        """(n, 3)."""
        return self.T_e_b[:, :3] - self.truth[:, :3]

    @property
    def yaw_error_deg(self) -> np.ndarray:
        return np.rad2deg(heading.difference(self.T_e_b[:, 3:], self.truth[:, 3:]))

    def horizontal_rmse_m(self, rows: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.sum(self.error_m[rows & self.known, :2] ** 2, 1))))

    def nees(self, rows: np.ndarray) -> float:
        """Mean of e' P^-1 e over its dimension, for position: 1 when the covariance is right."""
        k = rows & self.known
        e = self.error_m[k]
        return float(np.mean(np.einsum("na,nab,nb->n", e, np.linalg.inv(self.covariance[k, :3, :3]), e)) / 3)


@dataclass(frozen=True)
class Live:
    state: GpsState  # the last
    reports: list[GpsReport]
    track: Track
    verdicts: dict[int, FixVerdict]  # as they stood at the end

    @property
    def first(self) -> int:
        """The frame from which fixes count."""
        return int(np.argmax(self.track.known))

    def used(self, drive: Drive) -> np.ndarray:
        return np.array([self.verdicts.get(f.t_ns) is FixVerdict.USED for f in drive.fixes])


def live(gps: params.Gps, drive: Drive) -> Live:
    outcome = list(steps(gps, drive))
    reports, state = [r for _, r in outcome], outcome[-1][0]
    verdicts = {f.t_ns: f.verdict for r in reports for f in (*r.fixes, *r.revised)}
    T = np.array([np.full(7, np.nan) if r.T_e_b is None else r.T_e_b for r in reports])
    P = np.array([np.full((6, 6), np.nan) if r.covariance is None else r.covariance for r in reports])
    assert state.origin is not None
    return Live(state, reports, Track(T, P, drive.truth_in(state.origin)), verdicts)


def final(gps: params.Gps, drive: Drive) -> tuple[Smoothed, Track, np.ndarray]:
    """The smoothed run, its track, and which fixes it used (m,)."""
    smoothed = smooth(gps, drive.p_b_gps, drive.t_ns, drive.T_o_b, drive.fixes)
    assert isinstance(smoothed, Smoothed), smoothed
    track = Track(smoothed.T_e_b, smoothed.covariance, drive.truth_in(smoothed.origin))
    return smoothed, track, np.array([f.verdict is FixVerdict.USED for f in smoothed.fixes])
