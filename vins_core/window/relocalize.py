"""Earlier keyframes seen again by the window: free poses with reprojection factors of their own (REFERENCE R1-R4).

The window is tied to an earlier place by landmarks that both see, and to nothing that is known of that place: its pose
is free.  So the solve finds how the two lie to each other, with every landmark as uncertain as it is, and the window
learns no more than the place's second look at its landmarks.  Places live for one solve and are never marginalised.

A place may have had another mounting of the camera, T_b_c' (an earlier session, or before calibration went on).  Its
pose in the problem is that of a body with the window's mounting and the same camera:  T_w_p = T_w_m T_b_c' T_b_c^-1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..factors.reprojection import FOCAL_PX
from ..geometry import se3, so3
from ..geometry.inverse_depth import MIN_RAY_Z
from ..report import RelocalizationReport
from ..solver.covariance import relative_poses
from ..solver.linearize import Linearizer
from ..solver.problem import Projections, RayMotion, States, WindowProblem, hold_oldest
from ..solver.trust_region import Solution
from .assemble import Assembly
from .state import WindowState

MIN_FACTORS = 6
"""Landmarks from which a free pose is found; each is worth two equations for its six unknowns."""


@dataclass(frozen=True)
class RelocalisationRequest:
    """Landmarks of the window that an earlier keyframe sees: what the loop stage asks the window to refine.

    It lives while the later keyframe is in the window.
    """

    query: int  # the later keyframe, counted over the session (`LoopReport.keyframe`)
    match: int  # the earlier one
    frame: int  # frame number of the later keyframe
    T_w_match: np.ndarray  # (7,) p and q wxyz: body of the earlier keyframe in the odometry's world, where to start
    T_b_c: np.ndarray  # (4, 4) of the earlier keyframe
    track_ids: np.ndarray  # (n,) int64, increasing
    rays: np.ndarray  # (n, 3) float64, unit rays in the earlier keyframe's camera


@dataclass(frozen=True)
class Place:
    """A request in a problem."""

    request: RelocalisationRequest
    query: int  # slot of the later keyframe
    slot: int | None  # of its own pose; None when too few landmarks take part to have one
    ids: np.ndarray  # (n,) int64, the landmarks that take part
    rows: slice  # of them in the table of projections, when there is a pose


def add_places(
    assembly: Assembly, window: WindowState, requests: tuple[RelocalisationRequest, ...]
) -> tuple[Assembly, tuple[Place, ...]]:
    """The problem with a pose for each request whose later keyframe is in the window, and where to find it."""
    problem, tracks = assembly.problem, assembly.tracks
    frames = [f.frame for f in window.frames]
    anchors = tracks.start[np.searchsorted(tracks.ids, assembly.ids)]
    own_rays, own_velocity = tracks.rays[anchors], None if tracks.velocity is None else tracks.velocity[anchors]
    places: list[Place] = []
    starts, tables, n_rows = [problem.initial.poses], [problem.projections], len(problem.projections)
    for request in requests:
        if request.frame not in frames:
            continue
        _, landmark, seen = np.intersect1d(assembly.ids, request.track_ids, assume_unique=True, return_indices=True)
        if problem.residual == "plane":
            in_front = request.rays[seen, 2] > MIN_RAY_Z
            landmark, seen = landmark[in_front], seen[in_front]
        n, query = len(landmark), frames.index(request.frame)
        if n < MIN_FACTORS:
            places.append(Place(request, query, None, assembly.ids[landmark], slice(0, 0)))
            continue
        slot = sum(len(s) for s in starts)
        rays = own_rays[landmark], request.rays[seen]
        motion = None
        if own_velocity is not None:  # what the place saw was put right when it left its window
            motion = RayMotion(own_velocity[landmark], np.zeros((n, 2)), window.td_s)
        tables.append(Projections(assembly.anchor[landmark], np.full(n, slot), landmark, *rays, motion=motion))
        starts.append(_row(_matrix(request.T_w_match) @ _mounting(request, problem.initial))[None])
        places.append(Place(request, query, slot, assembly.ids[landmark], slice(n_rows, n_rows + n)))
        n_rows += n
    if len(tables) > 1:
        initial = replace(problem.initial, poses=np.concatenate(starts))
        problem = replace(problem, initial=initial, projections=_joined(tables))
    return replace(assembly, problem=problem), tuple(places)


def relocalization_reports(
    problem: WindowProblem, places: tuple[Place, ...], solution: Solution
) -> tuple[RelocalizationReport, ...]:
    """What a solve made of the places, with yaw and position of the oldest frame as `unpack` leaves them.

    The covariance is the marginal one of the whole window, for its `pixel_sigma`.
    """
    posed = [place for place in places if place.slot is not None]
    before_px, after_px = _errors_px(problem, solution) if posed else np.zeros((2, 0))
    pairs = [(place.slot, place.query) for place in posed if place.slot is not None]
    covariances = dict(zip(pairs, relative_poses(problem, solution.states, pairs)))
    held = hold_oldest(solution.states, problem.initial.poses[0], not problem.inertial)
    T_w_b = se3.from_quaternion_translation(held.poses[:, 3:], held.poses[:, :3])
    reports = []
    for place in places:
        request = place.request
        error_px, T_w_m, covariance = np.full((2, len(place.ids)), np.nan), _matrix(request.T_w_match), None
        if place.slot is not None:
            error_px = np.stack([before_px[place.rows], after_px[place.rows]])
            T_m_p = _mounting(request, held)
            T_w_m = T_w_b[place.slot] @ se3.inverse(T_m_p)
            covariance = _turned(covariances[place.slot, place.query], T_m_p[:3, :3])
        reports.append(
            RelocalizationReport(
                request.query,
                request.match,
                request.frame,
                place.ids,
                error_px.astype(np.float32),
                _row(T_w_m),
                _row(se3.inverse(T_w_m) @ T_w_b[place.query]),
                covariance,
            )
        )
    return tuple(reports)


def _errors_px(problem: WindowProblem, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Of every projection (N,) before and after the solve, px460; before it only where places see something."""
    scale, seen = FOCAL_PX / problem.sqrt_info, problem.projections.observer >= problem.n_frames
    alone = replace(problem, projections=problem.projections[seen], stereo=(), imu=(), prior=None, depths=None)
    before = np.full(len(seen), np.nan)
    before[seen] = np.hypot(*Linearizer(alone).linearize(problem.initial).residuals.visual)
    return scale * before, scale * np.hypot(*solution.system.residuals.visual[:, : len(seen)])


def _mounting(request: RelocalisationRequest, states: States) -> np.ndarray:
    """T_m_p (4, 4): the body whose camera is mounted as the window's, in the body of the earlier keyframe."""
    return request.T_b_c @ se3.inverse(_matrix(states.extrinsics[0]))


def _turned(covariance: np.ndarray | None, R_m_p: np.ndarray) -> np.ndarray | None:
    """Of T_m_q = T_m_p T_p_q from that of T_p_q."""
    if covariance is None:
        return None
    A = np.eye(6)
    A[:3, :3] = R_m_p
    return A @ covariance @ A.T


def _matrix(T: np.ndarray) -> np.ndarray:
    """(7,) p and q wxyz -> (4, 4)."""
    return se3.from_quaternion_translation(T[3:], T[:3])


def _row(T: np.ndarray) -> np.ndarray:
    """(4, 4) -> (7,) p and q wxyz."""
    return np.concatenate([T[:3, 3], so3.from_matrix(T[:3, :3])])


def _joined(tables: list[Projections]) -> Projections:
    motion, motions = tables[0].motion, [t.motion for t in tables if t.motion is not None]
    if motion is not None:
        velocities_i, velocities_j = ([getattr(m, name) for m in motions] for name in ("velocity_i", "velocity_j"))
        motion = RayMotion(np.concatenate(velocities_i), np.concatenate(velocities_j), motion.td_s)
    return replace(
        tables[0],
        motion=motion,
        anchor=np.concatenate([t.anchor for t in tables]),
        observer=np.concatenate([t.observer for t in tables]),
        landmark=np.concatenate([t.landmark for t in tables]),
        rays_i=np.concatenate([t.rays_i for t in tables]),
        rays_j=np.concatenate([t.rays_j for t in tables]),
    )
