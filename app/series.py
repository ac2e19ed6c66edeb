"""Arrays over a whole run, one row per frame: what timelines, signals and the 3D trajectory draw.

Computed from the frame summaries alone, so that opening a long run stays fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vins_core.geometry import so3
from vins_core.report import LOOP_OUTCOMES, CostSplit, FrameSummary, LoopOutcome, Status
from vins_core.sensors import Trajectory

from .gps import GpsSeries, gps_series


@dataclass(frozen=True)
class Event:
    """Something that happened at a frame and that one wants to find again."""

    frame: int
    kind: str  # "anomaly" | "attempt" (initialisation failed) | "initialized" | "restart" | "degenerate"
    text: str  # one sentence


VERIFIED = LOOP_OUTCOMES.index(LoopOutcome.FEW_MATCHES)
"""From this outcome on an earlier keyframe was looked at in earnest."""


@dataclass(frozen=True)
class LoopSeries:
    """(m,) arrays: one row per keyframe of the run that loop closing was asked about."""

    frame: np.ndarray  # int, whose report tells of it
    keyframe: np.ndarray  # int, its number over all sessions; -1 when it was left out
    of: np.ndarray  # int, the frame that became it; -1 when it was left out
    outcome: np.ndarray  # int, index into LOOP_OUTCOMES
    match: np.ndarray  # int, the keyframe it closes a loop with; -1 for none

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def accepted(self) -> np.ndarray:
        return self.match >= 0

    @property
    def candidate(self) -> np.ndarray:
        """Retrieval proposed an earlier keyframe that looks alike."""
        return self.outcome >= VERIFIED


@dataclass(frozen=True)
class RunSeries:
    """(n,) arrays over the frames of a run; NaN where a quantity does not exist at a frame."""

    t_s: np.ndarray  # seconds since the first frame
    keyframe: np.ndarray  # bool: this frame was kept as a keyframe (decided one frame later)
    status: tuple[Status, ...]
    before: np.ndarray  # (n, 4) robust cost before the solve: visual, IMU, prior, depth
    cost: np.ndarray  # (n, 4) after the solve
    iterations: np.ndarray  # int
    tracks: np.ndarray  # int, alive
    new: np.ndarray  # int
    lost: np.ndarray  # int
    landmarks: np.ndarray  # int, in the solve
    parallax_px: np.ndarray  # px460
    p_w_b: np.ndarray  # (n, 3) m, the estimate right after its own solve
    q_w_b: np.ndarray  # (n, 4) wxyz
    v_w_b: np.ndarray  # (n, 3) m/s
    b_a: np.ndarray  # (n, 3) m/s^2
    b_g: np.ndarray  # (n, 3) rad/s
    truth_p: np.ndarray  # (n, 3) m, truth at the frames, moved into the estimate's world by SE(3) alignment
    error_m: np.ndarray  # position error after that alignment
    ate_m: np.ndarray  # RMSE of `error_m` up to this frame
    ms: dict[str, np.ndarray]  # milliseconds per stage (see report.Timings)
    yaw_leak: np.ndarray  # 1/rad^2, what the frame's new prior claims to know of yaw
    drift: np.ndarray  # (n, 7) T_g_o by the pose graph: accurate, late
    fast_drift: np.ndarray  # (n, 7) T_g_o by the newest loop: at once
    loops: LoopSeries
    gps: GpsSeries
    events: tuple[Event, ...]

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def keyframes(self) -> np.ndarray:
        """(k,) frame numbers of the keyframes, increasing."""
        return np.flatnonzero(self.keyframe)

    @property
    def moved_m(self) -> np.ndarray:
        """(n, 2) how far the two drift corrections, of the graph and of the newest loop, move the newest position."""
        return np.stack([np.linalg.norm(p - self.p_w_b, axis=1) for p in self._corrected()], 1)

    @property
    def corrections_apart_m(self) -> np.ndarray:
        """(n,) between the newest positions that the two drift corrections give."""
        by_graph, by_loop = self._corrected()
        return np.linalg.norm(by_graph - by_loop, axis=1)

    def _corrected(self) -> list[np.ndarray]:
        return [T[:, :3] + so3.rotate(T[:, 3:], self.p_w_b) for T in (self.drift, self.fast_drift)]


def run_series(summaries: Sequence[FrameSummary], truth: Trajectory | None) -> RunSeries:
    """All rows at once; `truth` None leaves the columns about it NaN."""
    n = len(summaries)
    t_ns = np.array([s.t_ns for s in summaries], np.int64)
    keyframe = np.zeros(n, bool)
    keyframe[: max(n - 1, 0)] = [bool(s.is_keyframe) for s in summaries[1:]]
    p_w_b = _stack([s.pose.p_w_b if s.pose else None for s in summaries], 3)
    truth_p, error = _against_truth(np.array([s.t_imu_ns for s in summaries], np.int64), p_w_b, truth)
    square = np.where(np.isfinite(error), error**2, 0.0)
    with np.errstate(invalid="ignore"):
        ate = np.sqrt(np.cumsum(square) / np.cumsum(np.isfinite(error)))
    stages = sorted({name for s in summaries for name in s.ms})
    return RunSeries(
        t_s=(t_ns - t_ns[0]) * 1e-9 if n else np.zeros(0),
        keyframe=keyframe,
        status=tuple(s.status for s in summaries),
        before=_costs([s.before for s in summaries]),
        cost=_costs([s.after for s in summaries]),
        iterations=np.array([s.n_iterations for s in summaries], int),
        tracks=np.array([s.n_tracks for s in summaries], int),
        new=np.array([s.n_new for s in summaries], int),
        lost=np.array([s.n_lost for s in summaries], int),
        landmarks=np.array([s.n_landmarks for s in summaries], int),
        parallax_px=np.array([np.nan if s.parallax_px is None else s.parallax_px for s in summaries], float),
        p_w_b=p_w_b,
        q_w_b=_stack([s.pose.q_w_b if s.pose else None for s in summaries], 4),
        v_w_b=_stack([s.pose.v_w_b if s.pose else None for s in summaries], 3),
        b_a=_stack([s.pose.b_a if s.pose else None for s in summaries], 3),
        b_g=_stack([s.pose.b_g if s.pose else None for s in summaries], 3),
        truth_p=truth_p,
        error_m=error,
        ate_m=ate,
        ms={name: np.array([s.ms.get(name, np.nan) for s in summaries]) for name in stages},
        yaw_leak=np.array([np.nan if s.yaw_information is None else s.yaw_information for s in summaries], float),
        drift=_stack([s.closure.drift if s.closure else None for s in summaries], 7),
        fast_drift=_stack([s.closure.fast_drift if s.closure else None for s in summaries], 7),
        loops=_loops(summaries),
        gps=gps_series(summaries),
        events=tuple(_events(summaries)),
    )


def align_se3(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R, t) that minimise sum |R source + t - target|^2 over (n, 3) points (Umeyama 1991, without scale)."""
    mean_s, mean_t = source.mean(0), target.mean(0)
    U, _, Vt = np.linalg.svd((target - mean_t).T @ (source - mean_s))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return R, mean_t - R @ mean_s


def _against_truth(t_ns: np.ndarray, p_w_b: np.ndarray, truth: Trajectory | None) -> tuple[np.ndarray, np.ndarray]:
    """Truth at the frames in the estimate's world (n, 3) and the distance to it (n,)."""
    nothing = np.full(p_w_b.shape, np.nan), np.full(len(p_w_b), np.nan)
    if truth is None or len(truth) < 2:
        return nothing
    inside = (t_ns >= truth.t_ns[0]) & (t_ns <= truth.t_ns[-1])
    seconds, at = (truth.t_ns - truth.t_ns[0]) * 1e-9, (t_ns - truth.t_ns[0]) * 1e-9
    p = np.stack([np.interp(at, seconds, truth.p_w_b[:, k]) for k in range(3)], 1)
    both = inside & np.isfinite(p_w_b).all(1)
    if both.sum() < 3:
        return nothing
    R, t = align_se3(p[both], p_w_b[both])
    p = np.where(inside[:, None], p @ R.T + t, np.nan)
    return p, np.linalg.norm(p - p_w_b, axis=1)


def _loops(summaries: Sequence[FrameSummary]) -> LoopSeries:
    rows = [
        (
            s.frame,
            s.closure.keyframe.number if s.closure.keyframe else -1,
            s.closure.keyframe.frame if s.closure.keyframe else -1,
            LOOP_OUTCOMES.index(s.closure.outcome),
            s.closure.match,
        )
        for s in summaries
        if s.closure is not None and s.closure.outcome is not None
    ]
    return LoopSeries(*np.array(rows, int).reshape(-1, 5).T)


def _costs(splits: list[CostSplit | None]) -> np.ndarray:
    return _stack([np.array([s.visual, s.imu, s.prior, s.depth]) if s else None for s in splits], 4)


def _stack(rows: Sequence[np.ndarray | None], width: int) -> np.ndarray:
    nothing = np.full(width, np.nan)
    return np.array([nothing if r is None else r for r in rows], float).reshape(-1, width)


def _events(summaries: Sequence[FrameSummary]) -> list[Event]:
    events = []
    for s in summaries:
        if s.n_anomalies:
            events.append(
                Event(
                    s.frame, "anomaly", f"{s.n_anomalies} anomal{'y' if s.n_anomalies == 1 else 'ies'} in the recording"
                )
            )
        if s.initialization is not None:
            kind = "attempt" if s.initialization else "initialized"
            events.append(Event(s.frame, kind, s.initialization or "initialised"))
        if s.health:
            events.append(Event(s.frame, "restart", s.health))
        if s.degeneracy:
            events.append(Event(s.frame, "degenerate", s.degeneracy))
    return events
