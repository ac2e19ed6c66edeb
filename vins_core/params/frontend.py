"""Parameters of the front end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from .declaration import Doc, Range


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
