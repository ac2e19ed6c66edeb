"""What each difference from VINS-Mono contributes to accuracy, as a table in Markdown (docs/accuracy.md):

    python tests/benchmarks/ablation.py RECORDING[,CALIBRATION] ... [--variants N] [--only LABEL ...]

Each row sets some of docs/parity.yaml back to what VINS does and leaves the rest as it is.  Per recording: median and
worst ATE in mm over the variants of accuracy.py, and how many times ours the ATE is, as the geometric mean over pairs
of the same variant.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from accuracy import VARIANTS, run

from vins_core.io.params_yaml import read_params

PARITY = read_params(Path(__file__).parents[2] / "docs" / "parity.yaml")

ROWS: dict[str, tuple[str, ...]] = {
    "ours": (),
    "KLT window of 21 px": ("frontend.klt_window",),
    "no flow back": ("frontend.flow_back",),
    "no prediction of flow": ("frontend.predict",),
    "fundamental matrix": ("frontend.epipolar_model",),
    "initialisation of VINS": tuple(key for key in PARITY if key.startswith("init.")),
    "no second integration": ("imu.repropagate", "imu.gap_s"),
    "parallax with rotation": ("window.compensate_rotation",),
    "landmarks never rejected": ("window.reject_outliers",),
    "damping of Ceres": ("solver.damping",),
    "dogleg": ("solver.method",),
    "dogleg of Ceres": ("solver.method", "solver.damping"),
    "all of VINS": tuple(PARITY),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", metavar="RECORDING[,CALIBRATION]")
    parser.add_argument("--variants", type=int, help="only the first N")
    parser.add_argument("--only", nargs="+", choices=[label for label in ROWS if label != "ours"])
    parser.add_argument("--duration", type=float)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    recordings = [[Path(part) for part in text.split(",")] for text in args.recordings]
    variants = VARIANTS[: args.variants]
    rows = {label: keys for label, keys in ROWS.items() if not args.only or label in ("ours", *args.only)}
    with ProcessPoolExecutor(args.jobs) as pool:

        def runs(keys: tuple[str, ...]) -> list[list]:
            back = {key: PARITY[key] for key in keys}
            return [
                [pool.submit(run, path, calib, {**back, **changes}, s, args.duration) for _, changes, s in variants]
                for path, *calib in recordings
            ]

        jobs = {label: runs(keys) for label, keys in rows.items()}
        print("| | " + " | ".join(path.stem for path, *_ in recordings) + " |\n|---|" + "---|" * len(recordings))
        ours: list[np.ndarray] = []
        for label, per_recording in jobs.items():
            ates = [np.array([job.result().get("ate_rmse_m", np.inf) for job in of_one]) for of_one in per_recording]
            ours = ours or ates
            print(f"| {label} | " + " | ".join(map(_cell, ates, ours)) + " |", flush=True)


def _cell(ate_m: np.ndarray, ours_m: np.ndarray) -> str:
    ratio = np.exp(np.mean(np.log(ate_m / ours_m)))
    return f"{1e3 * np.median(ate_m):.1f} / {1e3 * ate_m.max():.1f}, x {ratio:.2f}"


if __name__ == "__main__":
    main()
