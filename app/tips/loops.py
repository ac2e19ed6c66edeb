"""What the words of loop closing mean: gates, stages of the funnel, fates of matches, drift corrections.

"L8", "16.12" are lines of the inventory of VINS.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from vins_core.report import MatchStage

from .tip import Tip

_GATES = {
    "start": Tip("start", "Keyframes before this one; the first ones may be left out.", source="L3"),
    "every": Tip("every", "Keyframes since the last one that was used.", source="L4; seed 000"),
    "spacing": Tip("spacing", "How far the body moved since the last keyframe that was used.", unit="m", source="L4"),
    "landmarks": Tip(
        "landmarks",
        "Tracks of this keyframe whose position the window knows. Only they can place the earlier camera, so with "
        "fewer than the inliers asked for no loop can ever be accepted.",
        source="L1, 16.12",
    ),
    "keyframes between": Tip(
        "keyframes between", "Keyframes that lie between the two: neighbours always look alike.", source="L7, 16.7"
    ),
    "distinctive": Tip(
        "distinctive",
        "The highest score with any keyframe, the previous one included: an image that is like nothing, not even what "
        "was seen a moment ago, cannot be recognised.",
        source="L8, 16.8",
    ),
    "score": Tip(
        "score",
        "How much the two images have in common as bags of words. Relative: over the score with the previous keyframe.",
        equation="s(a, b) = 1 − ½ | a/|a|₁ − b/|b|₁ |₁,   a, b: TF-IDF weights",
        source="L6, L8, 16.9; seed 004.24",
    ),
    "rank": Tip("rank", "Place among the scores of all earlier keyframes; 1 is the best.", source="L7"),
    "earlier candidates": Tip(
        "earlier candidates",
        "Candidates with a lower number. With loop.order = oldest only the earliest is looked at, as in VINS.",
        source="L9, 16.11",
    ),
    "matches": Tip(
        "matches",
        "Landmarks whose descriptor has a match that is near enough, clearly nearer than anything else, and mutual.",
        equation="h ≤ loop.max_hamming,  h ≤ loop.max_ratio · h₂,  mutual",
        source="16.12",
    ),
    "epipolar inliers": Tip(
        "epipolar inliers",
        "Matches that agree on one essential matrix (RANSAC).",
        equation="f₂ᵀ E f₁ ≈ 0",
        source="16.13",
    ),
    "pose inliers": Tip(
        "pose inliers",
        "Landmarks that the final pose of the earlier camera sees within loop.pnp_px of where they were matched.",
        source="16.14, 23.2",
    ),
    "reprojection error": Tip(
        "reprojection error", "Root mean square over the inliers of the final pose.", unit="px460", source="16.14, 23.2"
    ),
    "position sigma": Tip(
        "position sigma",
        "Standard deviation of the relative position in its worst direction, from the inliers' Jacobian.",
        equation="√ λ_max(Σ_p)",
        unit="m",
    ),
    "tilt": Tip(
        "tilt",
        "Angle between gravity as the earlier keyframe knew it and as the pose says: roll and pitch do not drift.",
        unit="deg",
    ),
    "heading": Tip(
        "heading",
        "Turn about gravity between the two bodies. Euler yaw (parity) fails where the body's x axis is near vertical.",
        unit="deg",
        source="16.15, 23.1",
    ),
    "distance": Tip("distance", "Between the two bodies, by the pose found.", equation="|p|", unit="m", source="16.16"),
    "drift": Tip(
        "drift",
        "The correction that the loop asks for, over the standard deviation that odometry and earlier loops leave it.",
        equation="√( eᵀ (W_odometry + W_loop)⁻¹ e ) / loop.drift_inflation,   e = Log(T_loop T_predicted⁻¹)",
        unit="sigma",
    ),
    "agreement": Tip(
        "agreement",
        "Other keyframes shortly before that ask for the same correction. It decides where the drift alone does not: "
        "above loop.sure_drift, and between sessions that no odometry joins.",
    ),
}

_FUNNEL = {
    "loops": Tip(
        "loops",
        "Above: keyframes that closed a loop. Below: keyframes for which an earlier one was looked at and refused.",
    ),
    "loops.funnel": Tip(
        "funnel",
        "How far the keyframes of the run came: every bar counts those that passed its stage and all before it.",
        source="16",
    ),
    "loops.queried": Tip("queried", "Keyframes that were described and offered to retrieval.", source="16.3–16.6"),
    "loops.retrievable": Tip(
        "retrievable", "They have landmarks enough, something earlier to compare with, and are distinctive.",
        source="16.7, 16.8",
    ),
    "loops.scored": Tip("scored", "An earlier keyframe looks alike and is among the best.", source="16.9–16.11"),
    "loops.matched": Tip("matched", "Enough descriptors match.", source="16.12"),
    "loops.epipolar": Tip("epipolar", "Enough matches agree on one epipolar geometry.", source="16.13"),
    "loops.PnP": Tip("PnP", "A pose was found, with inliers enough and small errors.", source="16.14"),
    "loops.heading": Tip("heading", "Gravity agrees, and the heading differs little.", source="16.15"),
    "loops.distance": Tip("distance", "The two are near to each other.", source="16.16"),
    "loops.consistent": Tip("consistent", "What the loop says fits the odometry, alone or with others that agree."),
    "loops.accepted": Tip("accepted", "The loop became an edge of the pose graph.", source="16.17"),
    "loops.truth": Tip(
        "same place",
        "By ground truth: where the two keyframes really were. Nothing in the estimator ever looks at it.",
    ),
    "loops.remedy": Tip(
        "remedy",
        "The smallest joint change of limits that lets this pair pass every gate, and what else it would let in.",
    ),
    "loops.prediction": Tip(
        "prediction",
        "Every recorded value judged by the new limits, with the trajectory as it was recorded. A loop that is gained "
        "or lost changes the drift correction and what later loops are held against, so from the first difference on "
        "only a fork knows.",
    ),
    "loops.pair": Tip(
        "why not these two",
        "Any two keyframes by their numbers, whether retrieval proposed them or not: every gate is judged.",
    ),
    "loops.edge": Tip(
        "edge",
        "What the pose graph makes of a loop: how far measured and estimated relative pose are apart, and the weight "
        "that the robust loss leaves it.",
        equation="r = [R_iᵀ(p_j − p_i) − p_ij,  ψ_j − ψ_i − ψ_ij],   weight = ρ'(|r|²)",
        source="Q1–Q3; seeds 000.4, 004.24",
    ),
    "drift.graph": Tip(
        "graph drift",
        "How far the drift correction by the pose graph moves the newest position: accurate, but late.",
        equation="| T_g_o p − p |",
        unit="m",
        frame="o, the odometry's world",
        source="Q5; seed 000.3.3.5",
    ),
    "drift.fast": Tip(
        "loop drift",
        "The same by the newest loop alone, refined in the window where that succeeded: at once, but by one loop.",
        equation="| T_fast p − p |",
        unit="m",
        frame="o, the odometry's world",
        source="R3; seed 000.3.3.5",
    ),
    "drift.apart": Tip(
        "difference of the drifts",
        "Distance between the positions that the two corrections give the newest frame.",
        equation="| T_g_o p − T_fast p |",
        unit="m",
        source="seed 000.3.3.5",
    ),
}  # fmt: skip

_MATCHES = {
    MatchStage.FAR: "The most similar point of the other keyframe differs in more than loop.max_hamming bits.",
    MatchStage.AMBIGUOUS: "Another point, elsewhere in the image, is nearly as similar: above loop.max_ratio.",
    MatchStage.ONE_SIDED: "Seen from the other keyframe, that point resembles another one more.",
    MatchStage.EPIPOLAR: "The match is off the epipolar geometry that most others agree on.",
    MatchStage.PNP: "The final pose sees the landmark elsewhere: off by more than loop.pnp_px.",
    MatchStage.INLIER: "The landmark supports the final pose.",
    MatchStage.GUIDED: "Searched for again where the pose sees the landmark, and found: it supports the pose.",
    MatchStage.MATCHED: "Matched, and not looked at further.",
}

LOOPS: Mapping[str, Tip] = MappingProxyType(
    {
        **{f"gate.loop.{name}": tip for name, tip in _GATES.items()},
        **_FUNNEL,
        **{f"match.{stage}": Tip(str(stage), words) for stage, words in _MATCHES.items()},
    }
)
