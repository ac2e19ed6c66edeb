"""The three depth variants against mono: `python tests/benchmarks/depth.py [--seeds 5] [--set section.name=value]`.

The scenario depth_camera, one recording per seed, each run with mono+IMU and with mode rgbd_imu in every variant.  All
are judged over the same 5 s, those after mono's first pose: ATE after an SE(3) alignment, and by how much the scale of
a Sim(3) alignment is off.  Prints the table of docs/depth.md.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from vins_core import params as parameters
from vins_core import pipeline
from vins_core.evaluation.evaluate import Evaluation, evaluate, run_trajectory
from vins_core.io import modes
from vins_core.io.recording import open_recording
from vins_core.io.sync import packets
from vins_core.io.write import write_recording
from vins_core.process import prepare
from vins_core.report import summarize
from vins_core.sensors import Trajectory
from vins_core.simulation.simulate import Simulation, simulate
from vins_core.state import start

SPAN_S = 5.0
DURATION_S = 9.0  # mono's first pose comes within 3 s
VARIANTS = ("mono", "trust", "confirm", "hold")


def estimate(simulation: Simulation, recording: Path, variant: str, changes: dict[str, str]) -> tuple[Trajectory, int]:
    """The poses of one run, and how often it restarted."""
    mode: modes.Mode = "mono_imu" if variant == "mono" else "rgbd_imu"
    calibration, _ = modes.prepare(simulation.calibration, mode)
    params = parameters.replace(parameters.Params(), {**simulation.settings.overrides, **changes})
    if variant != "mono":
        params = parameters.replace(params, {"depth.variant": variant})
    state, summaries = start(calibration), []
    with open_recording(recording, calibration) as source:
        for packet in packets(source, calibration, params):
            state, report, ms = pipeline.step(params, calibration, source, state, packet)
            summaries.append(summarize(report, ms))
    return run_trajectory(summaries), sum(bool(s.health) for s in summaries)


def judge(estimated: Trajectory, truth: Trajectory, start_ns: int) -> Evaluation:
    """Over the span that begins at `start_ns`."""
    rows = (estimated.t_ns >= start_ns) & (estimated.t_ns <= start_ns + round(SPAN_S * 1e9))
    part = Trajectory(estimated.t_ns[rows], estimated.p_w_b[rows], estimated.q_w_b[rows])
    return evaluate(part, truth, max_dt_s=0.006)


def compare(
    seeds: Iterable[int], folder: Path, changes: dict[str, str] | None = None, variants: Sequence[str] = VARIANTS
) -> dict[str, list[tuple[float, float, float]]]:
    """Per variant and seed: ATE in mm, scale error in %, first pose in s.  Recordings in `folder` are made once."""
    rows: dict[str, list[tuple[float, float, float]]] = {variant: [] for variant in variants}
    for seed in seeds:
        simulation, recording = simulate("depth_camera", seed, DURATION_S), folder / f"depth_{seed}"
        if not recording.exists():
            write_recording(simulation.messages(), recording, "asl", settings=simulation.settings)
        start_ns = 0
        for variant in variants:
            estimated, restarts = estimate(simulation, recording, variant, changes or {})
            first_s = (int(estimated.t_ns[0]) - int(simulation.image_t_ns[0])) * 1e-9
            start_ns = start_ns or int(estimated.t_ns[0])
            result = judge(estimated, simulation.truth, start_ns)
            ate_mm, scale = 1e3 * result.ate_rmse_m, 100 * (result.scale - 1)
            rows[variant].append((ate_mm, scale, first_s))
            print(
                f"seed {seed} {variant:8s} ATE {ate_mm:6.2f} mm  scale {scale:+5.2f} %  first pose {first_s:4.2f} s"
                f"  poses {result.poses}  restarts {restarts}",
                flush=True,
            )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="how many")
    parser.add_argument("--first", type=int, default=1, help="the first of them")
    parser.add_argument("--only", choices=VARIANTS[1:], help="beside mono")
    parser.add_argument("--keep", type=Path, help="folder for the recordings, which are made once")
    parser.add_argument("--set", action="append", default=[], metavar="section.name=value")
    args = parser.parse_args()
    prepare()
    changes = dict(parameters.parse_assignment(text) for text in args.set)
    variants = ("mono", args.only) if args.only else VARIANTS
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.keep or Path(temporary)
        rows = compare(range(args.first, args.first + args.seeds), folder, changes, variants)
    print("\n| | ATE, median of seeds | worst | scale error, median | worst | first pose, median |")
    print("|---|---|---|---|---|---|")
    for variant, found in rows.items():
        table = np.abs(found)
        median, worst = np.median(table, 0), table.max(0)
        print(
            f"| {variant} | {median[0]:.1f} mm | {worst[0]:.1f} mm | {median[1]:.2f} % | {worst[1]:.2f} % "
            f"| {median[2]:.1f} s |"
        )


if __name__ == "__main__":
    main()
