"""Initialisation with two cameras or a depth camera: one frame has depth, so there is no scale to find.

With IMU: every frame of a full window is placed by PnP on the landmarks that the frames before have given, landmarks
and poses are adjusted together, then gyroscope bias, velocities and gravity follow from them, and at last the window is
solved with the IMU.  VINS-Fusion takes gravity from the first accelerometer samples and leaves the rest to its solver;
that is wrong by as much as the body accelerates, and nothing could fail.  Without IMU: the first frame that sees enough
landmarks is the world, upright as far as its camera is (REFERENCE N12, N13).

A depth camera is trusted here whatever `depth.variant` says: frames can be compared only once their poses are known.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..factors.preintegration import repropagate
from ..geometry import so3
from ..params import Params
from ..report import Gate, InitReport, InitStage, SolveReport, all_pass
from ..sensors import Calibration
from ..solver.solve import solve
from ..window import landmarks
from ..window.assemble import assemble, solve_report, unpack
from ..window.create import create_landmarks
from ..window.locate import locate
from ..window.slide import restrict
from ..window.state import TRIANGULATED, Landmarks, WindowFrame, WindowState
from . import gyro_bias, time_offset
from .alignment import align, refine_gravity
from .bundle import Structure
from .refinement import Motion, bias_prior

ITERATIONS = 30
"""Of each solve: nothing has been solved before."""


def initialize(params: Params, calibration: Calibration, window: WindowState) -> tuple[WindowState | None, InitReport]:
    """Tries to initialise a full window with IMU; the initialised window, or None, and the report of the attempt.

    The world of the result has z up; the oldest body is at its origin with yaw 0.  Its prior says how far from zero
    the accelerometer bias may be.
    """
    params = replace(params, depth=replace(params.depth, variant="trust"))
    init, noise, g_norm = params.init, calibration.noise, calibration.gravity_m_s2
    stages: list[InitStage] = []
    gravity = b_g = td_s = None

    def report(succeeded: bool) -> InitReport:
        return InitReport(tuple(stages), succeeded, 0, 1.0 if succeeded else None, gravity, b_g, td_s)

    def passes(stage: InitStage) -> bool:
        stages.append(stage)
        return stage.passed

    imu = [f.imu for f in window.frames[1:] if f.imu is not None]
    if not passes(_bridged(params, [p.dt_s for p in imu])):
        return None, report(False)
    placed, stage = _place(params, window)
    if not passes(stage):
        return None, report(False)
    placed, stage = _adjust(params, placed, g_norm)
    if not passes(stage):
        return None, report(False)

    p, R = np.array([f.p_w_b for f in placed.frames]), so3.to_matrix(np.array([f.q_w_b for f in placed.frames]))
    if window.calibrates.td:
        td_s, stage = time_offset.estimate(params.online, window.td_s, R, imu)
        passes(stage)
    b_g, imu, stage = gyro_bias.calibrate(init, noise, R, imu)
    if not passes(stage):
        return None, report(False)
    aligned, stage = align(init, g_norm, p, R, imu, np.zeros(3), scale=1.0)
    gravity = aligned.gravity
    if not passes(stage):
        return None, report(False)
    aligned, stage = refine_gravity(init, g_norm, p, R, imu, np.zeros(3), aligned, scale=1.0)
    gravity = aligned.gravity
    if not passes(stage):
        return None, report(False)

    up = so3.to_matrix(so3.from_two_vectors(-gravity, np.array([0.0, 0.0, 1.0])))
    motion = Motion(Structure(p, R, np.zeros((0, 3))), aligned.v, np.zeros(3), b_g).rotated(up).anchored()
    q = so3.from_matrix(motion.structure.R)
    frames = tuple(
        replace(
            f,
            imu=None if f.imu is None else repropagate(f.imu, motion.b_a, b_g, noise),
            p_w_b=motion.structure.p[k],
            q_w_b=q[k],
            v_w_b=motion.v[k],
            b_a=motion.b_a,
            b_g=b_g,
        )
        for k, f in enumerate(window.frames)
    )
    prior = bias_prior(frames[0].frame, motion, init.acc_bias_sigma)
    inertial = replace(placed, frames=frames, prior=prior, inertial=True)
    solved, stage = _refine(params, inertial, g_norm)
    if not passes(stage):
        return None, report(False)
    return solved, report(True)


def begin(params: Params, window: WindowState) -> tuple[WindowState | None, InitReport]:
    """Tries to begin without IMU at the one frame of `window`: enough landmarks by its pair of images.

    The world has z where the first camera has up in its image, the body is at its origin with yaw 0.
    """
    (frame,) = window.frames
    q = so3.from_two_vectors(-window.T_b_c[0][:3, 1], np.array([0.0, 0.0, 1.0]))
    q = so3.multiply(so3.exp(np.array([0.0, 0.0, -float(so3.heading(q))])), q)
    begun = create_landmarks(params, replace(window, frames=(replace(frame, q_w_b=q),)))
    stage = _enough_landmarks(params, begun)
    return (begun if stage.passed else None), InitReport((stage,), stage.passed, 0, None, None, None)


def _bridged(params: Params, intervals_s: list[float]) -> InitStage:
    limit = params.imu.max_interval_s
    gate = Gate("longest_interval", max(intervals_s), "<=", limit, "imu.max_interval_s", "s")
    return InitStage("intervals", (gate,), "" if gate.passed else "the window spans too long without IMU samples")


def _enough_landmarks(params: Params, window: WindowState) -> InitStage:
    n = int(np.count_nonzero(window.landmarks.status == TRIANGULATED))
    if len(window.T_b_c) > 1:
        source = "stereo"
        why = (
            "too few points are seen by both cameras: check the order of the cameras and their extrinsics, or find "
            "texture"
        )
    else:
        source = "depth"
        why = (
            "too few points have a depth: check that depth is registered to the camera, its scale and its range, or "
            "find texture; mode mono_imu does without"
        )
    gate = Gate(f"{source}_landmarks", n, ">=", params.init.min_matches, "init.min_matches")
    return InitStage(f"{source} landmarks", (gate,), "" if gate.passed else why)


def _place(params: Params, window: WindowState) -> tuple[WindowState, InitStage]:
    """The frames one after the other, by PnP on the landmarks of those before them."""

    def together(frames: tuple[WindowFrame, ...], table: Landmarks) -> WindowState:
        return replace(window, frames=frames, landmarks=restrict(table, frames), prior=None, inertial=False)

    first = replace(window.frames[0], p_w_b=np.zeros(3), q_w_b=np.array([1.0, 0.0, 0.0, 0.0]))
    placed = create_landmarks(params, together((first,), Landmarks.empty()))
    stage, fewest = _enough_landmarks(params, placed), np.inf
    if not stage.passed:
        return placed, stage
    for frame in window.frames[1:]:
        placed, gate = locate(params, together((*placed.frames, frame), placed.landmarks))
        fewest = min(fewest, gate.value or 0.0)
        if not gate.passed:
            why = f"frame {frame.frame} could not be placed: {fewest:.0f} landmarks agree on a pose"
            return placed, InitStage("frames", (*stage.gates, gate), why)
        placed = create_landmarks(params, placed)
    agree = Gate("agreeing_points", fewest, ">=", params.init.min_pnp_points, "init.min_pnp_points")
    return placed, InitStage("frames", (*stage.gates, agree), "")


def _solve(params: Params, window: WindowState, g_norm: float) -> tuple[WindowState, SolveReport]:
    """The window solved twice, the second time without the landmarks that the first one rejects."""
    params = replace(params, window=replace(params.window, max_iterations=ITERATIONS))
    for last in (False, True):
        assembly = assemble(params, window, g_norm)
        solution = solve(params, assembly.problem)
        window, report = unpack(window, assembly, solution.states), solve_report(assembly, solution)
        if not last:
            window, _ = landmarks.reject(params.window, window, report)
    return window, report


def _adjust(params: Params, placed: WindowState, g_norm: float) -> tuple[WindowState, InitStage]:
    """Poses and landmarks together, as the cameras alone see them."""
    adjusted, report = _solve(params, placed, g_norm)
    gate = _reprojection(params, report)
    source = "the two cameras" if len(placed.T_b_c) > 1 else "the depths"
    why = f"{source} and the poses do not fit the tracks: check intrinsics, extrinsics and synchronisation"
    values = {"landmarks": float(report.n_landmarks), "iterations": float(len(report.iterations))}
    return adjusted, InitStage("structure", (gate,), "" if gate.passed else why, values)


def _refine(params: Params, window: WindowState, g_norm: float) -> tuple[WindowState, InitStage]:
    """Everything together, with the IMU; do they agree?"""
    refined, report = _solve(params, window, g_norm)
    newest = refined.frames[-1]
    b_a, b_g = float(np.linalg.norm(newest.b_a)), float(np.linalg.norm(newest.b_g))
    imu_rms = float(np.sqrt(np.nanmean(report.imu_sigma[:, :3] ** 2) / 3.0))
    init, health = params.init, params.health
    gates = (
        Gate("imu_error", imu_rms, "<=", init.max_imu_error, "init.max_imu_error", "sigma"),
        _reprojection(params, report),
        Gate("acc_bias", b_a, "<=", health.max_acc_bias, "health.max_acc_bias", "m/s^2"),
        Gate("gyr_bias", b_g, "<=", health.max_gyr_bias, "health.max_gyr_bias", "rad/s"),
    )
    why = "cameras and IMU saw different motions: check extrinsics, time offset, IMU units and noise"
    values = {"iterations": float(len(report.iterations))}
    values |= {f"b_a_{axis}": float(b) for axis, b in zip("xyz", newest.b_a)}
    return refined, InitStage("refinement", gates, "" if all_pass(gates) else why, values)


def _reprojection(params: Params, report: SolveReport) -> Gate:
    error_px = report.visual_error_px.astype(float)
    value = float(np.sqrt(np.mean(error_px**2))) if len(error_px) else None
    return Gate("reprojection", value, "<=", params.init.max_reprojection_px, "init.max_reprojection_px", "px460")
