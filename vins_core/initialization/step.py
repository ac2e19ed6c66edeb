"""One attempt to initialise, on a page: from tracks and pre-integrations to a metric, gravity-aligned window.

Every stage leaves an `InitStage` with its gates; the first stage that fails ends the attempt, and the report says why.
REFERENCE 8 (N1-N10), seeds 000.2 and 004.11-17; the refinement after it is ours (refinement.py).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from ..factors.preintegration import Preintegration, repropagate
from ..geometry import inverse_depth, se3, so3
from ..params import Params
from ..report import InitReport, InitStage
from ..sensors import Calibration, ImuNoise
from ..window.keyframe import FOCAL_460
from ..window.slide import restrict
from ..window.state import TRIANGULATED, Landmarks, WindowFrame, WindowState
from . import gyro_bias, time_offset
from .alignment import Alignment, align, refine_gravity
from .bundle import Structure
from .motion import excitation, references
from .refinement import Motion, bias_prior, refine, verdict
from .structure import Reconstruction, place_between, reconstruct
from .tracks import TrackTable

MAX_REFERENCES = 3
"""Reference frames tried in one attempt when the structure built from the first one fails."""


def initialize(
    params: Params, calibration: Calibration, window: WindowState, frames_in_time: tuple[WindowFrame, ...]
) -> tuple[WindowState | None, InitReport]:
    """Tries to initialise a full window; returns the initialised window, or None, and the report of the attempt.

    `window`: its frames with pre-integrations between consecutive frames of the window.
    `frames_in_time`: all frames from the oldest of the window to the newest, kept by the window or not, each with the
    pre-integration from the frame just before it in time (None for the first).

    The world of the result has z up; the oldest body is at its origin with yaw 0.  Its prior says how far from zero
    the accelerometer bias may be.  Without `init.refine` (parity) there is no prior and the bias is zero.
    """
    init, noise, g_norm = params.init, calibration.noise, calibration.gravity_m_s2
    T_b_c = window.T_b_c[0]
    sigma_rad = params.window.pixel_sigma / FOCAL_460
    imu = [f.imu for f in frames_in_time[1:] if f.imu is not None]
    tracks = TrackTable.of(window.frames)
    attempt = _Attempt()

    excited = attempt.passes(excitation(init, params.imu, imu, _between(window)))
    built = None
    for reference, found in islice(references(init, tracks), MAX_REFERENCES):
        attempt.retract("relative pose", "structure")
        if not attempt.passes(found) or reference is None or not excited:
            break
        attempt.reference_slot = reference.slot
        built, stage = reconstruct(init, tracks, reference, sigma_rad, params.window.max_error_px / FOCAL_460)
        if attempt.passes(stage):
            break
    if built is None:
        return attempt.failed()
    Ts_l_c, stage = place_between(init, tracks, built, window.frames, frames_in_time, sigma_rad)
    if not attempt.passes(stage) or Ts_l_c is None:
        return attempt.failed()

    p_l_c, R_l_b = Ts_l_c[:, :3, 3], Ts_l_c[:, :3, :3] @ T_b_c[:3, :3].T
    if window.calibrates.td:
        attempt.td_s, stage = time_offset.estimate(params.online, window.td_s, R_l_b, imu)
        attempt.passes(stage)
    attempt.b_g, imu, stage = gyro_bias.calibrate(init, noise, R_l_b, imu)
    if not attempt.passes(stage):
        return attempt.failed()
    aligned, stage = align(init, g_norm, p_l_c, R_l_b, imu, T_b_c[:3, 3])
    attempt.scale, attempt.gravity = aligned.scale, aligned.gravity
    if not attempt.passes(stage):
        return attempt.failed()
    aligned, stage = refine_gravity(init, g_norm, p_l_c, R_l_b, imu, T_b_c[:3, 3], aligned)
    attempt.scale, attempt.gravity = aligned.scale, aligned.gravity
    if not attempt.passes(stage):
        return attempt.failed()

    kept = np.isin([f.frame for f in frames_in_time], [f.frame for f in window.frames])
    motion = _metric(built, p_l_c[kept], R_l_b[kept], aligned.v[kept], aligned, attempt.b_g, T_b_c[:3, 3])
    prior = None
    if init.refine:
        rays, between = tracks.observations(built.rows), _between(window, motion, noise)
        refined = refine(motion, T_b_c, rays, between, g_norm, sigma_rad, init.acc_bias_sigma)
        attempt.scale *= refined.motion.extent_m / motion.extent_m
        attempt.b_g = refined.motion.b_g
        attempt.gravity = R_l_b[0] @ refined.motion.structure.R[0].T @ np.array([0.0, 0.0, -g_norm])
        if not attempt.passes(verdict(params, refined, motion, built.rms_rad)):
            return attempt.failed()
        motion = refined.motion.anchored()
        prior = bias_prior(window.frames[0].frame, motion, init.acc_bias_sigma)
    frames = _states(window, motion, noise)
    landmarks = _landmarks(frames, tracks, built.rows, motion, T_b_c, params.window.min_depth)
    return replace(window, frames=frames, landmarks=landmarks, prior=prior), attempt.report(succeeded=True)


@dataclass
class _Attempt:
    """What the report will say; local to `initialize`."""

    stages: list[InitStage] = field(default_factory=list)
    reference_slot: int = -1
    scale: float = np.nan
    gravity: np.ndarray | None = None
    b_g: np.ndarray | None = None
    td_s: float | None = None

    def passes(self, stage: InitStage) -> bool:
        self.stages.append(stage)
        return stage.passed

    def retract(self, *names: str) -> None:
        """Another reference frame is tried: its stages replace those of the one before."""
        self.stages = [s for s in self.stages if s.name not in names]

    def report(self, succeeded: bool) -> InitReport:
        scale = self.scale if np.isfinite(self.scale) else None
        return InitReport(tuple(self.stages), succeeded, self.reference_slot, scale, self.gravity, self.b_g, self.td_s)

    def failed(self) -> tuple[None, InitReport]:
        return None, self.report(succeeded=False)


def _between(window: WindowState, motion: Motion | None = None, noise: ImuNoise | None = None) -> list[Preintegration]:
    """Pre-integrations between the frames of the window, integrated again with the biases of `motion`."""
    imu = [f.imu for f in window.frames[1:] if f.imu is not None]
    if motion is None or noise is None:
        return imu
    return [repropagate(p, motion.b_a, motion.b_g, noise) for p in imu]


def _metric(
    built: Reconstruction,
    p_l_c: np.ndarray,
    R_l_b: np.ndarray,
    v_l: np.ndarray,
    aligned: Alignment,
    b_g: np.ndarray,
    p_b_c: np.ndarray,
) -> Motion:
    """The window in metres, in a world with z up, the oldest body at the origin with yaw 0 (N10)."""
    structure = Structure(aligned.scale * p_l_c - R_l_b @ p_b_c, R_l_b, aligned.scale * built.points)
    q_w_l = so3.from_two_vectors(-aligned.gravity, np.array([0.0, 0.0, 1.0]))
    return Motion(structure, v_l, np.zeros(3), b_g).rotated(so3.to_matrix(q_w_l)).anchored()


def _states(window: WindowState, motion: Motion, noise: ImuNoise) -> tuple[WindowFrame, ...]:
    q = so3.from_matrix(motion.structure.R)
    imu = (None, *_between(window, motion, noise))
    return tuple(
        replace(f, imu=imu[k], p_w_b=motion.structure.p[k], q_w_b=q[k], v_w_b=v, b_a=motion.b_a, b_g=motion.b_g)
        for k, (f, v) in enumerate(zip(window.frames, motion.v))
    )


def _landmarks(
    frames: tuple[WindowFrame, ...],
    tracks: TrackTable,
    rows: np.ndarray,
    motion: Motion,
    T_b_c: np.ndarray,
    min_depth: float,
) -> Landmarks:
    """Every track of the window; those with a point of the structure get its inverse depth in their anchor."""
    table = restrict(Landmarks.empty(), frames)
    anchor = np.argmax(tracks.seen[rows], axis=1)
    Ts_w_c = se3.from_rotation_translation(motion.structure.R, motion.structure.p) @ T_b_c
    points_c = se3.transform(se3.inverse(Ts_w_c)[anchor], motion.structure.points)
    depth = inverse_depth.depth(tracks.rays[rows, anchor], points_c)
    known = rows[depth > min_depth]
    table.inv_depth[known] = 1.0 / depth[depth > min_depth]
    table.status[known] = TRIANGULATED
    return table
