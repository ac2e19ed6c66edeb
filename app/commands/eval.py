from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from .arguments import Json, Run
from .arguments import Trajectory as Choice
from .console import note, print_json

if TYPE_CHECKING:
    import numpy as np

    from vins_core.record.reader import RunReader
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
    from vins_core.record.reader import RunReader

    with RunReader(run) as reader:
        first_image_ns = reader.report(0).images[0].t_ns if len(reader) else None
        found = evaluate(trajectory_of(reader, trajectory), _truth(reader, truth), max_dt, first_image_ns)
        if not found.poses:
            note(f"note: {run} has no poses: it never initialised")
        calibration = _calibration(reader)
    if json:
        print_json(asdict(found) | ({"calibration": calibration} if calibration else {}))
        return
    for key, value in asdict(found).items():
        label, unit = LABELS[key]
        number = "-" if value is None else f"{value:.6g} {unit}".strip()
        print(f"{label:>28}  {number}")
    for label, entry in calibration.items():
        sigma = "" if entry["sigma"] is None else f" (sigma {_numbers(entry['sigma'])})"
        print(f"{label:>28}  {_numbers(entry['value'])} {entry['unit']}{sigma}")


def _calibration(reader: RunReader) -> dict[str, dict[str, Any]]:
    """What the run found of its calibration by its last pose: what is estimated -> value, sigma, unit.

    The sigma is that of the last solve in which it was free.
    """
    import numpy as np

    from vins_core.window.online import moved

    found = [s.calibration for s in reader.summaries if s.calibration]
    if not found:
        return {}
    entries: dict[str, dict[str, Any]] = {}

    def add(name: str, value: np.ndarray, sigmas: list[np.ndarray], unit: str) -> None:
        known = next((s for s in reversed(sigmas) if np.isfinite(s).all()), None)
        sigma = None if known is None else known.tolist()
        entries[name] = {"value": value.tolist(), "sigma": sigma, "unit": unit}

    if found[-1].td_gates:
        add("td", np.array([1e3 * found[-1].td_s]), [np.array([1e3 * c.td_sigma_s]) for c in found], "ms")
    if found[-1].extrinsic_gates:
        for k, camera in enumerate(reader.header.calibration.cameras):
            shift, turn = moved(found[-1].T_b_c[k], camera.T_b_c)
            sigmas = [c.extrinsic_sigma[k] for c in found]
            add(f"{camera.name} moved by", 100 * shift, [100 * s[:3] for s in sigmas], "cm")
            add(f"{camera.name} turned by", np.degrees(turn), [np.degrees(s[3:]) for s in sigmas], "deg")
    return entries


def _numbers(values: list[float]) -> str:
    return " ".join(f"{value:.3f}" for value in values)


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
