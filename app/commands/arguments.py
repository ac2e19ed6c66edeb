"""Arguments that several commands share, and the parameters that `--set` takes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from vins_core.params import DECLARATIONS, Declaration

Recording = Positional[
    Annotated[Path, arg(metavar="RECORDING", help="ROS 1 .bag, ROS 2 bag (folder, .db3, .mcap), EuRoC or KITTI folder")]
]
Run = Positional[Annotated[Path, arg(metavar="RUN", help="folder written by `vinspect run`")]]
Calibrations = Annotated[
    UseAppendAction[tuple[Path, ...]],
    arg(
        metavar="FILE",
        help="calibration: VINS, OpenVINS, Kalibr (two files), EuRoC or vinspect YAML; EuRoC and KITTI bring their own",
    ),
]
Json = Annotated[bool, arg(help="print JSON")]
Format = Annotated[Literal["asl", "ros1", "ros2", "mcap"], arg(help="EuRoC folder, .bag, sqlite3 bag or mcap bag")]


def describe(declared: Declaration) -> str:
    """A parameter on one line: `window.size = 10 (4 to 20): keyframes in the window beside the newest frame`."""
    span = " | ".join(declared.choices)
    if declared.low is not None:
        span = f"{declared.low:g} to {declared.high:g}{' ' + declared.unit if declared.unit else ''}"
    default = str(declared.default).lower() if declared.type is bool else declared.default
    return f"{declared.key} = {default}{f' ({span})' if span else ''}: {declared.doc}"


Settings = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        name="set",
        metavar="SECTION.NAME=VALUE",
        help="a parameter, winning over the calibration file's; with their defaults these are:\n"
        + "\n".join(describe(d) for d in DECLARATIONS.values())
        + "\n",
    ),
]
BackendWish = Annotated[
    Literal["auto", "numpy", "c"],
    arg(
        name="backend",
        help="what evaluates the factors; every choice gives the same bits. auto: compiled C when it is ready, else "
        "NumPy (while C is compiled in the background for the next run); a fork takes what its run took. "
        "VINSPECT_BACKEND decides what auto leaves open",
    ),
]
ParamsFile = Annotated[
    Path | None,
    arg(
        name="params",
        metavar="FILE",
        help="YAML of changed parameters (section: {name: value}), winning over the calibration file's; --set wins",
    ),
]
Loops = Annotated[Literal["on", "off"] | None, arg(help="close loops; on by default, like --set loop.enabled=...")]
ModeWish = Annotated[
    Literal["mono_imu", "stereo_imu", "stereo", "rgbd_imu"] | None,
    arg(help="which sensors to use; by default most of what recording and calibration offer (`vinspect info` lists)"),
]
Trajectory = Annotated[
    Literal["odometry", "optimized", "imu_rate", "global", "global_live"],
    arg(
        help="every frame as the odometry had it; the keyframes with all loops closed; the body at every IMU sample as "
        "it was known then, loops included; with GPS, in metres east, north and up of the first fix: all frames held "
        "to all fixes, or each as it was at its own time"
    ),
]
