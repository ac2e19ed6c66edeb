"""Calibration found while running, over simulated scenarios: `python tests/benchmarks/online_calibration.py`.

Time offset, rolling shutter and rough extrinsics, each over seeds and beside a twin that has nothing to find.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from vins_core.evaluation.evaluate import evaluate, run_trajectory
from vins_core.io.own_yaml import write
from vins_core.io.write import write_recording
from vins_core.record.reader import RunReader
from vins_core.runner import run_recording
from vins_core.simulation.scenarios import SCENARIOS
from vins_core.simulation.simulate import Simulation, build
from vins_core.window.online import moved


def run(folder: Path, scenario: str, seed: int, duration_s: float, settings: tuple[str, ...] = (), **changes):
    """A simulated scenario with some of its fields changed, and its run."""
    simulation = build(scenario, replace(SCENARIOS[scenario], **changes), seed, duration_s)
    write_recording(simulation.messages(), folder / "recording", "asl", settings=simulation.settings)
    write(folder / "calibration.yaml", simulation.calibration, simulation.settings.overrides)
    settings = ("loop.enabled=off", *settings)
    run_recording(folder / "recording", [folder / "calibration.yaml"], out=folder / "run", settings=settings)
    return simulation, RunReader(folder / "run")


def ate_m(simulation: Simulation, reader: RunReader) -> float:
    found = evaluate(run_trajectory(reader.summaries), simulation.truth, 0.006)
    assert found.ate_rmse_m is not None
    return found.ate_rmse_m


def errors(simulation: Simulation, reader: RunReader) -> str:
    """Of the calibration at the end."""
    known = [s.calibration for s in reader.summaries if s.calibration]
    if not known:
        return ""
    last, parts = known[-1], []
    if last.td_gates:
        error_s = last.td_s - simulation.true_calibration.td_s
        parts.append(f"td {1e3 * error_s:+.2f} ms (sigma {1e3 * last.td_sigma_s:.2f})")
    if last.extrinsic_gates:
        for camera, T_b_c, sigma in zip(simulation.true_calibration.cameras, last.T_b_c, last.extrinsic_sigma):
            shift, turn = moved(T_b_c, camera.T_b_c)
            cm, deg = 100 * np.linalg.norm(shift), np.degrees(np.linalg.norm(turn))
            sigma_cm, sigma_deg = 100 * sigma[:3].max(), np.degrees(sigma[3:].max())
            parts.append(f"{camera.name} {cm:.2f} cm (sigma {sigma_cm:.2f}) {deg:.3f} deg (sigma {sigma_deg:.3f})")
    return ", ".join(parts)


CASES = (
    ("room_loop", (), {}),
    ("td_20ms", (), {}),
    ("td_20ms", ("online.td=off",), {}),
    ("rolling_shutter_20ms", (), {}),
    ("rolling_shutter_20ms", ("online.rolling_shutter=off",), {}),
    ("rough_extrinsics", (), {}),
    ("rough_extrinsics", ("online.extrinsics=off",), {}),
    ("rough_extrinsics", (), {"td_s": 0.02, "estimate_td": True}),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=15.0)
    parser.add_argument("--only", help="a scenario")
    args = parser.parse_args()
    for scenario, settings, changes in CASES:
        if args.only and scenario != args.only:
            continue
        print(scenario, *settings, *(f"{k}={v}" for k, v in changes.items()), flush=True)
        found = []
        for seed in range(1, args.seeds + 1):
            with tempfile.TemporaryDirectory() as folder:
                simulation, reader = run(Path(folder), scenario, seed, args.duration, settings, **changes)
                found.append(ate_m(simulation, reader))
                print(f"  seed {seed}: ATE {found[-1]:.4f} m  {errors(simulation, reader)}", flush=True)
        print(f"  median ATE {np.median(found):.4f} m", flush=True)


if __name__ == "__main__":
    main()
