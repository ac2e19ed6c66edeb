"""From a slider to a result: `VINS_DATA=... pytest tests/benchmarks/test_what_if.py --benchmark-enable`.

On the flight euroc_mh01_16s.  Medians asked for: a window solved again 60 ms, with the front end run again 200 ms,
all gates of 600 frames judged again 50 ms, "is this the optimum?" 1 s.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from vins_core import examine
from vins_core import params as parameters
from vins_core.process import prepare
from vins_core.record.compare import compare
from vins_core.record.fork import fork, recorded_images
from vins_core.record.reader import RunReader
from vins_core.record.reevaluate import GateHistory
from vins_core.runner import run_recording
from vins_core.sensors import ImageSource
from vins_core.whatif import effect, resolve

FRAMES = range(30, 150, 8)
"""Each round another frame, as scrubbing with a changed parameter does."""

pytestmark = pytest.mark.skipif("VINS_DATA" not in os.environ, reason="VINS_DATA is not set")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunReader:
    flight, out = Path(os.environ["VINS_DATA"]) / "euroc_mh01_16s", tmp_path_factory.mktemp("what_if") / "run"
    run_recording(flight, [flight / "vins_mono.yaml"], out=out)
    return RunReader(out)


@pytest.fixture(scope="module")
def images(run: RunReader) -> Iterator[ImageSource]:
    with recorded_images(run) as source:
        yield source


def solve_again(benchmark: BenchmarkFixture, run: RunReader, images: ImageSource, limit_ms: float, **how: bool) -> None:
    prepare()
    params = parameters.replace(run.header.params, {"window.pixel_sigma": 2.0, "frontend.F_threshold": 0.7})
    frames = itertools.cycle(FRAMES)

    def slide() -> bool:
        found = resolve(run, next(frames), params, images, **how)
        return effect(found.before, found.after) is not None and found.first_difference is not None

    assert benchmark.pedantic(slide, rounds=len(FRAMES), warmup_rounds=3) in (True, False)
    benchmark.extra_info["limit_ms"] = limit_ms


def test_solve_a_window_again(benchmark: BenchmarkFixture, run: RunReader, images: ImageSource) -> None:
    solve_again(benchmark, run, images, 60.0)


def test_solve_a_window_again_with_its_front_end(
    benchmark: BenchmarkFixture, run: RunReader, images: ImageSource
) -> None:
    solve_again(benchmark, run, images, 200.0, rerun_frontend=True)


def test_ask_whether_a_window_is_at_its_optimum(benchmark: BenchmarkFixture, run: RunReader) -> None:
    prepare()
    frames = itertools.cycle(FRAMES)
    found = benchmark.pedantic(lambda: examine.optimum(run, next(frames)), rounds=len(FRAMES), warmup_rounds=1)
    assert found is not None and found.iterations > 0
    benchmark.extra_info["limit_ms"] = 1000.0


def test_judge_all_gates_of_600_frames(benchmark: BenchmarkFixture, run: RunReader) -> None:
    history = GateHistory()
    for n in range(600):
        history.extend(run.report(n % len(run)), run.header.params)
    history.columns()
    limits = itertools.cycle([8.0, 9.0, 11.0, 12.0])

    def slide() -> int:
        limit = next(limits)
        changes = {"window.keyframe_parallax": limit, "window.max_error_px": limit / 4, "health.max_jump_m": limit}
        return len(history.reevaluate(changes).gates)

    assert benchmark(slide) == 3
    benchmark.extra_info["limit_ms"] = 50.0


def test_read_the_gates_of_a_frame(benchmark: BenchmarkFixture, run: RunReader) -> None:
    frames, history = itertools.cycle(range(len(run))), GateHistory()
    benchmark(lambda: history.extend(run.report(next(frames)), run.header.params))


def test_fork_ten_frames(benchmark: BenchmarkFixture, run: RunReader, images: ImageSource, tmp_path: Path) -> None:
    number = itertools.count()
    benchmark.pedantic(
        lambda: fork(run, 100, tmp_path / str(next(number)), {"window.pixel_sigma": 2.0}, 10, images), rounds=3
    )


def test_compare_with_a_fork_that_never_decides_otherwise(
    benchmark: BenchmarkFixture, run: RunReader, images: ImageSource, tmp_path: Path
) -> None:
    fork(run, 100, tmp_path / "fork", {}, images=images)
    forked = RunReader(tmp_path / "fork")
    assert benchmark.pedantic(lambda: compare(run, forked), rounds=3).first_difference is None
