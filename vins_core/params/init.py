"""Parameters of initialisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from .declaration import Doc, Range


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
