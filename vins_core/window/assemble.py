"""From the window to a least-squares problem and back.

`tracks_of` lines up what each track was seen as in the frames of a window; `assemble` chooses the landmarks that
enter the solve and builds the factor tables; `unpack` writes solved states into a new window; `solve_report` and
`inv_depth_sigma` explain the result.
"""

from __future__ import annotations

import operator
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..factors.reprojection import FOCAL_PX, Kind
from ..factors.robust import Loss
from ..geometry import se3, so3
from ..geometry.inverse_depth import MIN_RAY_Z
from ..params import Params
from ..report import SolveReport
from ..solver.layout import Variable
from ..solver.problem import PriorFactor, Projections, RayMotion, States, WindowProblem, hold_oldest
from ..solver.trust_region import Solution
from . import depth
from .state import OUTLIER, Landmarks, Observations, WindowFrame, WindowState
from .timing import referred_to, right_velocity


@dataclass(frozen=True)
class Tracks:
    """Every observation in a window, sorted by (track id, slot).  Track k owns rows start[k] : start[k + 1]."""

    ids: np.ndarray  # (T,) int64, increasing
    start: np.ndarray  # (T + 1,)
    slots: np.ndarray  # (O,) slot of each observation
    rays: np.ndarray  # (O, 3) unit rays
    uv_px: np.ndarray  # (O, 2) float32
    right: np.ndarray | None = None  # (O, 3) unit rays in the second camera, NaN where it does not see the track
    velocity: np.ndarray | None = None  # (O, 2) d(x/z, y/z)/dt of rays, where the time offset is estimated
    right_velocity: np.ndarray | None = None  # (O, 2) likewise of right
    depth_m: np.ndarray | None = None  # (O,) along z of the first camera, NaN where a depth camera says nothing

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

    @property
    def stereo(self) -> np.ndarray:
        """(T,) bool, whether the second camera has seen a track at all: then one frame is enough for its depth."""
        if self.right is None:
            return np.zeros(len(self.ids), bool)
        return np.bincount(self.track, ~np.isnan(self.right[:, 0]), len(self.ids)) > 0


class _Newest(threading.local):
    """What `tracks_of` was asked last, and what it said: each step of a frame's turn asks it about the same tracks."""

    seen: tuple[Observations, ...] = ()
    timing: tuple[float | bool, ...] = ()
    tracks: Tracks | None = None


_newest = _Newest()


def tracks_of(window: WindowState) -> Tracks:
    """The tracks of a window, as seen at the times of its poses."""
    seen = tuple(f.observations for f in window.frames)
    timing = (window.td_s, window.knows_td, *(f.td_s for f in window.frames))
    same = len(seen) == len(_newest.seen) and all(map(operator.is_, seen, _newest.seen))
    if not same or timing != _newest.timing or _newest.tracks is None:
        frames = tuple(referred_to(f, window.td_s) for f in window.frames)
        _newest.seen, _newest.timing, _newest.tracks = seen, timing, gather_tracks(frames, window.knows_td)
    return _newest.tracks


def gather_tracks(frames: tuple[WindowFrame, ...], moving: bool = False) -> Tracks:
    """The tracks of `frames`, oldest first; `moving`: with their velocities."""
    observations = [f.observations for f in frames]
    stereo = any(o.right is not None for o in observations)
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
        _of_right(observations, lambda o, right: right.rays, 3)[order] if stereo else None,
        np.concatenate([o.velocity for o in observations])[order].astype(float) if moving else None,
        _of_right(observations, right_velocity, 2)[order] if stereo and moving else None,
        _depths(observations)[order] if any(o.depth_m is not None for o in observations) else None,
    )


def _of_right(
    observations: list[Observations], value: Callable[[Observations, Observations], np.ndarray], size: int
) -> np.ndarray:
    """(O, size), NaN where the second camera does not see what the first one does."""
    rows = [np.full((len(o), size), np.nan) for o in observations]
    for mine, o in zip(rows, observations):
        if o.right is not None:
            mine[np.searchsorted(o.ids, o.right.ids)] = value(o, o.right)
    return np.concatenate(rows)


def _depths(observations: list[Observations]) -> np.ndarray:
    """(O,), NaN also where a ray has no place on the normalised plane."""
    return np.concatenate(
        [
            np.full(len(o), np.nan) if o.depth_m is None else np.where(o.rays[:, 2] > MIN_RAY_Z, o.depth_m, np.nan)
            for o in observations
        ]
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
    `window.min_observations` frames, and anchored early enough: slot < n - 3 (REFERENCE W6: < 8 of 11).  One that a
    second camera has seen, or a depth camera at its anchor, needs no parallax and may be anchored in any.
    """
    frames = window.frames
    tracks = tracks_of(window)
    table = window.landmarks
    row = np.minimum(np.searchsorted(table.ids, tracks.ids), max(len(table) - 1, 0))
    inv_depth, usable = np.zeros(len(tracks.ids)), np.zeros(len(tracks.ids), bool)
    if len(table):
        inv_depth = table.inv_depth[row]
        usable = (table.ids[row] == tracks.ids) & (table.status[row] != OUTLIER)
        usable &= inv_depth > 0  # False for NaN
    usable &= tracks.count >= params.window.min_observations
    measured = depth.points(params.depth, window, tracks, np.where(inv_depth > 0, inv_depth, np.nan))
    near = tracks.stereo if measured is None else tracks.stereo | measured.counts
    usable &= (tracks.anchor < len(frames) - 3) | near

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
        motion=_motion(tracks, tracks.velocity, track, observation, window.td_s),
    )
    problem = WindowProblem(
        States(
            np.array([np.concatenate([f.p_w_b, f.q_w_b]) for f in frames]),
            np.array([np.concatenate([f.v_w_b, f.b_a, f.b_g]) for f in frames]),
            np.concatenate([window.T_b_c[:, :3, 3], so3.from_matrix(window.T_b_c[:, :3, :3])], 1),
            inv_depth[usable],
            np.array([window.td_s]),
        ),
        projections,
        tuple(
            (k - 1, f.imu)
            for k, f in enumerate(frames)
            if window.inertial and k > 0 and f.imu is not None and f.imu.dt_s <= params.imu.max_interval_s
        ),
        _place_prior(window),
        gravity_m_s2,
        params.projection.residual,
        FOCAL_PX / params.window.pixel_sigma,
        Loss(params.window.loss, params.window.loss_scale),
        stereo=() if tracks.right is None else _stereo_projections(params, tracks, tracks.right, usable, window.td_s),
        depths=None if measured is None else depth.factors(params.depth, measured, usable),
        inertial=window.inertial,
    )
    return Assembly(problem, tracks, tracks.ids[usable], tracks.anchor[usable])


def _stereo_projections(
    params: Params, tracks: Tracks, right: np.ndarray, usable: np.ndarray, td_s: float
) -> tuple[Projections, Projections]:
    """What the second camera sees of usable tracks: in later frames, and in the frame of the anchor."""
    landmark, is_anchor = np.cumsum(usable) - 1, np.zeros(len(tracks.slots), bool)
    is_anchor[tracks.start[:-1]] = True
    seen = usable[tracks.track] & ~np.isnan(right[:, 0])
    if params.projection.residual == "plane":
        seen &= right[:, 2] > MIN_RAY_Z  # False for NaN

    def table(rows: np.ndarray, kind: Kind) -> Projections:
        track = tracks.track[rows]
        rays = tracks.rays[tracks.start[track]], right[rows]
        motion = _motion(tracks, tracks.right_velocity, track, rows, td_s)
        return Projections(tracks.anchor[track], tracks.slots[rows], landmark[track], *rays, 0, 1, kind, motion)

    return table(np.flatnonzero(seen & ~is_anchor), "cross"), table(np.flatnonzero(seen & is_anchor), "same")


def _motion(
    tracks: Tracks, observed: np.ndarray | None, track: np.ndarray, rows: np.ndarray, td_s: float
) -> RayMotion | None:
    """Of projections of `track` seen in `rows`; None where the time offset is not estimated."""
    if tracks.velocity is None or observed is None:
        return None
    return RayMotion(tracks.velocity[tracks.start[track]], observed[rows], td_s)


def _place_prior(window: WindowState) -> PriorFactor | None:
    if window.prior is None:
        return None
    slot = {f.frame: k for k, f in enumerate(window.frames)}
    prior = window.prior
    blocks = tuple(Variable(b.kind, slot[b.id] if b.of_frame else b.id) for b in prior.blocks)
    return PriorFactor(blocks, prior.x0, prior.J, prior.r)


def unpack(window: WindowState, assembly: Assembly, states: States) -> WindowState:
    """`window` with the solved states, moved so that yaw and position of the oldest frame stay (REFERENCE O9).

    Without IMU all of its pose stays, and velocities are those from frame to frame.  What of the calibration was free
    is as solved.
    """
    problem = assembly.problem
    states = hold_oldest(states, problem.initial.poses[0], not problem.inertial)
    motions = states.speed_biases if problem.inertial else _velocities(window.frames, states)
    frames = tuple(
        replace(f, p_w_b=pose[:3], q_w_b=pose[3:], v_w_b=motion[:3], b_a=motion[3:6], b_g=motion[6:])
        for f, pose, motion in zip(window.frames, states.poses, motions)
    )
    table = window.landmarks
    inv_depth = table.inv_depth.copy()
    inv_depth[np.searchsorted(table.ids, assembly.ids)] = states.inv_depths
    window = replace(window, frames=frames, landmarks=Landmarks(table.ids, inv_depth, table.status))
    if problem.free_extrinsics:
        T_b_c = se3.from_quaternion_translation(states.extrinsics[:, 3:], states.extrinsics[:, :3])
        window = replace(window, T_b_c=T_b_c)
    return replace(window, td_s=float(states.td_s[0])) if problem.free_td else window


def _velocities(frames: tuple[WindowFrame, ...], states: States) -> np.ndarray:
    """(n, 9) speed-biases: the mean velocity since the frame before, that of the oldest as it was, and no biases."""
    motions = np.zeros_like(states.speed_biases)
    dt_s = np.diff([f.t_ns for f in frames])[:, None] * 1e-9
    motions[0, :3], motions[1:, :3] = frames[0].v_w_b, np.diff(states.poses[: len(frames), :3], axis=0) / dt_s
    return motions


def solve_report(assembly: Assembly, solution: Solution) -> SolveReport:
    """Costs, iterations, and what each factor of the window's own frames says at the solution."""
    problem, residuals = assembly.problem, solution.system.residuals
    tables = (problem.projections, *problem.stereo)
    landmark, anchor, observer = (
        np.concatenate([getattr(table, name) for table in tables]) for name in ("landmark", "anchor", "observer")
    )
    camera = np.repeat([table.seen_by for table in tables], [len(table) for table in tables]).astype(np.uint8)
    own = observer < problem.n_frames  # the others see it from places (relocalize.py)
    sigma = np.full((problem.n_frames - 1, 5), np.nan)
    sigma[[k for k, _ in problem.imu]] = np.linalg.norm(residuals.imu.reshape(-1, 5, 3), axis=2)
    return SolveReport(
        before=solution.before,
        after=solution.after,
        iterations=solution.iterations,
        termination=solution.termination,
        n_landmarks=problem.n_landmarks,
        visual_ids=assembly.ids[landmark[own]],
        visual_slots=np.stack([anchor[own], observer[own]], 1).astype(np.uint8),
        visual_error_px=(np.hypot(*residuals.visual[:, own]) * (FOCAL_PX / problem.sqrt_info)).astype(np.float32),
        imu_sigma=sigma,
        visual_camera=camera[own] if problem.stereo else camera[:0],
    )


def inv_depth_sigma(solution: Solution) -> np.ndarray:
    """(M,) standard deviation of each inverse depth from the visual information alone, poses held."""
    h = solution.system.h
    return np.where(h > 0, 1.0 / np.sqrt(np.where(h > 0, h, 1.0)), np.nan)
