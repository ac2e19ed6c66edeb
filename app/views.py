"""What panels ask of reports: selections of arrays and facts, without any markup."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from vins_core.report import (
    LANDMARK_STATUSES,
    LOSS_REASONS,
    CostSplit,
    FrameReport,
    LandmarkStatus,
    LossReason,
    TrackReport,
)

from .context import RunView
from .series import Event

TRAIL = 12
"""Frames of a track that are drawn behind it."""


def run_name(run: RunView) -> str:
    """The recording's own name, without its folders."""
    return PurePath(run.header.recording).name or "run"


# Tracks


def trails(run: RunView, report: FrameReport, length: int = TRAIL) -> np.ndarray:
    """(n, length + 1, 2) pixels of every track alive in `report`, oldest first, NaN where it was not seen."""
    now = report.tracks
    paths = np.full((len(now.ids), length + 1, 2), np.nan, np.float32)
    paths[:, -1] = now.uv_px
    order = np.argsort(now.ids)
    ids = now.ids[order]
    for back in range(1, length + 1):
        k = report.frame - back
        if k < 0 or not len(ids):
            break
        before = run.report(k).tracks
        at = np.searchsorted(ids, before.ids)
        at = np.minimum(at, len(ids) - 1)
        same = ids[at] == before.ids
        paths[order[at[same]], length - back] = before.uv_px[same]
    return paths


def lost_counts(tracks: TrackReport) -> list[tuple[LossReason, int]]:
    """Reasons that occurred with their counts, in the order of LossReason."""
    counts = np.bincount(tracks.lost_reason, minlength=len(LOSS_REASONS))
    return [(reason, int(n)) for reason, n in zip(LOSS_REASONS, counts) if n]


@dataclass(frozen=True)
class Ending:
    frame: int
    reason: LossReason
    age: int


def track_ending(run: RunView, frame: int, track: int, reach: int = TRAIL) -> Ending | None:
    """How a track ended in the last `reach` frames up to `frame`; None when it did not."""
    for k in range(frame, max(frame - reach, -1), -1):
        lost = run.report(k).tracks
        at = np.flatnonzero(lost.lost_ids == track)
        if len(at):
            return Ending(k, LOSS_REASONS[int(lost.lost_reason[at[0]])], int(lost.lost_age[at[0]]))
    return None


def track_row(tracks: TrackReport, track: int) -> int | None:
    """Row of a track in the report, None when it is not alive."""
    at = np.flatnonzero(tracks.ids == track)
    return int(at[0]) if len(at) else None


@dataclass(frozen=True)
class TrackChanges:
    """How two tracking attempts of one frame differ; rows are pixels (u, v)."""

    moved: np.ndarray  # (n, 2, 2) of tracks in both: where it was, where it is now
    moved_ids: np.ndarray
    gone: np.ndarray  # (m, 2) of tracks that only the first has
    gone_ids: np.ndarray
    come: np.ndarray  # (k, 2) of tracks that only the second has
    come_ids: np.ndarray


def track_changes(
    before: TrackReport, after: TrackReport, moved_px: float = 0.05, other_px: float = 3.0
) -> TrackChanges:
    """Tracks by id; an id that lies further than `other_px` away names another corner."""
    _, i, j = np.intersect1d(before.ids, after.ids, return_indices=True)
    apart = np.linalg.norm(before.uv_px[i] - after.uv_px[j], axis=1)
    i, j, apart = (v[apart <= other_px] for v in (i, j, apart))
    moved = apart > moved_px
    gone, come = (np.setdiff1d(np.arange(len(t.ids)), rows) for t, rows in ((before, i), (after, j)))
    return TrackChanges(
        np.stack([before.uv_px[i[moved]], after.uv_px[j[moved]]], 1),
        after.ids[j[moved]],
        before.uv_px[gone],
        before.ids[gone],
        after.uv_px[come],
        after.ids[come],
    )


# Landmarks


@dataclass(frozen=True)
class Landmark:
    """One row of the landmark report."""

    id: int
    status: LandmarkStatus
    xyz_w: np.ndarray  # (3,) m, NaN for a candidate
    inv_depth: float  # 1/m
    sigma: float  # of inv_depth
    anchor_frame: int
    n_obs: int
    error_px: float

    @property
    def depth(self) -> float:
        return 1 / self.inv_depth if self.inv_depth else math.inf

    @property
    def depth_interval(self) -> tuple[float, float]:
        """Depths at inv_depth + sigma and - sigma, m; infinite when that is not positive."""
        near, far = self.inv_depth + self.sigma, self.inv_depth - self.sigma
        return 1 / near if near > 0 else math.inf, 1 / far if far > 0 else math.inf


def landmark(report: FrameReport, track: int) -> Landmark | None:
    marks, window = report.landmarks, report.window
    if marks is None or window is None:
        return None
    at = np.flatnonzero(marks.ids == track)
    if not len(at):
        return None
    k = int(at[0])
    return Landmark(
        track,
        LANDMARK_STATUSES[int(marks.status[k])],
        marks.xyz_w[k],
        float(marks.inv_depth[k]),
        float(marks.sigma_inv_depth[k]),
        int(window.frames[int(marks.anchor_slot[k])]),
        int(marks.n_obs[k]),
        float(marks.error_px[k]),
    )


def statuses(report: FrameReport) -> dict[int, LandmarkStatus]:
    """Landmark status by track id."""
    marks = report.landmarks
    if marks is None:
        return {}
    return {i: LANDMARK_STATUSES[s] for i, s in zip(marks.ids.tolist(), marks.status.tolist())}


@dataclass(frozen=True)
class Observation:
    slot: int
    frame: int
    error_px: float


def observations(report: FrameReport, track: int) -> list[Observation]:
    """Reprojection errors of a landmark in the frames of the window that see it, oldest first."""
    solve, window = report.solve, report.window
    if solve is None or window is None:
        return []
    rows = np.flatnonzero(solve.visual_ids == track)
    rows = rows[np.argsort(solve.visual_slots[rows, 1], kind="stable")]
    return [
        Observation(int(s), int(window.frames[int(s)]), float(e))
        for s, e in zip(solve.visual_slots[rows, 1], solve.visual_error_px[rows])
    ]


# Solve


FACTORS = ("visual", "IMU", "prior")
"""Of every run; a depth camera adds its own."""


def split(cost: CostSplit) -> list[tuple[str, float]]:
    parts = list(zip(FACTORS, (cost.visual, cost.imu, cost.prior)))
    return [*parts, ("depth", cost.depth)] if cost.depth else parts


# Poses


def yaw_pitch_roll_deg(q_w_b: np.ndarray) -> tuple[float, float, float]:
    """Angles of R_w_b = R_z(yaw) R_y(pitch) R_x(roll), degrees."""
    w, x, y, z = (float(v) for v in q_w_b)
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    pitch = math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return math.degrees(yaw), math.degrees(pitch), math.degrees(roll)


# Where else something happened


def nearest(events: Iterable[Event], frame: int, *kinds: str) -> Event | None:
    """The event of one of `kinds` nearest to `frame`; of two equally near ones the earlier."""
    return min((e for e in events if e.kind in kinds), key=lambda e: (abs(e.frame - frame), e.frame), default=None)


def latest(events: Iterable[Event], frame: int, *kinds: str) -> Event | None:
    """The last event of one of `kinds` up to and including `frame`."""
    return max((e for e in events if e.kind in kinds and e.frame <= frame), key=lambda e: e.frame, default=None)
