"""Do two keyframes show the same place, and how do they lie to each other?  (REFERENCE 16.12-16)

Landmarks of the later keyframe are matched with points of the earlier one, thinned by their epipolar geometry, and the
earlier camera is placed by them (PnP); its pose must then make sense.  The stages run in order and stop at the gate
that decides, or run on, to know every value that can be computed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..frontend.reject import FOCAL_PX, epipolar_inliers
from ..geometry import heading, poses, se3, so3
from ..geometry.pnp import MIN_POINTS, Pnp, pose_covariance, solve_pnp
from ..params import Frontend, Loop
from ..report import MATCH_STAGES, Gate, LoopCandidate, LoopMatches, MatchStage, all_pass
from . import gates
from .keyframe import LoopKeyframe
from .match import Matches, match, search

PNP_SCALE = 3.0
"""`solve_pnp` counts inliers up to three of its robust scales."""
SEARCHES = 2
"""How often landmarks are searched for again with a pose: the second time it is a better one."""


@dataclass(frozen=True)
class Pair:
    """Two keyframes, and what retrieval says about them."""

    query: int
    match: int
    later: LoopKeyframe
    earlier: LoopKeyframe
    score: float
    retrieval: tuple[Gate, ...]


@dataclass(frozen=True)
class Evidence:
    """What the stages have found so far; rows are the landmarks of the later keyframe."""

    matches: Matches | None = None
    alive: np.ndarray | None = None  # (n,) bool, matches that no stage has dropped
    stage: np.ndarray | None = None  # (n,) uint8, index into MATCH_STAGES
    pnp: Pnp | None = None  # of the earlier camera, in the world of the later keyframe
    T_match_query: np.ndarray | None = None
    covariance: np.ndarray | None = None


def verify(params: Loop, pair: Pair, evaluate_all: bool = False) -> LoopCandidate:
    """Judge a pair; the gates end at the first failure unless `evaluate_all`.  Pure."""
    found, judged = Evidence(), pair.retrieval
    for stage in (_match, _thin, _place, _check):
        if not (evaluate_all or all_pass(judged)):
            break
        found, new = stage(params, pair, found)
        judged += new
    return LoopCandidate(
        pair.query,
        pair.match,
        pair.score,
        judged,
        gates.outcome(judged),
        _explain(pair, found),
        found.T_match_query,
        found.covariance,
    )


def _match(params: Loop, pair: Pair, found: Evidence) -> tuple[Evidence, tuple[Gate, ...]]:
    later, earlier = pair.later, pair.earlier
    matches = match(later.descriptors, later.uv_px, later.n_landmarks, earlier.descriptors, earlier.uv_px)
    if matches is None:
        return found, (gates.matches(params, 0),)
    tests = (matches.near(params), matches.distinct(params), matches.agreed(params))
    fates = (MatchStage.FAR, MatchStage.AMBIGUOUS, MatchStage.ONE_SIDED)
    stage = np.select([~t for t in tests], [_code(f) for f in fates], _code(MatchStage.MATCHED)).astype(np.uint8)
    alive = np.logical_and.reduce(tests)
    return Evidence(matches, alive, stage), (gates.matches(params, int(alive.sum())),)


def _thin(params: Loop, pair: Pair, found: Evidence) -> tuple[Evidence, tuple[Gate, ...]]:
    if params.epipolar == "off":
        return found, ()
    if found.matches is None or found.alive is None or found.stage is None:
        return found, (gates.epipolar(params, None),)
    rows = np.flatnonzero(found.alive)
    rule = Frontend(
        epipolar_model=params.epipolar, F_threshold=params.epipolar_px, F_confidence=params.epipolar_confidence
    )
    inlier = epipolar_inliers(_rays(pair.later, rows), _rays(pair.earlier, found.matches.row[rows]), rule)
    alive, stage = found.alive.copy(), found.stage.copy()
    dropped = rows if inlier is None else rows[~inlier]
    alive[dropped], stage[dropped] = False, _code(MatchStage.EPIPOLAR)
    count = None if inlier is None else int(inlier.sum())
    return replace(found, alive=alive, stage=stage), (gates.epipolar(params, count),)


def _place(params: Loop, pair: Pair, found: Evidence) -> tuple[Evidence, tuple[Gate, ...]]:
    rows = np.flatnonzero(found.alive) if found.alive is not None else np.zeros(0, int)
    if len(rows) < MIN_POINTS or found.matches is None:
        return found, (gates.inliers(params, None), gates.rms(params, None), gates.sigma(params, None))
    placed = _solve(params, pair, rows, found.matches.row[rows], found.matches.hamming[rows], pair.later.T_w_c)
    for _ in range(SEARCHES if params.guided_px else 0):
        placed = _search_again(params, pair, placed)
    found = _record(found, placed)
    pnp, n, rms_px, sigma_m = placed.pnp, placed.pnp.n_inliers, None, None
    if n >= MIN_POINTS:
        T_w_match = _pose(pnp.T_w_c @ se3.inverse(pair.earlier.T_b_c))
        T_match_query = poses.between(T_w_match, pair.later.T_w_b)
        noise_rad = pnp.rms_rad * np.sqrt(n / (2 * n - 6))  # of one of the two coordinates
        points_w, rays = pair.later.points_w[placed.rows], _rays(pair.earlier, placed.points)
        covariance = _relative_covariance(
            pose_covariance(pnp.T_w_c, points_w[pnp.inlier], rays[pnp.inlier], noise_rad),
            T_w_match,
            T_match_query,
            pair.earlier.T_b_c,
        )
        found = replace(found, T_match_query=T_match_query, covariance=covariance)
        rms_px = FOCAL_PX * pnp.rms_rad
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    return found, (gates.inliers(params, n), gates.rms(params, rms_px), gates.sigma(params, sigma_m))


@dataclass(frozen=True)
class Placed:
    """Landmarks (rows), the points of the earlier keyframe they are matched with, and the pose they give."""

    rows: np.ndarray
    points: np.ndarray
    hamming: np.ndarray
    pnp: Pnp


def _solve(
    params: Loop, pair: Pair, rows: np.ndarray, points: np.ndarray, hamming: np.ndarray, guess: np.ndarray
) -> Placed:
    rays = _rays(pair.earlier, points)
    pnp = solve_pnp(pair.later.points_w[rows], rays, guess, params.pnp_px / FOCAL_PX / PNP_SCALE)
    assert pnp is not None  # there are points enough
    return Placed(rows, points, hamming, pnp)


def _search_again(params: Loop, pair: Pair, placed: Placed) -> Placed:
    """Match every landmark anew among the points near to where the pose sees it; keep what has more inliers.

    Where there is little choice a match needs no ratio: self-similar scenes regain what that test cost them.
    """
    if placed.pnp.n_inliers < MIN_POINTS:
        return placed
    later, earlier = pair.later, pair.earlier
    local = se3.transform(se3.inverse(placed.pnp.T_w_c), later.points_w)
    cosine = (local / np.linalg.norm(local, axis=1, keepdims=True)) @ earlier.rays.T
    near = cosine > np.cos(params.guided_px / FOCAL_PX)
    matched = search(later.descriptors[: later.n_landmarks], earlier.descriptors, near, params.max_hamming)
    if len(matched[0]) < MIN_POINTS:
        return placed
    again = _solve(params, pair, *matched, placed.pnp.T_w_c)
    return again if again.pnp.n_inliers >= placed.pnp.n_inliers else placed


def _record(found: Evidence, placed: Placed) -> Evidence:
    """What the pose made of each match: those it dropped, those that support it, those it found itself."""
    assert found.matches is not None and found.stage is not None and found.alive is not None
    stage, row = found.stage.copy(), found.matches.row.copy()
    hamming, ratio = found.matches.hamming.copy(), found.matches.ratio.copy()
    stage[found.alive] = _code(MatchStage.PNP)
    mine = placed.pnp.inlier
    rows, points = placed.rows[mine], placed.points[mine]
    anew = (row[rows] != points) | ~found.alive[rows]
    stage[rows] = np.where(anew, _code(MatchStage.GUIDED), _code(MatchStage.INLIER))
    row[rows], hamming[rows], ratio[rows[anew]] = points, placed.hamming[mine], np.nan
    matches = replace(found.matches, row=row, hamming=hamming, ratio=ratio)
    return replace(found, stage=stage, matches=matches, pnp=placed.pnp)


def _check(params: Loop, pair: Pair, found: Evidence) -> tuple[Evidence, tuple[Gate, ...]]:
    if found.T_match_query is None:
        return found, (gates.tilt(params, None), gates.heading(params, None), gates.distance(params, None))
    T_w_match = poses.compose(pair.later.T_w_b, poses.inverse(found.T_match_query))
    turned = heading_difference(params, pair.later.T_w_b, T_w_match)
    up_found, up_known = (
        so3.rotate(so3.inverse(T[3:]), np.array([0.0, 0.0, 1.0])) for T in (T_w_match, pair.earlier.T_w_b)
    )
    tilt = np.arctan2(np.linalg.norm(np.cross(up_found, up_known)), up_found @ up_known)
    return found, (
        gates.tilt(params, float(np.degrees(tilt))),
        gates.heading(params, float(np.degrees(np.abs(turned)))),
        gates.distance(params, float(np.linalg.norm(found.T_match_query[:3]))),
    )


def heading_difference(params: Loop, T_w_b: np.ndarray, T_w_b0: np.ndarray) -> float:
    """By how much a body (7,) faces another way than another one, in radians, as `loop.heading` tells it."""
    if params.heading == "gravity":
        return float(heading.difference(T_w_b[3:], T_w_b0[3:]))
    return float(heading.wrap(so3.heading(T_w_b[3:]) - so3.heading(T_w_b0[3:])))


def _relative_covariance(
    covariance: np.ndarray, T_w_match: np.ndarray, T_match_query: np.ndarray, T_b_c: np.ndarray
) -> np.ndarray:
    """From the tangent of T_w_c, the earlier camera, to that of T_match_query.

    With phi = R_b_c dtheta the earlier body turns by Exp(phi) and moves by dp - R_w_c (t_c_b x dtheta), so that
    dp_m_q = p_m_q x phi - R_w_m' dp + R_b_c (t_c_b x dtheta) and dtheta_m_q = -R_m_q' phi.
    """
    R_m_w, R_b_c = so3.to_matrix(T_w_match[3:]).T, T_b_c[:3, :3]
    t_c_b = se3.inverse(T_b_c)[:3, 3]
    A = np.zeros((6, 6))
    A[:3, :3] = -R_m_w
    A[:3, 3:] = so3.skew(T_match_query[:3]) @ R_b_c + R_b_c @ so3.skew(t_c_b)
    A[3:, 3:] = -so3.to_matrix(T_match_query[3:]).T @ R_b_c
    return A @ covariance @ A.T


def _explain(pair: Pair, found: Evidence) -> LoopMatches | None:
    if found.matches is None or found.stage is None:
        return None
    error = np.full(len(found.stage), np.nan, np.float32)
    if found.pnp is not None:
        local = se3.transform(se3.inverse(found.pnp.T_w_c), pair.later.points_w)
        rays = _rays(pair.earlier, found.matches.row)
        error[:] = FOCAL_PX * np.arctan2(np.linalg.norm(np.cross(local, rays), axis=1), np.sum(local * rays, axis=1))
    return LoopMatches(found.matches.row, found.matches.hamming, found.matches.ratio, found.stage, error)


def _rays(keyframe: LoopKeyframe, rows: np.ndarray) -> np.ndarray:
    return keyframe.rays[rows].astype(float)


def _code(stage: MatchStage) -> int:
    return MATCH_STAGES.index(stage)


def _pose(T: np.ndarray) -> np.ndarray:
    """(4, 4) -> (7,) p and q wxyz."""
    return np.concatenate([T[:3, 3], so3.from_matrix(T[:3, :3])])
