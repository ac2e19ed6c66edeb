"""Parameters of loop closure and pose graph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from .declaration import Doc, Range


@dataclass(frozen=True)
class PoseGraph:
    """Pose graph of keyframes and loops (REFERENCE 17; seeds 000.3.3.5, 000.4).

    Sets of values that belong together: pose_graph/presets.py.
    """

    dof: Annotated[
        Literal["4", "6"], Doc("what a keyframe may change: position and turn about gravity, or all of its pose")
    ] = "4"
    sequential_edges: Annotated[
        int, Range(1, 20), Doc("previous keyframes of its session to which a keyframe is tied (seed 000.4: 5)")
    ] = 4
    sigma_m: Annotated[float, Range(1e-4, 100), Doc("weight of positions: residuals are in units of it", "m")] = 1.0
    sigma_deg: Annotated[float, Range(1e-4, 180), Doc("weight of rotations: residuals are in units of it", "deg")] = 1.0
    loop_weight: Annotated[
        float, Range(0.001, 1000), Doc("factor on the residual of a loop (seed 000.4: 5, parity: 1)")
    ] = 0.5
    loop_rotation_weight: Annotated[
        float, Range(0.001, 1000), Doc("further factor on the rotation of a loop (parity: 0.1)")
    ] = 0.3
    loss: Annotated[Literal["huber", "cauchy", "none"], Doc("robust loss on loops")] = "huber"
    loss_scale: Annotated[float, Range(0.001, 100), Doc("scale of the robust loss, in units of the residual")] = 0.1
    loss_on: Annotated[
        Literal["weighted", "unweighted"],
        Doc("the loss sees the residual with loop_weight (parity) or without it (seed 000.4)"),
    ] = "weighted"
    period_s: Annotated[
        float, Range(0, 60), Doc("recording time between two optimisations that new loops ask for (Q4: 2)", "s")
    ] = 1.0
    delay_s: Annotated[
        float, Range(0, 10), Doc("recording time after which the result of an optimisation is used", "s")
    ] = 0.5
    max_iterations: Annotated[int, Range(1, 200), Doc("iterations of one optimisation (parity: 5)")] = 10
    function_tolerance: Annotated[float, Range(0, 1e-2), Doc("stop when the cost falls by a smaller share")] = 1e-6
    initial_radius: Annotated[
        float, Range(1, 1e16), Doc("initial trust-region radius; a small one stiffens long chains (parity: 1e4)")
    ] = 1e12


@dataclass(frozen=True)
class Loop:
    """Loop closure: which keyframes are described, retrieved, and what verifies them (REFERENCE 15, 16)."""

    enabled: Annotated[bool, Doc("close loops; needs the vocabulary that a run with loops keeps")] = True
    relocalize: Annotated[
        int, Range(0, 10), Doc("how many accepted loops the window refines at a time (VINS: 1; 0: none)")
    ] = 1
    max_corners: Annotated[int, Range(0, 3000), Doc("FAST corners described beside the tracks (seed 004.24: 500)")] = (
        500
    )
    skip_first: Annotated[int, Range(0, 100), Doc("keyframes left out at the start (parity: 10)")] = 0
    every: Annotated[int, Range(1, 20), Doc("one keyframe of so many is used (seed 000: 3)")] = 1
    min_spacing_m: Annotated[float, Range(0, 10), Doc("motion since the last keyframe used", "m")] = 0.0
    min_gap: Annotated[int, Range(1, 1000), Doc("keyframes that must lie between two that are matched")] = 50
    candidates: Annotated[int, Range(1, 50), Doc("how many keyframes of the highest scores are looked at")] = 4
    order: Annotated[
        Literal["best", "oldest"],
        Doc("candidates are verified from the highest score down, or only the earliest of them is (parity)"),
    ] = "best"
    score: Annotated[
        Literal["relative", "absolute"],
        Doc("scores are judged against the score with the previous keyframe, or as they are (parity)"),
    ] = "relative"
    min_score_ratio: Annotated[
        float, Range(0, 1), Doc("score of a candidate over the score with the previous keyframe, when relative")
    ] = 0.1
    min_score: Annotated[
        float, Range(0, 1), Doc("score of a candidate, when absolute (VINS: 0.015); 0: what the vocabulary says")
    ] = 0.0
    min_neighbour_score: Annotated[
        float, Range(0, 1), Doc("highest score of any keyframe (VINS: 0.05); 0: what the vocabulary says")
    ] = 0.0
    max_hamming: Annotated[int, Range(10, 128), Doc("bits two matched descriptors may differ in (parity: 79)")] = 80
    max_ratio: Annotated[
        float, Range(0.3, 1), Doc("differing bits over those of the best match elsewhere (parity: 1, off)")
    ] = 0.9
    cross_check: Annotated[bool, Doc("a match must be the best from both sides (parity: off)")] = True
    min_matches: Annotated[int, Range(6, 200), Doc("landmarks matched (VINS: 26)")] = 10
    epipolar: Annotated[
        Literal["essential", "fundamental", "off"], Doc("epipolar RANSAC over the matches (VINS: off)")
    ] = "essential"
    epipolar_px: Annotated[
        float, Range(0.5, 20), Doc("largest distance to the epipolar line (seed 000: 5; VINS: 3)", "px460")
    ] = 5.0
    epipolar_confidence: Annotated[float, Range(0.5, 0.9999), Doc("RANSAC confidence (VINS: 0.9)")] = 0.99
    min_epipolar: Annotated[int, Range(6, 200), Doc("matches that agree on one epipolar geometry")] = 8
    pnp_px: Annotated[float, Range(1, 20), Doc("largest reprojection error of an inlier (parity: 10)", "px460")] = 6.0
    guided_px: Annotated[
        float,
        Range(0, 50),
        Doc("landmarks are searched for again this near to where the pose sees them (parity: 0)", "px460"),
    ] = 12.0
    min_inliers: Annotated[int, Range(6, 200), Doc("landmarks that agree with the final pose (VINS: 26)")] = 20
    max_rms_px: Annotated[float, Range(0.5, 20), Doc("rms reprojection error of the inliers (parity: 20)", "px460")] = (
        4.0
    )
    max_sigma_m: Annotated[
        float, Range(0.001, 100), Doc("standard deviation of the relative position (parity: 100)", "m")
    ] = 0.3
    max_tilt_deg: Annotated[
        float,
        Range(0.1, 180),
        Doc("angle between gravity as the earlier keyframe knew it and as the pose says (parity: 180)", "deg"),
    ] = 5.0
    heading: Annotated[
        Literal["gravity", "euler"],
        Doc("heading difference: rotation about gravity, or difference of Euler yaws of the body (parity)"),
    ] = "gravity"
    max_heading_deg: Annotated[float, Range(1, 180), Doc("heading difference (VINS: 30)", "deg")] = 35.0
    max_distance_m: Annotated[float, Range(0.1, 1000), Doc("distance between the keyframes (VINS: 20)", "m")] = 20.0
    consistency: Annotated[
        bool, Doc("a loop must fit what odometry and earlier loops allow, within their covariance (parity: off)")
    ] = True
    drift_inflation: Annotated[
        float,
        Range(1, 50),
        Doc(
            "standard deviations of odometry and loops count so many times, because the estimator claims too little: "
            "3.2 for errors that are common to the ten keyframes of a window, times 2 for rays of anchors, which count "
            "as exact"
        ),
    ] = 6.0
    max_drift: Annotated[
        float, Range(1, 100), Doc("largest correction a loop may ask for, whatever agrees with it", "sigma")
    ] = 6.0
    sure_drift: Annotated[
        float, Range(0, 100), Doc("a loop that asks for a larger correction waits until others agree", "sigma")
    ] = 4.0
    min_agreement: Annotated[
        int, Range(0, 20), Doc("other keyframes that must ask for the same correction, where that is needed")
    ] = 2
    agreement_span: Annotated[int, Range(1, 100), Doc("keyframes back among which they are looked for")] = 5
