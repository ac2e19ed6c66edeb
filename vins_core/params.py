"""Every tunable of the system, declared once: type, default, range, unit, meaning.

Command line, sliders, YAML and documentation derive from these declarations.  A parameter is addressed as
`section.name`.  "px460" is a pixel of a virtual camera of focal length 460, the unit of nearly every threshold of
VINS; "parity" names the value that reproduces the original C++.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, get_args, get_origin

from .errors import ParameterError


@dataclass(frozen=True)
class Range:
    low: float
    high: float


@dataclass(frozen=True)
class Doc:
    text: str
    unit: str = ""


@dataclass(frozen=True)
class Frontend:
    """Corners, optical flow and track rejection (REFERENCE 2, 3)."""

    max_cnt: Annotated[int, Range(20, 1000), Doc("tracks kept per image")] = 150
    min_dist: Annotated[int, Range(5, 100), Doc("smallest distance between two tracks", "px")] = 30
    freq: Annotated[
        float, Range(1, 100), Doc("frames per second given to the estimator; other images are only tracked", "Hz")
    ] = 10.0
    equalize: Annotated[bool, Doc("CLAHE before tracking")] = True
    clahe_clip: Annotated[float, Range(0.5, 10), Doc("CLAHE contrast limit")] = 3.0
    clahe_tiles: Annotated[int, Range(2, 16), Doc("CLAHE tiles per side")] = 8
    corner_quality: Annotated[
        float, Range(0.0001, 0.2), Doc("weakest corner accepted, as a share of the strongest")
    ] = 0.01
    klt_window: Annotated[
        int, Range(7, 41), Doc("KLT window side; what it covers should lie at one depth (parity: 21)", "px")
    ] = 13
    klt_levels: Annotated[int, Range(0, 5), Doc("KLT pyramid levels above the image")] = 3
    klt_iterations: Annotated[int, Range(5, 100), Doc("KLT iterations per level")] = 30
    klt_epsilon: Annotated[float, Range(0.0001, 0.1), Doc("KLT stops when the step is shorter", "px")] = 0.01
    flow_back: Annotated[bool, Doc("track back and compare (parity for VINS-Mono: off)")] = True
    flow_back_px: Annotated[float, Range(0.1, 5), Doc("largest distance after tracking back", "px")] = 0.5
    predict: Annotated[
        Literal["off", "rescue", "always"],
        Doc("start flow where the gyroscope says the tracks went: only when too few are found otherwise, or always"),
    ] = "rescue"
    predict_levels: Annotated[int, Range(0, 5), Doc("KLT pyramid levels above the image with prediction")] = 2
    predict_min_share: Annotated[
        float,
        Range(0, 1),
        Doc("share of tracks to be found; below it prediction (or flow without it) is tried as well"),
    ] = 0.5
    border_px: Annotated[int, Range(0, 50), Doc("tracks nearer to the border are dropped", "px")] = 1
    f_ransac: Annotated[bool, Doc("reject tracks by the epipolar geometry of consecutive frames")] = True
    epipolar_model: Annotated[
        Literal["essential", "fundamental"],
        Doc("essential: 5 points, locally optimised; fundamental: plain RANSAC over 7 points (parity)"),
    ] = "essential"
    F_threshold: Annotated[float, Range(0.1, 10), Doc("F-RANSAC: largest distance to the epipolar line", "px460")] = 1.0
    F_confidence: Annotated[float, Range(0.5, 0.9999), Doc("F-RANSAC confidence")] = 0.99
    min_track_count: Annotated[
        int, Range(1, 10), Doc("images a track must have been seen in before the estimator gets it")
    ] = 2
    max_gap_s: Annotated[float, Range(0.1, 10), Doc("a longer gap between images resets the tracker", "s")] = 1.0
    min_flow_share: Annotated[float, Range(0, 1), Doc("tracks that flow should find again (advisory)")] = 0.7
    min_flow_back_share: Annotated[float, Range(0, 1), Doc("found tracks that flow-back should keep (advisory)")] = 0.8
    min_inlier_share: Annotated[float, Range(0, 1), Doc("tracks that F-RANSAC should keep (advisory)")] = 0.7
    min_tracks: Annotated[int, Range(0, 500), Doc("tracks a frame should have (advisory)")] = 50
    stereo_epipolar_px: Annotated[
        float,
        Range(0.1, 1000),
        Doc("largest distance of a match in the second camera to its epipolar line (parity: 1000)", "px460"),
    ] = 2.0
    min_stereo_share: Annotated[float, Range(0, 1), Doc("tracks the second camera should see as well (advisory)")] = 0.4
    depth_min_patch_share: Annotated[float, Range(0, 1), Doc("share of what flow sees of a track that has a depth")] = (
        0.6
    )
    depth_max_variation: Annotated[
        float,
        Range(0.001, 10),
        Doc(
            "by how much of their median a tenth of those depths may differ; noise of 2 % makes 0.033, edges much more"
        ),
    ] = 0.05
    min_depth_share: Annotated[float, Range(0, 1), Doc("tracks the depth camera should measure (advisory)")] = 0.3


@dataclass(frozen=True)
class Imu:
    """Pre-integration (REFERENCE 6)."""

    acc_n_scale: Annotated[float, Range(0.01, 100), Doc("factor on the calibrated accelerometer noise")] = 1.0
    gyr_n_scale: Annotated[float, Range(0.01, 100), Doc("factor on the calibrated gyroscope noise")] = 1.0
    acc_w_scale: Annotated[float, Range(0.01, 100), Doc("factor on the calibrated accelerometer bias random walk")] = (
        1.0
    )
    gyr_w_scale: Annotated[float, Range(0.01, 100), Doc("factor on the calibrated gyroscope bias random walk")] = 1.0
    repropagate: Annotated[
        bool, Doc("integrate again when the bias has moved further than the limits (parity: off)")
    ] = True
    repropagate_ba: Annotated[float, Range(0.001, 1), Doc("accelerometer bias change that triggers it", "m/s^2")] = 0.1
    repropagate_bg: Annotated[float, Range(0.0001, 0.1), Doc("gyroscope bias change that triggers it", "rad/s")] = 0.01
    gap_s: Annotated[
        float, Range(0.005, 10), Doc("between samples further apart the motion counts as unknown (parity: 10)", "s")
    ] = 0.05
    gap_acc: Annotated[float, Range(0, 50), Doc("deviation of the mean acceleration over such a gap", "m/s^2")] = 2.0
    gap_gyr: Annotated[float, Range(0, 10), Doc("deviation of the mean angular rate over such a gap", "rad/s")] = 0.5
    max_interval_s: Annotated[float, Range(1, 60), Doc("IMU factors over longer intervals are left out", "s")] = 10.0


@dataclass(frozen=True)
class Init:
    """Initialisation (REFERENCE 8; seeds 000.2, 004.11-17)."""

    retry_s: Annotated[float, Range(0, 5), Doc("shortest time between two attempts", "s")] = 0.1
    min_excitation: Annotated[float, Range(0, 5), Doc("standard deviation of delta_v/dt over the frames", "m/s^2")] = (
        0.25
    )
    require_excitation: Annotated[bool, Doc("excitation is a gate (parity: only a message)")] = True
    min_matches: Annotated[
        int, Range(8, 100), Doc("matches between the reference frame and the newest (seed 004.11: 30)")
    ] = 20
    min_parallax_px: Annotated[float, Range(1, 100), Doc("mean parallax between them (seed 004.11: 20)", "px460")] = (
        30.0
    )
    min_translation_px: Annotated[
        float, Range(0, 50), Doc("mean parallax left after the best rotation (parity: 0)", "px460")
    ] = 3.0
    ransac_px: Annotated[
        float, Range(0.05, 5), Doc("relative pose: largest distance to the epipolar line (parity: 0.3)", "px460")
    ] = 1.0
    min_pose_inliers: Annotated[int, Range(5, 100), Doc("relative pose: points in front of both cameras")] = 13
    min_pnp_points: Annotated[int, Range(5, 50), Doc("structure: points needed to place a frame")] = 10
    max_structure_cost: Annotated[
        float, Range(1e-5, 1), Doc("structure: bundle adjustment cost accepted without convergence")
    ] = 5e-3
    min_consistent_share: Annotated[
        float, Range(0, 1), Doc("structure: share of points within window.max_error_px (parity: 0)")
    ] = 0.7
    max_reprojection_px: Annotated[
        float, Range(0.1, 20), Doc("structure: rms reprojection error after bundle adjustment", "px460")
    ] = 2.0
    max_rotation_error_deg: Annotated[
        float, Range(0.01, 180), Doc("rms difference of vision and gyroscope between frames (parity: 180)", "deg")
    ] = 1.0
    gravity_tolerance: Annotated[
        float, Range(0.05, 5), Doc("largest difference of the estimated gravity's norm", "m/s^2")
    ] = 1.0
    gravity_iterations: Annotated[int, Range(1, 10), Doc("refinements of gravity on its tangent plane")] = 4
    refine: Annotated[bool, Doc("visual-inertial bundle adjustment after the alignment (parity: off)")] = True
    acc_bias_sigma: Annotated[
        float,
        Range(0.001, 2),
        Doc("how far from zero the accelerometer bias may be; stays as the first prior of the window", "m/s^2"),
    ] = 0.2
    max_scale_sigma: Annotated[
        float, Range(0.001, 10), Doc("relative standard deviation of the scale after refinement")
    ] = 0.1
    max_imu_misfit: Annotated[
        float, Range(1, 100), Doc("reprojection error after refinement over that of vision alone (100: off)")
    ] = 2.0
    max_imu_error: Annotated[
        float, Range(0.01, 100), Doc("rms IMU residual after refinement, in its standard deviations", "sigma")
    ] = 1.5
    hand_eye_min_pairs: Annotated[
        int, Range(4, 200), Doc("unknown extrinsics: pairs of frames from which the rotation is found (N14)")
    ] = 10
    hand_eye_min_turn_deg_s: Annotated[
        float, Range(0, 100), Doc("rms rate of turning about the second strongest axis (parity: 0)", "deg/s")
    ] = 1.0
    hand_eye_min_singular: Annotated[
        float, Range(0, 10), Doc("second smallest singular value of the stacked quaternions (parity: 0.25)")
    ] = 0.05
    hand_eye_max_sigma_deg: Annotated[
        float, Range(0.01, 180), Doc("standard deviation of the rotation about its worst axis (parity: 180)", "deg")
    ] = 0.3
    hand_eye_max_misfit: Annotated[
        float, Range(0.1, 1000), Doc("rms by which camera and gyroscope still turn apart (parity: 1000)", "sigma")
    ] = 2.0
    hand_eye_min_agreement: Annotated[
        float, Range(0, 1), Doc("share of the pairs that agree with the rotation (parity: 0)")
    ] = 0.8
    hand_eye_max_halves_deg: Annotated[
        float, Range(0.1, 180), Doc("angle between what earlier and later pairs say (parity: 180)", "deg")
    ] = 2.0
    hand_eye_max_td_ms: Annotated[
        float, Range(0.1, 1000), Doc("time offset found beside the one of the calibration (advisory)", "ms")
    ] = 10.0
    hand_eye_pair_sigma_deg: Annotated[
        float, Range(0.001, 5), Doc("smallest standard deviation of a rotation between two images", "deg")
    ] = 0.02
    hand_eye_td_sigma_s: Annotated[
        float, Range(0, 1), Doc("how far the time offset may be from the calibration's (parity: 0)", "s")
    ] = 0.02


@dataclass(frozen=True)
class Window:
    """Keyframes, sliding window and its solve (REFERENCE 7, 9)."""

    size: Annotated[int, Range(4, 20), Doc("keyframes in the window beside the newest frame")] = 10
    max_iterations: Annotated[int, Range(1, 100), Doc("solver iterations per frame")] = 8
    keyframe_parallax: Annotated[
        float, Range(0, 100), Doc("a frame with more mean parallax is a keyframe", "px460")
    ] = 10.0
    compensate_rotation: Annotated[bool, Doc("remove the gyroscope's rotation from the parallax (parity: off)")] = True
    keyframe_min_tracked: Annotated[int, Range(0, 200), Doc("a frame that keeps fewer tracks is a keyframe")] = 20
    min_observations: Annotated[int, Range(2, 10), Doc("observations a landmark needs to enter the solve")] = 2
    min_depth: Annotated[
        float, Range(0.001, 2), Doc("triangulated depths below it are replaced by init_depth", "m")
    ] = 0.1
    init_depth: Annotated[float, Range(0.5, 100), Doc("depth given to a landmark that cannot be triangulated", "m")] = (
        5.0
    )
    pixel_sigma: Annotated[float, Range(0.1, 10), Doc("standard deviation of an observation", "px460")] = 1.5
    loss: Annotated[Literal["cauchy", "huber", "none"], Doc("robust loss on projections")] = "cauchy"
    loss_scale: Annotated[float, Range(0.1, 10), Doc("scale of the robust loss", "sigma")] = 1.0
    reject_outliers: Annotated[
        bool, Doc("drop landmarks after the solve by mean reprojection error (parity for VINS-Mono: off)")
    ] = True
    max_error_px: Annotated[float, Range(0.5, 30), Doc("largest mean reprojection error of a landmark", "px460")] = 3.0


@dataclass(frozen=True)
class Depth:
    """Landmarks from a depth camera (seed 000.3.2, docs/depth.md).  How it is read at a track: section frontend."""

    variant: Annotated[
        Literal["trust", "confirm", "hold"],
        Doc(
            "trust: the first depth is the landmark's; confirm: the mean of two frames that agree; hold: the mean of "
            "several that agree, no longer optimised"
        ),
    ] = "trust"
    sigma: Annotated[float, Range(0.0005, 0.5), Doc("standard deviation of a depth, as a share of it")] = 0.02
    frames: Annotated[int, Range(2, 10), Doc("frames that must agree, with hold")] = 3
    max_disagreement: Annotated[
        float,
        Range(0.5, 100),
        Doc("distance between the points that frames give a landmark, with confirm and hold", "sigma"),
    ] = 3.0
    max_chi2: Annotated[
        float,
        Range(1, 1e9),
        Doc("squared difference of measured and estimated depth over sigma squared; above, a depth counts no more"),
    ] = 16.0


@dataclass(frozen=True)
class Projection:
    """The visual residual (SPEC 5.2)."""

    residual: Annotated[
        Literal["plane", "sphere"], Doc("normalised plane, or tangent plane of the unit sphere (seed 000.3.3.3)")
    ] = "plane"


@dataclass(frozen=True)
class Online:
    """Calibration while running: time offset, rolling shutter, extrinsics (REFERENCE O5-O8)."""

    td: Annotated[
        Literal["auto", "on", "off"],
        Doc("estimate the time offset between camera and IMU; auto: when the calibration asks for it"),
    ] = "auto"
    extrinsics: Annotated[
        Literal["auto", "on", "off"],
        Doc("estimate where the cameras are on the body; auto: when the calibration does not call them fixed"),
    ] = "auto"
    rolling_shutter: Annotated[
        bool, Doc("mind that rows are read one after another, where the calibration says so (parity: only with td)")
    ] = True
    td_sigma_s: Annotated[
        float, Range(1e-4, 1), Doc("standard deviation of the given time offset (parity: none is assumed)", "s")
    ] = 0.05
    rotation_sigma_deg: Annotated[
        float, Range(0.01, 90), Doc("standard deviation of the given rotation of a camera, per axis", "deg")
    ] = 2.0
    translation_sigma_m: Annotated[
        float, Range(1e-4, 10), Doc("standard deviation of the given position of a camera, per axis", "m")
    ] = 0.05
    unknown_sigma_m: Annotated[
        float, Range(1e-4, 10), Doc("the same where no position is given and the search begins at zero", "m")
    ] = 0.3
    min_speed: Annotated[
        float, Range(0, 10), Doc("calibration is held while the oldest frame of the window is slower", "m/s")
    ] = 0.2


@dataclass(frozen=True)
class Solver:
    """Trust-region methods on the Schur complement (REFERENCE O1)."""

    method: Annotated[Literal["lm", "dogleg"], Doc("Levenberg-Marquardt, or Powell's dogleg (parity)")] = "lm"
    damping: Annotated[
        Literal["ours", "ceres"],
        Doc(
            "ours: starts from initial_radius and dogleg_min_mu, position and yaw of the oldest frame are held; "
            "ceres: starts from radius 1e4 and mu 1e-8, nothing is held (parity)"
        ),
    ] = "ours"
    initial_radius: Annotated[float, Range(1e-2, 1e16), Doc("initial trust-region radius, with our damping")] = 1e12
    dogleg_min_mu: Annotated[
        float, Range(1e-16, 1), Doc("smallest damping of dogleg's Gauss-Newton step, with our damping")
    ] = 1e-12
    curved_below: Annotated[
        float,
        Range(0, 1),
        Doc(
            "with our damping, the robust loss may bend the Hessian once a step is expected to lower the cost by a "
            "smaller share (parity: 0)"
        ),
    ] = 0.01
    max_radius: Annotated[float, Range(1e2, 1e32), Doc("largest trust-region radius")] = 1e16
    function_tolerance: Annotated[float, Range(0, 1e-2), Doc("stop when the cost falls by a smaller share")] = 1e-6
    min_gain_ratio: Annotated[float, Range(0, 0.5), Doc("steps with a smaller gain ratio are rejected")] = 1e-3


@dataclass(frozen=True)
class Marginalization:
    """The prior left by what leaves the window (REFERENCE 10)."""

    eigen_threshold: Annotated[float, Range(0, 1), Doc("eigenvalues of the information below it count as zero")] = 1e-8
    first_estimates: Annotated[
        bool,
        Doc("linearise what leaves where the prior was first linearised, which keeps yaw out of the prior"),
    ] = False


@dataclass(frozen=True)
class Health:
    """Failure detection F1-F6 (REFERENCE 11)."""

    min_tracked: Annotated[int, Range(0, 50), Doc("tracks shared with the previous frame (F1, advisory)")] = 2
    max_acc_bias: Annotated[float, Range(0.1, 20), Doc("accelerometer bias norm (F2)", "m/s^2")] = 2.5
    max_gyr_bias: Annotated[float, Range(0.01, 5), Doc("gyroscope bias norm (F3)", "rad/s")] = 1.0
    max_jump_m: Annotated[float, Range(0.1, 100), Doc("translation between frames (F4)", "m")] = 5.0
    max_z_jump_m: Annotated[float, Range(0.1, 100), Doc("vertical translation between frames (F5)", "m")] = 1.0
    max_rotation_deg: Annotated[float, Range(1, 180), Doc("rotation between frames (F6, advisory)", "deg")] = 50.0
    min_window_parallax: Annotated[
        float, Range(0, 50), Doc("parallax over the window without its rotation (advisory)", "px460")
    ] = 3.0
    still_rotation_deg: Annotated[
        float, Range(0.1, 90), Doc("rotation over the window that tells turning from standing still", "deg")
    ] = 3.0


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


@dataclass(frozen=True)
class Gps:
    """Fusion of odometry with GPS fixes (SPEC 8.2, REFERENCE 19).

    "Per sqrt(m)" is what a random walk adds over each metre of path.  The preset `parity` is in fusion/presets.py.
    """

    enabled: Annotated[bool, Doc("hold the odometry to the fixes of the recording, where it has any")] = True
    dof: Annotated[
        Literal["4", "6"],
        Doc(
            "what drifts: position and heading, gravity being known; or roll and pitch too (parity; always without IMU)"
        ),
    ] = "4"
    min_status: Annotated[
        int, Range(-1, 2), Doc("NavSatStatus of a fix: -1 none, 0 fix, 1 satellite, 2 ground augmented (parity: -1)")
    ] = 0
    min_sigma_m: Annotated[
        float, Range(1e-4, 10), Doc("horizontal standard deviation a receiver may claim (parity: 0.0001)", "m")
    ] = 0.005
    max_sigma_m: Annotated[
        float, Range(0.1, 1000), Doc("horizontal standard deviation of a fix that still counts (parity: 1000)", "m")
    ] = 10.0
    assumed_sigma_m: Annotated[
        float, Range(0, 100), Doc("standard deviation of fixes that come without one; 0: not used (parity: 1)", "m")
    ] = 0.0
    sigma_scale: Annotated[float, Range(0.01, 100), Doc("factor on the standard deviation of all fixes")] = 1.0
    covariance: Annotated[
        Literal["variance", "sigma"],
        Doc("fixes carry a covariance, or its first entry is taken for a standard deviation of all axes (parity)"),
    ] = "variance"
    max_age_s: Annotated[float, Range(0, 10), Doc("fixes that arrive later than so long ago are dropped", "s")] = 1.0
    max_gap_s: Annotated[
        float, Range(0.01, 10), Doc("time between the two frames on whose way a fix was taken", "s")
    ] = 0.5
    max_chi2: Annotated[
        float,
        Range(1, 1e9),
        Doc("squared innovation of a fix over its covariance; 16.3 keeps 99.9 % of good ones (parity: 1e9)"),
    ] = 16.27
    min_fixes: Annotated[int, Range(3, 50), Doc("consistent fixes from which the alignment may be taken")] = 6
    max_yaw_sigma_deg: Annotated[
        float,
        Range(0.01, 180),
        Doc("standard deviation of the alignment's yaw from which fixes count at once (parity: 180)", "deg"),
    ] = 0.4
    full_yaw_sigma_deg: Annotated[
        float, Range(0.01, 180), Doc("the same once the window is full of fixes, for slow bodies", "deg")
    ] = 2.0
    min_used_share: Annotated[
        float,
        Range(0, 1),
        Doc("share of the window's fixes that agree; below it the alignment is made anew (parity: 0)"),
    ] = 0.3
    max_outage_s: Annotated[float, Range(0.1, 1e4), Doc("time since the last fix that counted (advisory)", "s")] = 3.0
    window: Annotated[int, Range(5, 500), Doc("moments with fixes whose poses and verdicts are still open")] = 40
    lever_arm: Annotated[
        bool, Doc("mind where the antenna is on the body, p_b_gps of the calibration; off: at its origin (parity: off)")
    ] = True
    noise: Annotated[
        Literal["path", "frame"],
        Doc("the odometry's error grows with the path, or by the same amount every frame, whatever the rate (parity)"),
    ] = "path"
    position_walk: Annotated[float, Range(1e-4, 10), Doc("position error of the odometry", "m per sqrt(m)")] = 0.04
    yaw_walk_deg: Annotated[float, Range(1e-4, 10), Doc("heading error of the odometry", "deg per sqrt(m)")] = 0.04
    tilt_walk_deg: Annotated[
        float, Range(1e-4, 10), Doc("roll and pitch error of the odometry, with 6 DoF", "deg per sqrt(m)")
    ] = 0.05
    tilt_sigma_deg: Annotated[
        float, Range(0.01, 90), Doc("inclination of the odometry's world at the start, with 6 DoF", "deg")
    ] = 5.0
    scale_sigma: Annotated[float, Range(0, 0.5), Doc("relative error of the odometry's scale (parity: 0)")] = 0.012
    scale_length_m: Annotated[float, Range(1, 1e5), Doc("path over which the scale's error changes", "m")] = 300.0
    frame_sigma_m: Annotated[float, Range(1e-4, 10), Doc("position error a frame, when noise is by frame", "m")] = 0.1
    frame_sigma_deg: Annotated[float, Range(1e-4, 90), Doc("rotation error a frame, when noise is by frame", "deg")] = (
        0.573
    )
    loss: Annotated[
        Literal["none", "huber", "cauchy"], Doc("robust loss on fixes that passed the gates (parity: huber)")
    ] = "none"
    loss_scale: Annotated[float, Range(0.1, 10), Doc("scale of the robust loss", "sigma")] = 1.0
    max_iterations: Annotated[int, Range(1, 50), Doc("solver iterations")] = 10


@dataclass(frozen=True)
class Params:
    frontend: Frontend = field(default_factory=Frontend)
    imu: Imu = field(default_factory=Imu)
    init: Init = field(default_factory=Init)
    window: Window = field(default_factory=Window)
    depth: Depth = field(default_factory=Depth)
    projection: Projection = field(default_factory=Projection)
    online: Online = field(default_factory=Online)
    solver: Solver = field(default_factory=Solver)
    marginalization: Marginalization = field(default_factory=Marginalization)
    health: Health = field(default_factory=Health)
    loop: Loop = field(default_factory=Loop)
    pose_graph: PoseGraph = field(default_factory=PoseGraph)
    gps: Gps = field(default_factory=Gps)


@dataclass(frozen=True)
class Declaration:
    """One parameter as declared: what a slider, a command line flag or a table row needs."""

    key: str  # "section.name"
    type: type
    default: Any
    choices: tuple[str, ...]  # for Literal types
    low: float | None
    high: float | None
    unit: str
    doc: str


def declarations() -> Iterator[Declaration]:
    """Every parameter, in the order of this file."""
    for section in dataclasses.fields(Params):
        cls = typing.get_type_hints(Params)[section.name]
        hints = typing.get_type_hints(cls, include_extras=True)
        for f in dataclasses.fields(cls):
            base, *notes = get_args(hints[f.name])
            choices = get_args(base) if get_origin(base) is Literal else ()
            span = next((n for n in notes if isinstance(n, Range)), None)
            doc = next(n for n in notes if isinstance(n, Doc))
            yield Declaration(
                f"{section.name}.{f.name}",
                str if choices else base,
                f.default,
                choices,
                span.low if span else None,
                span.high if span else None,
                doc.unit,
                doc.text,
            )


DECLARATIONS: Mapping[str, Declaration] = types.MappingProxyType({d.key: d for d in declarations()})


def get(params: Params, key: str) -> Any:
    section, name = _declaration(key).key.split(".")
    return getattr(getattr(params, section), name)


def replace(params: Params, changes: Mapping[str, Any]) -> Params:
    """`params` with `section.name -> value` changed; values may be text.  Raises ParameterError."""
    for key, value in changes.items():
        declared = _declaration(key)
        section, name = declared.key.split(".")
        stage = dataclasses.replace(getattr(params, section), **{name: _coerce(declared, value)})
        params = dataclasses.replace(params, **{section: stage})
    return params


def changed(params: Params, reference: Params | None = None) -> dict[str, Any]:
    """The parameters that differ from `reference` (the defaults), `section.name -> value`."""
    reference = reference or Params()
    return {k: get(params, k) for k in DECLARATIONS if get(params, k) != get(reference, k)}


def parse_assignment(text: str) -> tuple[str, str]:
    """`section.name=value` -> (key, value)."""
    key, sep, value = text.partition("=")
    if not sep or not value.strip():
        raise ParameterError(
            f"--set {text!r} is not of the form section.name=value, e.g. --set window.max_iterations=8"
        )
    return key.strip(), value.strip()


def _declaration(key: str) -> Declaration:
    if key in DECLARATIONS:
        return DECLARATIONS[key]
    import difflib

    near = difflib.get_close_matches(key, DECLARATIONS, n=3, cutoff=0.5)
    near += [k for k in DECLARATIONS if k.split(".")[1] == key and k not in near]
    hint = f"did you mean {' or '.join(near)}?" if near else "`vinspect run --help` lists all parameters"
    raise ParameterError(f"unknown parameter {key!r}; {hint}")


def _coerce(declared: Declaration, value: Any) -> Any:
    expected = f"one of {', '.join(declared.choices)}" if declared.choices else declared.type.__name__
    if declared.low is not None:
        expected += f" from {declared.low:g} to {declared.high:g}"
    problem = ParameterError(
        f"parameter {declared.key}={value!r}: expected {expected}{' ' + declared.unit if declared.unit else ''}"
    )
    if declared.type is bool:
        if isinstance(value, bool):
            return value
        word = str(value).strip().lower()
        if word in ("1", "true", "yes", "on"):
            return True
        if word in ("0", "false", "no", "off"):
            return False
        raise problem
    if declared.choices:
        if value not in declared.choices:
            raise problem
        return value
    try:
        number = declared.type(value)
        if declared.type is int and float(value) != number:
            raise problem
    except (TypeError, ValueError, OverflowError):
        raise problem from None
    if not (declared.low is None or declared.high is None or declared.low <= number <= declared.high):
        raise problem
    return number
