"""Parameters of GPS fusion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from .declaration import Doc, Range


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
