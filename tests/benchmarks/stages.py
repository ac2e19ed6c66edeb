"""Milliseconds per stage of a run, beside a yardstick: `python tests/benchmarks/stages.py RECORDING [--calib FILE]`.

`--mode stereo` or another of what the recording allows; `--backend numpy` or `c` instead of what "auto" finds; "c"
compiles first, so that every frame has it.

Medians over the frames of one run that also writes its record; p10 is what others on the machine disturb least.  The
yardstick (optical flow between two fixed images, a Cholesky factorisation of 172 columns) says how fast the machine is,
so that figures of two machines compare.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np

YARDSTICK_RUNS = 50


def yardstick() -> dict[str, float]:
    import cv2
    from scipy.linalg import lapack

    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.integers(0, 256, (480, 752)).astype(np.uint8), (0, 0), 2.5)
    moved = np.roll(image, (2, 3), (0, 1))
    points = cv2.goodFeaturesToTrack(image, 150, 0.01, 30)
    A = rng.normal(size=(172, 172))
    A = A @ A.T + 172 * np.eye(172)
    return {
        "KLT of 150 points, 752x480": _median_ms(lambda: cv2.calcOpticalFlowPyrLK(image, moved, points, None)),
        "dpotrf 172": _median_ms(lambda: lapack.dpotrf(A)),
    }


def _median_ms(call) -> float:
    times = []
    for _ in range(YARDSTICK_RUNS):
        start = time.thread_time()
        call()
        times.append(1e3 * (time.thread_time() - start))
    return float(np.median(times))


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--calib", type=Path, action="append", default=[])
    parser.add_argument("--set", action="append", default=[], metavar="section.name=value")
    parser.add_argument("--duration", type=float)
    parser.add_argument("--mode", choices=("mono_imu", "stereo_imu", "stereo"))
    parser.add_argument("--processor", action="store_true", help="processor time, for a machine that others use, too")
    parser.add_argument("--backend", choices=("auto", "numpy", "c"), default="auto")
    args = parser.parse_args()

    from vins_core import clock
    from vins_core.record.reader import RunReader
    from vins_core.runner import run_recording

    if args.processor:
        clock.time = SimpleNamespace(perf_counter=time.thread_time)  # type: ignore[attr-defined]
    memory: dict[int, float] = {}
    first_ns: list[int] = []

    def note(progress) -> None:
        first_ns.append(progress.summary.t_ns)
        second = int((progress.summary.t_ns - first_ns[0]) * 1e-9)
        if second % 10 == 0 and second not in memory:
            memory[second] = resident_mb()

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        started = time.perf_counter()
        run_recording(
            args.recording,
            args.calib,
            out=out,
            settings=args.set,
            duration_s=args.duration,
            backend=args.backend,
            mode=args.mode,
            progress=note,
        )
        wall = time.perf_counter() - started
        reader = RunReader(out)
        summaries = reader.summaries
        size = sum(f.stat().st_size for f in out.rglob("*") if f.is_file())

    stages: dict[str, list[float]] = defaultdict(list)
    solved = [s for s in summaries if s.after is not None]
    for s in solved:
        for stage, ms in s.ms.items():
            if stage == "marginalize" and s.marginalized != "MARGIN_OLD":
                continue
            stages[stage].append(ms)
        stages["estimator (solve, explain, marginalise, slide)"].append(
            sum(s.ms.get(k, 0.0) for k in ("repropagate", "triangulate", "solve", "explain", "marginalize", "slide"))
        )
        stages["whole frame"].append(sum(s.ms.values()))
    kilobytes = size / len(summaries) / 1e3
    print(f"mode {reader.header.mode}, back end {reader.header.backend} on {reader.header.cpu}")
    print(f"{len(summaries)} frames, {len(solved)} solved, in {wall:.1f} s; record {kilobytes:.0f} kB a frame")
    for name, ms in yardstick().items():
        print(f"{name:48} {ms:8.2f} ms   yardstick")
    for stage, values in stages.items():
        p10, p95 = np.percentile(values, (10, 95))
        print(f"{stage:48} {np.median(values):8.2f} ms   p10 {p10:6.2f}  p95 {p95:6.2f}")
    print("resident memory MB after s: " + ", ".join(f"{s}: {mb:.0f}" for s, mb in memory.items()))


if __name__ == "__main__":
    main()
