from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from .arguments import Json, Run
from .arguments import Trajectory as Choice
from .console import note, print_json

if TYPE_CHECKING:
    from vins_core.record.recording import RunReader
    from vins_core.sensors import Trajectory

LABELS = {
    "poses": ("poses", ""),
    "pairs": ("poses with truth", ""),
    "ate_rmse_m": ("ATE rmse", "m"),
    "ate_max_m": ("ATE max", "m"),
    "rotation_rmse_deg": ("rotation rmse", "deg"),
    "scale": ("scale", ""),
    "rpe_rmse_m": ("RPE over 1 m, rmse", "m"),
    "first_pose_s": ("first pose after first image", "s"),
}


def evaluate(
    run: Run,
    /,
    truth: Annotated[Path | None, arg(metavar="FILE", help="EuRoC csv or TUM; by default the recording's own")] = None,
    max_dt: Annotated[float, arg(metavar="S", help="a pose and its truth are at most this far apart")] = 0.006,
    trajectory: Choice = "odometry",
    json: Json = False,
) -> None:
    """Compare a run with ground truth, in evo's numbers."""
    from dataclasses import asdict

    from vins_core.evaluation.evaluate import evaluate
    from vins_core.record.recording import RunReader

    with RunReader(run) as reader:
        first_image_ns = reader.report(0).images[0].t_ns if len(reader) else None
        found = evaluate(trajectory_of(reader, trajectory), _truth(reader, truth), max_dt, first_image_ns)
        if not found.poses:
            note(f"note: {run} has no poses: it never initialised")
    if json:
        print_json(asdict(found))
        return
    for key, value in asdict(found).items():
        label, unit = LABELS[key]
        number = "-" if value is None else f"{value:.6g} {unit}".strip()
        print(f"{label:>28}  {number}")


def trajectory_of(reader: RunReader, choice: Choice) -> Trajectory:
    """The poses that are asked for."""
    from vins_core.evaluation.evaluate import run_trajectory
    from vins_core.fusion.conclusion import global_trajectory
    from vins_core.mapping.conclusion import optimized_trajectory
    from vins_core.record.imu_rate import imu_rate_trajectory

    match choice:
        case "imu_rate":
            return imu_rate_trajectory(reader)
        case "optimized":
            return optimized_trajectory(reader)
        case "global" | "global_live":
            return global_trajectory(reader, live=choice == "global_live")
        case _:
            return run_trajectory(reader.summaries)


def _truth(reader: RunReader, file: Path | None) -> Trajectory:
    from vins_core.errors import RunError
    from vins_core.io.trajectory import read_trajectory

    if file is not None:
        return read_trajectory(file)
    if reader.truth is None:
        raise RunError(f"{reader.path}: its recording has no ground truth; give one with --truth FILE")
    return reader.truth
