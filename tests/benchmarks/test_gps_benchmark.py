"""Milliseconds of GPS fusion: `pytest tests/benchmarks/test_gps_benchmark.py --benchmark-enable`.

A frame with a fix, after one minute and after three: what a fix costs must not grow with the run.  The final trajectory
may, in proportion to it.  `PYTHONPATH=tests/support python tests/benchmarks/test_gps_benchmark.py` prints the processor
time minute by minute.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gps_run import settings, steps

from vins_core.fusion.smooth import smooth
from vins_core.fusion.state import OdometryPose
from vins_core.fusion.step import step
from vins_core.simulation.drive import Drive, Receiver, Road, drive


@cache
def minutes(n: int, rate_hz: float = 1.0) -> Drive:
    return drive(0, Road(length_m=600.0 * n), receiver=Receiver(rate_hz=rate_hz, outage_s=(1e6, 1e6)))


@pytest.mark.parametrize("n", [1, 3])
def test_a_frame_with_a_fix(benchmark, n):
    d = minutes(n)
    last = int(np.searchsorted(d.t_ns, d.fixes[-1].t_ns))
    *_, (state, _) = steps(settings(), replace(d, t_ns=d.t_ns[:last], T_o_b=d.T_o_b[:last]))
    frame = OdometryPose(int(d.t_ns[last]), d.T_o_b[last])
    _, report = benchmark(lambda: step(settings(), d.p_b_gps, state, frame, d.fixes[-1:]))
    assert report.iterations > 0


@pytest.mark.parametrize("n", [1, 3])
def test_the_final_trajectory(benchmark, n):
    d = minutes(n)
    smoothed = benchmark.pedantic(lambda: smooth(settings(), d.p_b_gps, d.t_ns, d.T_o_b, d.fixes), rounds=2)
    assert len(smoothed.t_ns) == len(d.t_ns)


def main() -> None:
    print(f"{'minute':>6} {'fix ms':>7} {'worst':>6} {'frame ms':>9} {'window':>6}")
    d = minutes(10, rate_hz=5.0)
    with_fix: list[float] = []
    without: list[float] = []
    start = time.process_time()
    for k, (_, report) in enumerate(steps(settings(), d), start=1):
        now = time.process_time()
        (with_fix if report.fixes else without).append(1e3 * (now - start))
        if k % 600 == 0:
            figures = np.median(with_fix), max(with_fix), np.median(without)
            print(f"{k // 600:6d} {figures[0]:7.2f} {figures[1]:6.1f} {figures[2]:9.2f} {report.n_window:6d}")
            with_fix, without = [], []
        start = time.process_time()


if __name__ == "__main__":
    main()
