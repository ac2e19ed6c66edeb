"""What a list of frames needs of each: small, and kept in memory for the whole run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..sensors import GpsFix
from .frame import FrameReport, Status, Timings
from .gps import FixRevision, FixVerdict, GpsReport, GpsStatus
from .initialization import HandEyeReport
from .loops import ClosureReport, KeyframeEntry, LoopEdge, LoopOutcome
from .solve import CostSplit
from .window import CalibrationReport, PoseEstimate


@dataclass(frozen=True)
class ClosureSummary:
    """What a frame added to the pose graph, and what loop closing said."""

    keyframe: KeyframeEntry | None
    outcome: LoopOutcome | None  # of a keyframe that this frame made
    match: int  # the keyframe that it closes a loop with, -1 for none
    edges: tuple[LoopEdge, ...]
    optimized: bool
    drift: np.ndarray  # (7,) by the graph
    fast_drift: np.ndarray | None = None  # (7,) by the newest loop
    n_candidates: int = 0  # earlier keyframes that were looked at


@dataclass(frozen=True)
class FixSummary:
    """A fix as it was judged when it came."""

    t_ns: int
    verdict: FixVerdict
    failed: tuple[str, ...]  # names of the gates that it did not pass
    z_e: np.ndarray | None  # (3,)
    covariance: np.ndarray | None  # (3, 3)


@dataclass(frozen=True)
class GpsSummary:
    """What a frame said of GPS: enough to draw the whole run, and to smooth it (fusion/conclusion.py)."""

    status: GpsStatus
    arrived: tuple[GpsFix, ...]
    fixes: tuple[FixSummary, ...]
    revised: tuple[FixRevision, ...]
    origin: np.ndarray | None  # (3,)
    T_e_b: np.ndarray | None  # (7,)
    T_e_o: np.ndarray | None  # (7,)
    yaw_deg: float | None
    yaw_sigma_deg: float | None
    outage_s: float | None  # since the last fix that counted; None before the first


@dataclass(frozen=True)
class HandEyeSummary:
    """How the rotation between camera and IMU converges."""

    n_pairs: int
    q_b_c: np.ndarray | None  # (4,) wxyz
    sigma_deg: np.ndarray | None  # (3,)
    singular_value: float  # the second smallest
    found: bool


@dataclass(frozen=True)
class FrameSummary:
    """One row per frame for timelines and tables over a whole run, kept small so that opening a run is fast."""

    frame: int
    t_ns: int
    status: Status
    is_keyframe: bool | None  # decision about the second newest frame; None while the window fills
    n_tracks: int
    n_new: int
    n_lost: int
    parallax_px: float | None
    before: CostSplit | None
    after: CostSplit | None
    n_iterations: int
    n_landmarks: int
    marginalized: str
    initialization: str | None  # None: not attempted; "": succeeded; else why it failed
    health: str  # "" or why the estimator restarted
    failed_gates: tuple[str, ...]  # names of deciding gates of initialisation and health that failed
    n_anomalies: int
    pose: PoseEstimate | None
    ms: Timings
    degeneracy: str = ""  # "" or which motion the window is missing
    yaw_information: float | None = None  # what the prior made in this frame claims to know of yaw, 1/rad^2
    closure: ClosureSummary | None = None
    gps: GpsSummary | None = None
    hand_eye: HandEyeSummary | None = None
    calibration: CalibrationReport | None = None

    @property
    def t_imu_ns(self) -> int:
        """When its pose was, on the IMU's clock: the stamp of the image where there is no pose."""
        return self.t_ns + (round(self.pose.late_s * 1e9) if self.pose else 0)


def summarize(report: FrameReport, ms: Timings) -> FrameSummary:
    tracks, solve, init, margin = report.tracks, report.solve, report.initialization, report.marginalization
    failed = [g.name for s in init.stages for g in s.gates if g.decides and not g.passed] if init else []
    failed += [g.name for g in report.health.gates if g.decides and not g.passed] if report.health else []
    why = next((s.outcome for s in init.stages if not s.passed), "") if init else None
    return FrameSummary(
        frame=report.frame,
        t_ns=report.t_ns,
        status=report.status,
        is_keyframe=report.keyframe.is_keyframe if report.keyframe else None,
        n_tracks=len(tracks.ids),
        n_new=tracks.n_new,
        n_lost=len(tracks.lost_ids),
        parallax_px=report.keyframe.parallax_px if report.keyframe else None,
        before=solve.before if solve else None,
        after=solve.after if solve else None,
        n_iterations=len(solve.iterations) if solve else 0,
        n_landmarks=solve.n_landmarks if solve else 0,
        marginalized=margin.kind if margin else "none",
        initialization=why,
        health=report.health.outcome if report.health else "",
        failed_gates=tuple(failed),
        n_anomalies=len(report.anomalies),
        pose=report.pose,
        ms=ms,
        degeneracy=report.health.degeneracy if report.health else "",
        yaw_information=float(margin.gauge_information[3]) if margin and margin.kind != "none" else None,
        closure=_summarize_closure(report.closure) if report.closure else None,
        gps=_summarize_gps(report.gps) if report.gps else None,
        hand_eye=_summarize_hand_eye(report.hand_eye) if report.hand_eye else None,
        calibration=report.calibration,
    )


def _summarize_gps(report: GpsReport) -> GpsSummary:
    return GpsSummary(
        status=report.status,
        arrived=report.arrived,
        fixes=tuple(
            FixSummary(f.t_ns, f.verdict, tuple(g.name for g in f.gates if not g.passed), f.z_e, f.covariance)
            for f in report.fixes
        ),
        revised=report.revised,
        origin=report.origin,
        T_e_b=report.T_e_b,
        T_e_o=report.T_e_o,
        yaw_deg=report.yaw_deg,
        yaw_sigma_deg=report.yaw_sigma_deg,
        outage_s=next((g.value for g in report.gates if g.name == "outage_s"), None),
    )


def _summarize_hand_eye(report: HandEyeReport) -> HandEyeSummary:
    smallest = float(report.singular_values[2])
    return HandEyeSummary(report.n_pairs, report.q_b_c, report.sigma_deg, smallest, report.found)


def _summarize_closure(report: ClosureReport) -> ClosureSummary:
    loop = report.loop
    return ClosureSummary(
        keyframe=report.keyframe,
        outcome=loop.outcome if loop else None,
        match=loop.accepted.match if loop and loop.accepted else -1,
        edges=report.edges,
        optimized=report.graph is not None,
        drift=report.drift,
        fast_drift=report.fast_drift,
        n_candidates=len(loop.candidates) if loop else 0,
    )
