"""What recording a frame costs, and how fast one comes back: `pytest tests/benchmarks --benchmark-enable`."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import record_samples as samples

from vins_core.record.reader import RunReader
from vins_core.record.writer import RunWriter

FRAMES = 60


@pytest.fixture(scope="module")
def frames() -> list:
    return list(samples.frames(FRAMES))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, frames: list) -> Path:
    path = tmp_path_factory.mktemp("record") / "run"
    with RunWriter(path, samples.header(), samples.truth()) as writer:
        for frame in frames:
            writer.append(*frame)
    return path


def test_append_a_frame(benchmark: Any, tmp_path: Path, frames: list) -> None:
    numbers = itertools.count()

    def a_whole_run() -> None:
        with RunWriter(tmp_path / str(next(numbers)), samples.header()) as writer:
            for frame in frames:
                writer.append(*frame)

    benchmark.pedantic(a_whole_run, rounds=5)
    benchmark.extra_info["frames"] = FRAMES


def test_open_a_run(benchmark: Any, run: Path) -> None:
    assert len(benchmark(RunReader, run)) == FRAMES


def test_read_a_report(benchmark: Any, run: Path) -> None:
    reader, order = RunReader(run, keep=1), itertools.cycle([50, 20, 35, 5])
    assert benchmark(lambda: reader.report(next(order))).window is not None


def test_restore_a_state(benchmark: Any, run: Path) -> None:
    reader, order = RunReader(run, keep=16), itertools.cycle([50, 20, 35, 11, 59, 29])  # they push each other out
    reader.state(0)  # imports
    assert len(benchmark(lambda: reader.state(next(order))).window.frames) == 11


@pytest.fixture(scope="module")
def ten_minutes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """10 minutes at 10 Hz.  Asked for: under 600 MB, opened in 2 s, any frame in 50 ms."""
    path = tmp_path_factory.mktemp("long") / "run"
    with RunWriter(path, samples.header(), samples.truth()) as writer:
        for frame in samples.frames(6000):
            writer.append(*frame)
    return path


def test_open_ten_minutes(benchmark: Any, ten_minutes: Path) -> None:
    assert len(benchmark.pedantic(RunReader, (ten_minutes,), rounds=5)) == 6000
    size = sum(f.stat().st_size for f in ten_minutes.iterdir())
    benchmark.extra_info |= {"megabytes": round(size / 1e6), "limit_megabytes": 600, "limit_s": 2.0}


def test_restore_any_frame_of_ten_minutes(benchmark: Any, ten_minutes: Path) -> None:
    reader = RunReader(ten_minutes)
    order = itertools.cycle(np.random.default_rng(0).permutation(6000).tolist())

    def restore() -> int:
        k = next(order)
        return len(reader.report(k).tracks.ids) + len(reader.state(k).window.frames)

    reader.state(0)  # imports
    assert benchmark.pedantic(restore, rounds=200) > 0
    benchmark.extra_info["limit_ms"] = 50.0
