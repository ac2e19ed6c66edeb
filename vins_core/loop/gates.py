"""Every gate of the loop stage: its name, its limit's parameter, and what failing it means (REFERENCE 16).

Gates are made here and nowhere else, so that one table explains them all.  Values do not depend on limits, but those
of consistency depend on what was decided before: rejudge.py tells what other limits would have decided.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from ..params import Loop
from ..report import Gate, LoopOutcome
from .vocabulary import ScoreLimits

MEANING: Mapping[str, LoopOutcome] = MappingProxyType(
    {
        "start": LoopOutcome.LEFT_OUT,
        "every": LoopOutcome.LEFT_OUT,
        "spacing": LoopOutcome.LEFT_OUT,
        "landmarks": LoopOutcome.FEW_LANDMARKS,
        "keyframes between": LoopOutcome.TOO_RECENT,
        "distinctive": LoopOutcome.NOT_DISTINCTIVE,
        "score": LoopOutcome.NOT_SIMILAR,
        "rank": LoopOutcome.NOT_CHOSEN,
        "earlier candidates": LoopOutcome.NOT_CHOSEN,
        "matches": LoopOutcome.FEW_MATCHES,
        "epipolar inliers": LoopOutcome.EPIPOLAR,
        "pose inliers": LoopOutcome.PNP,
        "reprojection error": LoopOutcome.UNCERTAIN,
        "position sigma": LoopOutcome.UNCERTAIN,
        "tilt": LoopOutcome.TILT,
        "heading": LoopOutcome.HEADING,
        "distance": LoopOutcome.DISTANCE,
        "drift": LoopOutcome.INCONSISTENT,
        "agreement": LoopOutcome.UNCONFIRMED,
    }
)
"""What it means to fail a gate, in the order in which they are judged."""


def outcome(gates: Iterable[Gate]) -> LoopOutcome:
    """Of the first deciding gate that has not passed; ACCEPTED when all have."""
    return next((MEANING[g.name] for g in gates if g.decides and not g.passed), LoopOutcome.ACCEPTED)


def start(params: Loop, seen: int) -> Gate:
    """Keyframes so far, L3."""
    return Gate("start", seen, ">=", params.skip_first, "loop.skip_first", "keyframes")


def every(params: Loop, since: int) -> Gate:
    """Keyframes since the last one used, L4."""
    return Gate("every", since, ">=", params.every, "loop.every", "keyframes")


def spacing(params: Loop, moved_m: float) -> Gate:
    """Motion since the last keyframe used, L4."""
    return Gate("spacing", moved_m, ">=", params.min_spacing_m, "loop.min_spacing_m", "m")


def landmarks(params: Loop, n: int) -> Gate:
    """With fewer landmarks than inliers are asked for, no loop can be accepted."""
    return Gate("landmarks", n, ">=", params.min_inliers, "loop.min_inliers")


def between(params: Loop, n: int) -> Gate:
    return Gate("keyframes between", n, ">=", params.min_gap, "loop.min_gap", "keyframes")


def distinctive(params: Loop, best: float | None, limits: ScoreLimits) -> Gate:
    """Highest score of any keyframe, the previous one included: can this image be recognised at all?  L8."""
    limit = params.min_neighbour_score or limits.neighbour
    return Gate("distinctive", best, ">=", limit, "loop.min_neighbour_score")


def score(params: Loop, value: float, neighbour: float | None, limits: ScoreLimits) -> Gate:
    """Score of a candidate, L8; relative to that of the previous keyframe, or to the least that one should have."""
    if params.score == "absolute":
        return Gate("score", value, ">=", params.min_score or limits.candidate, "loop.min_score")
    expected = max(neighbour or 0.0, limits.neighbour)
    return Gate("score", value / expected if expected else None, ">=", params.min_score_ratio, "loop.min_score_ratio")


def rank(params: Loop, position: int) -> Gate:
    """Place among the scores, 1 for the highest, L7."""
    return Gate("rank", position, "<=", params.candidates, "loop.candidates")


def earlier_candidates(n: int) -> Gate:
    """Candidates with a lower number, L9: VINS looks at the earliest one only."""
    return Gate("earlier candidates", n, "<=", 0, "loop.order")


def matches(params: Loop, n: int) -> Gate:
    return Gate("matches", n, ">=", params.min_matches, "loop.min_matches")


def epipolar(params: Loop, n: int | None) -> Gate:
    return Gate("epipolar inliers", n, ">=", params.min_epipolar, "loop.min_epipolar")


def inliers(params: Loop, n: int | None) -> Gate:
    """Landmarks within `pnp_px` of the final pose's reprojection, counted after its last refinement."""
    return Gate("pose inliers", n, ">=", params.min_inliers, "loop.min_inliers")


def rms(params: Loop, error_px: float | None) -> Gate:
    return Gate("reprojection error", error_px, "<=", params.max_rms_px, "loop.max_rms_px", "px460")


def sigma(params: Loop, sigma_m: float | None) -> Gate:
    """Largest standard deviation of the relative position in any direction."""
    return Gate("position sigma", sigma_m, "<=", params.max_sigma_m, "loop.max_sigma_m", "m")


def tilt(params: Loop, angle_deg: float | None) -> Gate:
    """Roll and pitch do not drift: the pose found must agree with the odometry on where gravity points."""
    return Gate("tilt", angle_deg, "<=", params.max_tilt_deg, "loop.max_tilt_deg", "deg")


def heading(params: Loop, angle_deg: float | None) -> Gate:
    return Gate("heading", angle_deg, "<=", params.max_heading_deg, "loop.max_heading_deg", "deg")


def distance(params: Loop, distance_m: float | None) -> Gate:
    return Gate("distance", distance_m, "<=", params.max_distance_m, "loop.max_distance_m", "m")


def drift(params: Loop, sigmas: float | None, decides: bool = True) -> Gate:
    """Correction that the loop asks for, over the standard deviation of what was known (consistency.py)."""
    return Gate("drift", sigmas, "<=", params.max_drift, "loop.max_drift", "sigma", decides)


def agreement(params: Loop, n: int | None, decides: bool = True) -> Gate:
    """Keyframes shortly before that ask for the same correction; decides where the bound alone does not."""
    return Gate("agreement", n, ">=", params.min_agreement, "loop.min_agreement", "keyframes", decides)
