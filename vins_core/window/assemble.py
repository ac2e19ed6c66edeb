"""From the window to a least-squares problem and back.

`gather_tracks` lines up what each track was seen as in the frames of a window; `assemble` chooses the landmarks that
enter the solve and builds the factor tables; `unpack` writes solved states into a new window; `solve_report` and
`inv_depth_sigma` explain the result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..factors.reprojection import FOCAL_PX
from ..factors.robust import Loss
from ..geometry import so3
from ..params import Params
from ..report import SolveReport
from ..solver.layout import Variable
from ..solver.problem import PriorFactor, Projections, States, WindowProblem, hold_oldest
from ..solver.trust_region import Solution
from .state import OUTLIER, Landmarks, WindowFrame, WindowState

MIN_RAY_Z = 0.05
"""Smallest z of a unit ray that has an inverse depth along z, or a place on the normalised plane."""


@dataclass(frozen=True)
class Tracks:
    """Every observation in a window, sorted by (track id, slot).  Track k owns rows start[k] : start[k + 1]."""

    ids: np.ndarray  # (T,) int64, increasing
    start: np.ndarray  # (T + 1,)
    slots: np.ndarray  # (O,) slot of each observation
    rays: np.ndarray  # (O, 3) unit rays
    uv_px: np.ndarray  # (O, 2) float32

    @property
    def anchor(self) -> np.ndarray:
        """(T,) first slot that sees each track."""
        return self.slots[self.start[:-1]]

    @property
    def count(self) -> np.ndarray:
        """(T,) frames of the window that see each track."""
        return np.diff(self.start)

    @property
    def track(self) -> np.ndarray:
        """(O,) track index of each observation."""
        return np.repeat(np.arange(len(self.ids)), self.count)


def gather_tracks(frames: tuple[WindowFrame, ...]) -> Tracks:
    """The tracks of `frames`, oldest first."""
    observations = [f.observations for f in frames]
    ids = np.concatenate([o.ids for o in observations])
    order = np.argsort(ids, kind="stable")  # frames come oldest first, so equal ids stay in slot order
    ids = ids[order]
    first = np.flatnonzero(np.diff(ids, prepend=ids[:1] - 1)) if len(ids) else np.zeros(0, np.int64)
    slots = np.repeat(np.arange(len(frames)), [len(o) for o in observations])
    return Tracks(
        ids[first],
        np.append(first, len(ids)),
        slots[order],
        np.concatenate([o.rays for o in observations])[order],
        np.concatenate([o.uv_px for o in observations])[order],
    )


@dataclass(frozen=True)
class Assembly:
    """A problem and the tracks behind its rows."""

    problem: WindowProblem
    tracks: Tracks
    ids: np.ndarray  # (M,) landmark id of each row of problem.initial.inv_depths
    anchor: np.ndarray  # (M,) slot of its anchor


def assemble(params: Params, window: WindowState, gravity_m_s2: float) -> Assembly:
    """The problem of `window`.

    A landmark enters when it is triangulated in front of its anchor, no outlier, seen in at least
    `window.min_observations` frames, and anchored early enough: slot < n - 3 (REFERENCE W6: < 8 of 11).
    """
    frames = window.frames
    tracks = gather_tracks(frames)
    table = window.landmarks
    row = np.minimum(np.searchsorted(table.ids, tracks.ids), max(len(table) - 1, 0))
    inv_depth, usable = np.zeros(len(tracks.ids)), np.zeros(len(tracks.ids), bool)
    if len(table):
        inv_depth = table.inv_depth[row]
        usable = (table.ids[row] == tracks.ids) & (table.status[row] != OUTLIER)
        usable &= inv_depth > 0  # False for NaN
    usable &= tracks.count >= params.window.min_observations
    usable &= tracks.anchor < len(frames) - 3
    usable &= tracks.rays[tracks.start[:-1], 2] > MIN_RAY_Z

    landmark = np.cumsum(usable) - 1
    is_factor = usable[tracks.track]
    is_factor[tracks.start[:-1]] = False
    observation = np.flatnonzero(is_factor)
    if params.projection.residual == "plane":
        observation = observation[tracks.rays[observation, 2] > MIN_RAY_Z]
    track = tracks.track[observation]
    projections = Projections(
        tracks.anchor[track],
        tracks.slots[observation],
        landmark[track],
        tracks.rays[tracks.start[track]],
        tracks.rays[observation],
    )
    problem = WindowProblem(
        States(
            np.array([np.concatenate([f.p_w_b, f.q_w_b]) for f in frames]),
            np.array([np.concatenate([f.v_w_b, f.b_a, f.b_g]) for f in frames]),
            np.concatenate([window.T_b_c[:, :3, 3], so3.from_matrix(window.T_b_c[:, :3, :3])], 1),
            inv_depth[usable],
        ),
        projections,
        tuple(
            (k - 1, f.imu)
            for k, f in enumerate(frames)
            if k > 0 and f.imu is not None and f.imu.dt_s <= params.imu.max_interval_s
        ),
        _place_prior(window),
        gravity_m_s2,
        params.projection.residual,
        FOCAL_PX / params.window.pixel_sigma,
        Loss(params.window.loss, params.window.loss_scale),
    )
    return Assembly(problem, tracks, tracks.ids[usable], tracks.anchor[usable])


def _place_prior(window: WindowState) -> PriorFactor | None:
    if window.prior is None:
        return None
    slot = {f.frame: k for k, f in enumerate(window.frames)}
    prior = window.prior
    blocks = tuple(Variable(b.kind, b.id if b.kind == "extrinsic" else slot[b.id]) for b in prior.blocks)
    return PriorFactor(blocks, prior.x0, prior.J, prior.r)


def unpack(window: WindowState, assembly: Assembly, states: States) -> WindowState:
    """`window` with the solved states, moved so that yaw and position of the oldest frame stay (REFERENCE O9)."""
    states = hold_oldest(states, assembly.problem.initial.poses[0])
    frames = tuple(
        replace(f, p_w_b=pose[:3], q_w_b=pose[3:], v_w_b=motion[:3], b_a=motion[3:6], b_g=motion[6:])
        for f, pose, motion in zip(window.frames, states.poses, states.speed_biases)
    )
    table = window.landmarks
    inv_depth = table.inv_depth.copy()
    inv_depth[np.searchsorted(table.ids, assembly.ids)] = states.inv_depths
    return replace(window, frames=frames, landmarks=Landmarks(table.ids, inv_depth, table.status))


def solve_report(assembly: Assembly, solution: Solution) -> SolveReport:
    """Costs, iterations, and what each factor of the window's own frames says at the solution."""
    problem, residuals = assembly.problem, solution.system.residuals
    own = problem.projections.observer < problem.n_frames  # the others see it from places (relocalize.py)
    table = problem.projections[own]
    sigma = np.full((problem.n_frames - 1, 5), np.nan)
    sigma[[k for k, _ in problem.imu]] = np.linalg.norm(residuals.imu.reshape(-1, 5, 3), axis=2)
    return SolveReport(
        before=solution.before,
        after=solution.after,
        iterations=solution.iterations,
        termination=solution.termination,
        n_landmarks=problem.n_landmarks,
        visual_ids=assembly.ids[table.landmark],
        visual_slots=np.stack([table.anchor, table.observer], 1).astype(np.uint8),
        visual_error_px=(np.hypot(*residuals.visual[:, own]) * (FOCAL_PX / problem.sqrt_info)).astype(np.float32),
        imu_sigma=sigma,
    )


def inv_depth_sigma(solution: Solution) -> np.ndarray:
    """(M,) standard deviation of each inverse depth from the visual information alone, poses held."""
    h = solution.system.h
    return np.where(h > 0, 1.0 / np.sqrt(np.where(h > 0, h, 1.0)), np.nan)
