"""Everything GPS of a run as arrays: what the map, the plots, the timeline and the 3D view draw.

Frame `e` is east-north-up at the run's origin.  From the frame summaries alone, so that opening a long run stays fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from vins_core.geometry import poses
from vins_core.report import FixVerdict, FrameSummary, GpsStatus

VERDICTS = tuple(FixVerdict)
UNKNOWN = -1
"""Verdict of a fix that has not come yet."""


@dataclass(frozen=True)
class GpsSeries:
    """Rows of fixes (m,) in the order of their judgement, and of frames (n,); NaN where a quantity does not exist."""

    # fixes
    t_ns: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    frame: np.ndarray = field(default_factory=lambda: np.zeros(0, int))  # in which it was judged first
    z_e: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # of the antenna
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    failed: tuple[tuple[str, ...], ...] = ()  # names of the gates each did not pass
    # verdicts: (c,) frame, fix, index into VERDICTS; by frame, so that the last one of a fix stands
    changes: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), int))
    # frames
    fused: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))  # GPS was at work
    fusing: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))  # fixes count
    T_e_b: np.ndarray = field(default_factory=lambda: np.zeros((0, 7)))
    T_e_o: np.ndarray = field(default_factory=lambda: np.zeros((0, 7)))
    yaw_deg: np.ndarray = field(default_factory=lambda: np.zeros(0))  # of T_e_o
    yaw_sigma_deg: np.ndarray = field(default_factory=lambda: np.zeros(0))
    outage_s: np.ndarray = field(default_factory=lambda: np.zeros(0))  # since the last fix that counted

    def __len__(self) -> int:
        """Fixes."""
        return len(self.t_ns)

    def verdicts(self, frame: int) -> np.ndarray:
        """(m,) index into VERDICTS as they stood after a frame, UNKNOWN for fixes that had not come."""
        found = np.full(len(self), UNKNOWN)
        until = int(np.searchsorted(self.changes[:, 0], frame, side="right"))
        for _, fix, verdict in self.changes[:until].tolist():
            found[fix] = verdict
        return found

    @cached_property
    def final_verdicts(self) -> np.ndarray:
        """(m,) as they stand after the last frame."""
        return self.verdicts(np.iinfo(np.int64).max)

    def history(self, fix: int) -> list[tuple[int, FixVerdict]]:
        """(frame, verdict) of every change, the first being the judgement."""
        rows = self.changes[self.changes[:, 1] == fix]
        return [(int(frame), VERDICTS[verdict]) for frame, _, verdict in rows.tolist()]

    def in_outage(self, limit_s: float) -> np.ndarray:
        """(n,) frames of which the last fix that counted is longer ago."""
        with np.errstate(invalid="ignore"):
            return self.fusing & (self.outage_s > limit_s)

    def T_o_e(self, frame: int) -> np.ndarray | None:
        """From the earth into the odometry's world as a frame knew it, (7,); before that was known, as it was first."""
        known = np.flatnonzero(np.isfinite(self.T_e_o[:, 0]))
        if not len(known):
            return None
        k = max(int(np.searchsorted(known, frame, side="right")) - 1, 0)
        return poses.inverse(self.T_e_o[known[k]])


def gps_series(summaries: Sequence[FrameSummary]) -> GpsSeries:
    """All rows at once; without any where no fix came."""
    fixes = [(s.frame, fix) for s in summaries if s.gps is not None for fix in s.gps.fixes]
    if not fixes:
        return GpsSeries()
    row: dict[int, int] = {}  # by stamp: of two with the same the first, since another never counts
    for k, (_, fix) in enumerate(fixes):
        row.setdefault(fix.t_ns, k)
    judged = [(frame, k, VERDICTS.index(fix.verdict)) for k, (frame, fix) in enumerate(fixes)]
    revised = [
        (s.frame, row[r.t_ns], VERDICTS.index(r.verdict))
        for s in summaries
        if s.gps is not None
        for r in s.gps.revised
        if r.t_ns in row
    ]
    gps = [s.gps for s in summaries]
    return GpsSeries(
        t_ns=np.array([f.t_ns for _, f in fixes], np.int64),
        frame=np.array([frame for frame, _ in fixes], int),
        z_e=_rows([f.z_e for _, f in fixes], (3,)),
        covariance=_rows([f.covariance for _, f in fixes], (3, 3)),
        failed=tuple(f.failed for _, f in fixes),
        changes=np.array(sorted([*judged, *revised], key=lambda change: change[0]), int).reshape(-1, 3),
        fused=np.array([g is not None for g in gps], bool),
        fusing=np.array([g is not None and g.status is GpsStatus.FUSING for g in gps], bool),
        T_e_b=_rows([g.T_e_b if g else None for g in gps], (7,)),
        T_e_o=_rows([g.T_e_o if g else None for g in gps], (7,)),
        yaw_deg=_numbers([g.yaw_deg if g else None for g in gps]),
        yaw_sigma_deg=_numbers([g.yaw_sigma_deg if g else None for g in gps]),
        outage_s=_numbers([g.outage_s if g else None for g in gps]),
    )


def _rows(values: Sequence[np.ndarray | None], shape: tuple[int, ...]) -> np.ndarray:
    nothing = np.full(shape, np.nan)
    return np.array([nothing if v is None else v for v in values], float).reshape(-1, *shape)


def _numbers(values: Sequence[float | None]) -> np.ndarray:
    return np.array([np.nan if v is None else v for v in values], float)
