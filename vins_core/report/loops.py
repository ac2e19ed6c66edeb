"""Loop closure: candidates and their gates, relocalisation, pose graph."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from .gate import Gate, all_pass
from .solve import IterationReport


class LoopOutcome(StrEnum):
    """How far a keyframe, or a pair of keyframes, came: the funnel in order (REFERENCE 16)."""

    LEFT_OUT = "left out"  # at the start, or by thinning
    TOO_RECENT = "nothing earlier"
    FEW_LANDMARKS = "too few landmarks"
    NOT_DISTINCTIVE = "not distinctive"
    NOT_SIMILAR = "not similar"
    NOT_CHOSEN = "others were preferred"
    FEW_MATCHES = "too few matches"
    EPIPOLAR = "epipolar geometry"
    PNP = "pose"
    UNCERTAIN = "pose uncertain"
    TILT = "gravity"
    HEADING = "heading"
    DISTANCE = "distance"
    INCONSISTENT = "odometry"
    UNCONFIRMED = "waiting for others to agree"
    ACCEPTED = "accepted"


LOOP_OUTCOMES = tuple(LoopOutcome)


class MatchStage(StrEnum):
    """What became of a landmark on its way to a loop: what dropped its match, or that it supports the pose."""

    FAR = "descriptor"
    AMBIGUOUS = "ratio"
    ONE_SIDED = "cross check"
    EPIPOLAR = "epipolar"
    PNP = "pose"
    INLIER = "inlier"
    GUIDED = "found by the pose"  # an inlier that was searched for where the pose sees it
    MATCHED = "matched"  # and not looked at further


MATCH_STAGES = tuple(MatchStage)
"""`LoopMatches.stage` holds indices into this tuple."""


@dataclass(frozen=True)
class LoopMatches:
    """One row per landmark of the later keyframe: the most similar point of the earlier one, and its fate."""

    row: np.ndarray  # (n,) int32 of the earlier keyframe's points
    hamming: np.ndarray  # (n,) uint16 bits that differ
    ratio: np.ndarray  # (n,) float32 over the bits of the best match elsewhere; NaN when found by the pose
    stage: np.ndarray  # (n,) uint8, index into MATCH_STAGES
    error_px: np.ndarray  # (n,) float32 reprojection error at the final pose, px460; NaN without pose


@dataclass(frozen=True)
class LoopCandidate:
    """A pair of keyframes that may show the same place: every gate it met, and what is known of their pose."""

    query: int  # the later keyframe, counted over the session
    match: int  # the earlier one
    score: float
    gates: tuple[Gate, ...]
    outcome: LoopOutcome
    matches: LoopMatches | None = None
    T_match_query: np.ndarray | None = None  # (7,) p and q wxyz: the later body in the earlier one
    covariance: np.ndarray | None = None  # (6, 6) of it, tangent (dp, dtheta): p + dp, q * Exp(dtheta)
    T_predicted: np.ndarray | None = None  # (7,) the same by odometry and earlier loops; None where nothing joins them
    predicted_covariance: np.ndarray | None = None  # (6, 6) of it as claimed, before `loop.drift_inflation`

    @property
    def accepted(self) -> bool:
        return self.outcome is LoopOutcome.ACCEPTED


@dataclass(frozen=True)
class LoopReport:
    """What the loop stage made of one keyframe."""

    keyframe: int  # counted over the session
    frame: int
    t_ns: int
    n_landmarks: int
    n_points: int
    neighbour_score: float | None  # with the previous keyframe
    gates: tuple[Gate, ...]  # about this keyframe alone
    candidates: tuple[LoopCandidate, ...]  # in the order of verification
    outcome: LoopOutcome  # the furthest that it came
    T_w_b: np.ndarray | None = None  # (7,) p and q wxyz of the body in the odometry's world
    odometry: np.ndarray | None = None  # (6, 6) as in LoopKeyframe

    @property
    def accepted(self) -> LoopCandidate | None:
        return next((c for c in self.candidates if c.accepted), None)


@dataclass(frozen=True)
class RelocalizationReport:
    """An earlier keyframe as one window solve placed it (REFERENCE 12), and whether that may become an edge.

    One row per landmark of the request that took part in the solve; errors in px460.
    """

    query: int  # the later keyframe, counted over the session
    match: int  # the earlier one
    frame: int  # frame number of the later keyframe
    ids: np.ndarray  # (n,) int64 track ids
    error_px: np.ndarray  # (2, n) float32, before and after the solve
    T_w_match: np.ndarray  # (7,) p and q wxyz: the earlier body, refined, in the odometry's world
    T_match_query: np.ndarray  # (7,) the later body in the earlier one, both refined
    covariance: np.ndarray | None  # (6, 6) of T_match_query, tangent (dp, dtheta): p + dp, q * Exp(dtheta)
    gates: tuple[Gate, ...] = ()  # of loop/relocalize.py
    drift: np.ndarray | None = None  # (7,) T_g_w, what moves the odometry's world to the graph's; None until known

    @property
    def n_factors(self) -> int:
        return len(self.ids)

    @property
    def error_px_before(self) -> float:
        """rms, NaN without factors."""
        return _rms(self.error_px[0])

    @property
    def error_px_after(self) -> float:
        return _rms(self.error_px[1])

    @property
    def accepted(self) -> bool:
        """It has been judged, and passed every gate."""
        return bool(self.gates) and all_pass(self.gates)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values.astype(float))))) if len(values) else float("nan")


@dataclass(frozen=True)
class GraphCost:
    """Robust costs 1/2 sum rho(|r|^2) per kind of edge."""

    sequential: float = 0.0
    loop: float = 0.0

    @property
    def total(self) -> float:
        return self.sequential + self.loop


@dataclass(frozen=True)
class PoseGraphReport:
    """One optimisation of the pose graph (SPEC 7.3): what moved, how it converged, what each loop says.

    Columns 0 and 1 of the loop arrays are before and after.  Keyframes are counted from 0 over all sessions.
    """

    dof: int  # 4 or 6
    n_keyframes: int
    n_free: int  # keyframes that could move
    first_free: int  # the earliest of them, -1 if none
    n_sequential: int  # odometry edges at free keyframes
    loops: np.ndarray  # (l, 2) int64: earlier and later keyframe
    forced: np.ndarray  # (l,) bool: counted without robust loss because the user asked for it
    loop_error_m: np.ndarray  # (l, 2) distance between measured and estimated relative position
    loop_error_deg: np.ndarray  # (l, 2) same of the rotation; about gravity with 4 DoF
    loop_weight: np.ndarray  # (l, 2) rho': 1 = counts in full, 0 = ignored
    before: GraphCost
    after: GraphCost
    iterations: tuple[IterationReport, ...]
    termination: str
    session: int  # of the newest keyframe
    drift: np.ndarray  # (7,) T_graph_odometry of that session after the optimisation: (p, q wxyz)


@dataclass(frozen=True)
class KeyframeEntry:
    """A keyframe as it entered the pose graph."""

    number: int  # counted over all sessions
    session: int
    frame: int
    t_ns: int
    T_vio: np.ndarray  # (7,) p and q wxyz of the body in the odometry's world


@dataclass(frozen=True)
class LoopEdge:
    """An accepted loop as it entered the pose graph, once its keyframe had left the window."""

    earlier: int
    later: int
    T_i_j: np.ndarray  # (7,) the later body in the earlier one
    refined: bool  # by the window; else as PnP left it


@dataclass(frozen=True)
class ClosureReport:
    """What loop closing made of one frame (SPEC 7)."""

    keyframe: KeyframeEntry | None  # that this frame made
    loop: LoopReport | None  # of a keyframe that this frame made, used or left out
    edges: tuple[LoopEdge, ...]  # that entered the graph in this frame, before its keyframe
    graph: PoseGraphReport | None  # of an optimisation whose result is used from this frame on
    drift: np.ndarray  # (7,) T_g_o of this session by the graph: accurate, late (seed 000.3.3.5)
    fast_drift: np.ndarray  # (7,) the same by the newest loop: at once
