"""The window's turn on a page: re-propagate, triangulate, solve, reject, judge, marginalise, slide."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..clock import stopwatch
from ..factors.preintegration import repropagate
from ..params import Imu, Params
from ..report import (
    CalibrationReport,
    DepthReport,
    FrameReport,
    Gate,
    HealthReport,
    KeyframeReport,
    LandmarkReport,
    LossReason,
    MarginalizationReport,
    PoseEstimate,
    RelocalizationReport,
    SolveReport,
    Timings,
    WindowReport,
    all_pass,
)
from ..sensors import Calibration, ImuNoise
from ..solver.covariance import relative_poses
from ..solver.solve import solve
from ..solver.trust_region import Solution
from . import degeneracy, depth, health, landmarks, online
from .assemble import Assembly, assemble, inv_depth_sigma, solve_report, unpack
from .create import create_landmarks
from .marginalize import NOTHING_LEFT, marginalize_oldest, marginalize_second_newest
from .relocalize import RelocalisationRequest, add_places, relocalization_reports
from .slide import drop_oldest, drop_second_newest
from .state import WindowFrame, WindowState


@dataclass(frozen=True)
class Estimate:
    """What one turn gives: the window after sliding (None when the estimator has failed) and the explanation."""

    window: WindowState | None
    pose: PoseEstimate
    rejected: dict[LossReason, np.ndarray]
    solve: SolveReport
    window_report: WindowReport
    landmarks: LandmarkReport
    health: HealthReport
    marginalization: MarginalizationReport | None
    relocalizations: tuple[RelocalizationReport, ...] = ()  # not judged yet: that is for the loop stage
    calibration: CalibrationReport | None = None
    depth: DepthReport | None = None

    def explain(self, report: FrameReport) -> FrameReport:
        return replace(
            report,
            solve=self.solve,
            window=self.window_report,
            landmarks=self.landmarks,
            health=self.health,
            marginalization=self.marginalization,
            pose=self.pose,
            relocalizations=self.relocalizations,
            calibration=self.calibration,
            depth=self.depth,
        )


@dataclass(frozen=True)
class Solved:
    """A window on its way through a turn, before anything leaves it."""

    window: WindowState  # as it went into the solve
    assembly: Assembly
    solution: Solution
    solved: WindowState
    report: SolveReport
    judged: WindowState  # without the landmarks that were rejected: what is marginalised
    rejected: dict[LossReason, np.ndarray]
    relocalizations: tuple[RelocalizationReport, ...] = ()
    calibration: CalibrationReport | None = None


def solve_window(
    params: Params,
    calibration: Calibration,
    window: WindowState,
    ms: Timings,
    requests: tuple[RelocalisationRequest, ...] = (),
) -> Solved:
    """The first half of a turn: re-propagate, triangulate, solve, reject.

    Requests whose later keyframe is in the window are solved for with it and answered (relocalize.py).
    """
    with stopwatch(ms, "repropagate"):
        window = _repropagate(params.imu, window, calibration.noise)
    with stopwatch(ms, "triangulate"):
        window = create_landmarks(params, window)
    with stopwatch(ms, "solve"):
        assembly, places = add_places(assemble(params, window, calibration.gravity_m_s2), window, requests)
        released = online.release(params, window)
        assembly = replace(assembly, problem=released.free(assembly.problem))
        solution = solve(params, assembly.problem)
        solved = unpack(window, assembly, solution.states)
    with stopwatch(ms, "explain"):
        report = solve_report(assembly, solution)
        judged, rejected = landmarks.reject(params.window, solved, report)
        known = online.report(solved, released, assembly.problem, solution)
    turn = Solved(window, assembly, solution, solved, report, judged, rejected, calibration=known)
    if not places:
        return turn
    with stopwatch(ms, "relocalize"):
        return replace(turn, relocalizations=relocalization_reports(assembly.problem, places, solution))


def estimate(
    params: Params,
    calibration: Calibration,
    window: WindowState,
    keyframe: KeyframeReport,
    previous: PoseEstimate | None,
    ms: Timings,
    requests: tuple[RelocalisationRequest, ...] = (),
    arrival: tuple[Gate, ...] = (),
) -> Estimate:
    """Solve a window and slide it.

    `keyframe` decides what leaves: the oldest frame when the second newest is a keyframe, else the second newest.
    A window that is not full, because its size was raised in the middle of a run, keeps its oldest.
    `previous` is the estimate of the frame before, None right after an initialisation; `arrival` are gates about how
    the frame came in that decide with those of its health.
    """
    turn = solve_window(params, calibration, window, ms, requests)
    leaves_oldest = keyframe.is_keyframe and len(window.frames) > params.window.size
    with stopwatch(ms, "explain"):
        landmark_report = landmarks.report(
            turn.solved, turn.judged, turn.assembly, turn.report, inv_depth_sigma(turn.solution), leaves_oldest
        )
        window_report = _window_report(turn.solved, turn.report)
        if keyframe.is_keyframe and params.loop.enabled and window.inertial and len(window.frames) > 2:
            window_report = replace(window_report, motion=_motion(turn))
        pose = pose_of(turn.solved.frames[-1])
        verdict = health.check(params.health, keyframe.tracked, previous, pose, arrival)
        gates, motion = degeneracy.check(params.health, turn.solved.frames, turn.solved.T_b_c[0][:3, :3])
        verdict = replace(verdict, gates=(*verdict.gates, *gates), degeneracy=motion)
        depth_report = depth.report(params.depth, turn.window, turn.judged, turn.assembly)
    done = Estimate(
        window=None,
        pose=pose,
        rejected=turn.rejected,
        solve=turn.report,
        window_report=window_report,
        landmarks=landmark_report,
        health=verdict,
        marginalization=None,
        relocalizations=turn.relocalizations,
        calibration=turn.calibration,
        depth=depth_report,
    )
    if not all_pass(verdict.gates):
        return done
    if keyframe.is_keyframe and not leaves_oldest:
        return replace(done, window=turn.judged, marginalization=NOTHING_LEFT)
    with stopwatch(ms, "marginalize"):
        leave = marginalize_oldest if leaves_oldest else marginalize_second_newest
        prior, marginalization = leave(params, turn.judged, calibration.gravity_m_s2)
    with stopwatch(ms, "slide"):
        judged = replace(turn.judged, prior=prior)
        slid = drop_oldest(judged) if leaves_oldest else drop_second_newest(judged, calibration.noise)
    return replace(done, window=slid, marginalization=marginalization)


def pose_of(frame: WindowFrame) -> PoseEstimate:
    return PoseEstimate(frame.p_w_b, frame.q_w_b, frame.v_w_b, frame.b_a, frame.b_g)


def _repropagate(params: Imu, window: WindowState, noise: ImuNoise) -> WindowState:
    """Integrate again where the bias has left the neighbourhood in which its first-order correction holds (I3)."""
    if not params.repropagate:
        return window
    frames = list(window.frames)
    for k in range(1, len(frames)):
        imu, before = frames[k].imu, frames[k - 1]
        if imu is None:
            continue
        moved_a, moved_g = np.linalg.norm(before.b_a - imu.b_a), np.linalg.norm(before.b_g - imu.b_g)
        if moved_a > params.repropagate_ba or moved_g > params.repropagate_bg:
            frames[k] = replace(frames[k], imu=repropagate(imu, before.b_a, before.b_g, noise))
    return replace(window, frames=tuple(frames))


def _motion(turn: Solved) -> np.ndarray | None:
    """(6, 6) covariance of the motion between the keyframe before and the second newest frame."""
    problem, solution, n = turn.assembly.problem, turn.solution, len(turn.window.frames)
    return relative_poses(problem, solution.states, [(n - 3, n - 2)], solution.system)[0]


def _window_report(window: WindowState, solve: SolveReport) -> WindowReport:
    frames = window.frames
    newest = frames[-1].observations.ids
    slot, squared = solve.visual_slots[:, 1], solve.visual_error_px.astype(float) ** 2
    count = np.bincount(slot, minlength=len(frames))
    return WindowReport(
        frames=np.array([f.frame for f in frames]),
        t_ns=np.array([f.t_ns for f in frames]),
        keyframe=np.array([f.is_keyframe for f in frames]),
        p_w_b=np.array([f.p_w_b for f in frames]),
        q_w_b=np.array([f.q_w_b for f in frames]),
        v_w_b=np.array([f.v_w_b for f in frames]),
        b_a=np.array([f.b_a for f in frames]),
        b_g=np.array([f.b_g for f in frames]),
        shared=np.array([np.isin(f.observations.ids, newest, assume_unique=True).sum() for f in frames], np.int32),
        error_px=np.sqrt(np.bincount(slot, squared, len(frames)) / np.where(count, count, np.nan)).astype(np.float32),
    )
