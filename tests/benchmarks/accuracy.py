"""Accuracy over variants of a recording: `python tests/benchmarks/accuracy.py RECORDING [--calib FILE] [--mode MODE]`.

One run is a lottery (a change of one corner changes everything after it), so a system is judged by the median and
the worst of variants: more and fewer tracks, a different spacing, other start times.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np

VARIANTS: tuple[tuple[str, dict[str, float], float], ...] = (
    ("as it is", {}, 0.0),
    *((f"max_cnt {n}", {"frontend.max_cnt": n}, 0.0) for n in (140, 145, 155, 160)),
    *((f"min_dist {n}", {"frontend.min_dist": n}, 0.0) for n in (29, 31)),
    *((f"start {s} s", {}, s) for s in (0.4, 0.7, 1.2, 2.0)),
)


def run(recording: Path, calib: list[Path], mode: str, changes: dict, start_s: float, duration_s: float | None) -> dict:
    """One headless run without a record; the metrics of `vinspect eval`, poses and milliseconds per frame."""
    from vins_core import params as P
    from vins_core import pipeline
    from vins_core.evaluation.evaluate import evaluate
    from vins_core.io import modes
    from vins_core.io.calibration import read_calibration
    from vins_core.io.recording import open_recording
    from vins_core.io.sync import TimeOffset, packets
    from vins_core.process import prepare
    from vins_core.sensors import Trajectory
    from vins_core.state import start

    prepare()
    with open_recording(recording) as probe:
        settings = read_calibration(calib, probe)
    calibration, _ = modes.prepare(settings.calibration, mode)
    source = open_recording(recording, calibration)
    params = P.replace(P.replace(P.Params(), settings.overrides), changes)
    state = start(calibration)
    t_ns, p, q, first_image, restarts, ms = [], [], [], None, 0, []
    offset = TimeOffset(calibration.td_of(0))
    for packet in packets(source, calibration, params, start_s, duration_s, offset):
        first_image = packet.images[0].t_ns if first_image is None else first_image
        t0 = time.perf_counter()
        state, report, _ = pipeline.step(params, calibration, source, state, packet)
        ms.append(1e3 * (time.perf_counter() - t0))
        offset.td_s = state.window.td_s
        restarts += bool(report.health and report.health.outcome)
        if report.pose is not None:
            t_ns.append(report.t_ns + round(report.pose.late_s * 1e9))
            p.append(report.pose.p_w_b)
            q.append(report.pose.q_w_b)
    if len(t_ns) < 3:
        return {"poses": len(t_ns), "restarts": restarts}
    estimate = Trajectory(np.array(t_ns), np.array(p), np.array(q))
    result = evaluate(estimate, source.truth(), max_dt_s=0.006, first_image_ns=first_image)
    return {**asdict(result), "restarts": restarts, "ms": float(np.median(ms))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--calib", type=Path, action="append", default=[])
    parser.add_argument("--mode", default="mono_imu", choices=("mono_imu", "stereo_imu", "stereo", "rgbd_imu"))
    parser.add_argument("--set", action="append", default=[], metavar="section.name=value")
    parser.add_argument("--start", type=float, action="append", default=[], help="further start times, s")
    parser.add_argument("--only", type=int, help="only the first N variants")
    parser.add_argument("--duration", type=float)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    base = dict(item.split("=", 1) for item in args.set)
    variants = [*VARIANTS, *((f"start {s} s", {}, s) for s in args.start)][: args.only]
    with ProcessPoolExecutor(args.jobs) as pool:
        jobs = [
            pool.submit(run, args.recording, args.calib, args.mode, {**base, **changes}, start, args.duration)
            for _, changes, start in variants
        ]
        print(
            f"{'variant':14} {'poses':>5} {'first s':>7} {'ATE m':>8} {'max m':>8} {'rot deg':>7} "
            f"{'scale':>7} {'restarts':>8} {'ms':>5}"
        )
        ates = []
        for (name, _, _), job in zip(variants, jobs, strict=True):
            r = job.result()
            ates.append(r.get("ate_rmse_m", np.inf))
            if "ate_rmse_m" not in r:
                print(f"{name:14} {r['poses']:5d}  no trajectory")
                continue
            print(
                f"{name:14} {r['poses']:5d} {r['first_pose_s']:7.2f} {r['ate_rmse_m']:8.4f} {r['ate_max_m']:8.4f} "
                f"{r['rotation_rmse_deg']:7.2f} {r['scale']:7.4f} {r['restarts']:8d} {r['ms']:5.1f}",
                flush=True,
            )
    print(f"median ATE {np.median(ates):.4f} m, worst {np.max(ates):.4f} m over {len(ates)} variants")


if __name__ == "__main__":
    main()
