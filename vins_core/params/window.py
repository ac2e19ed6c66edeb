"""Parameters of the sliding window: what is estimated, how it is solved, what leaves, when it has failed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from .declaration import Doc, Range


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
