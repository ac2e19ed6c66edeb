"""What other lenses cost: `python tests/benchmarks/lenses.py [--seeds N] [--set section.name=value] [--only NAME ...]`.

The same motion in the same room with the same noise through a lens of every model: ATE beside that of the pinhole
camera, as a table in Markdown (docs/accuracy.md).
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from accuracy import run

from vins_core.io.write import write_recording
from vins_core.simulation.simulate import simulate

PINHOLE = "room_loop"
LENSES = ("kb190_camera", "mei_camera", "scaramuzza_camera", "rational_camera")


def ate_m(folder: Path, scenario: str, seed: int, duration_s: float, changes: dict[str, str]) -> float:
    """Of one run over a recording that is rendered for it."""
    simulation = simulate(scenario, seed, duration_s)
    write_recording(simulation.messages(), folder, "asl", settings=simulation.settings)
    settings = {**simulation.settings.overrides, **changes}
    return float(run(folder, [], "mono_imu", settings, 0.0, None).get("ate_rmse_m", np.inf))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=15.0)
    parser.add_argument("--set", action="append", default=[], metavar="section.name=value")
    parser.add_argument("--only", nargs="+", choices=LENSES, default=LENSES)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    changes = dict(item.split("=", 1) for item in args.set)
    seeds = range(1, args.seeds + 1)
    print("| | " + " | ".join(f"seed {seed}" for seed in seeds) + " | median | over the pinhole's |")
    print("|---|" + "---|" * (len(seeds) + 2))
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(args.jobs) as pool:
        jobs = {
            name: [
                pool.submit(ate_m, Path(folder) / f"{name}_{seed}", name, seed, args.duration, changes)
                for seed in seeds
            ]
            for name in (PINHOLE, *args.only)
        }
        pinhole = np.inf
        for name, of_one in jobs.items():
            mm = 1e3 * np.array([job.result() for job in of_one])
            pinhole = float(np.median(mm)) if name == PINHOLE else pinhole
            cells = [*(f"{v:.1f}" for v in mm), f"{np.median(mm):.1f}", f"{np.median(mm) / pinhole:.2f}"]
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
