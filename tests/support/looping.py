"""Seconds of the bundled sample with so small a gap between keyframes of a loop that there are many loops."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from sample import CALIBRATION, RECORDING

from vins_core.loop.keyframe import LoopKeyframe
from vins_core.mapping.closure import begin, close, interrupt
from vins_core.mapping.places import Places
from vins_core.params import Params
from vins_core.record.fork import recorded_images
from vins_core.record.reader import RunReader
from vins_core.report import ClosureReport, FrameReport, LoopReport, Status
from vins_core.runner import run_recording
from vins_core.sensors import ImageRef
from vins_core.window.state import WindowState

DURATION_S = 7.0
SETTINGS = ("loop.min_gap=8",)


@pytest.fixture(scope="session")
def looping_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 70 frames with some 28 loops, which the window refines; never written to."""
    out = tmp_path_factory.mktemp("looping") / "run"
    run_recording(RECORDING, [CALIBRATION], out=out, duration_s=DURATION_S, settings=SETTINGS)
    return out


@pytest.fixture(scope="session")
def feedforward_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without relocalisation: loops change nothing about the odometry."""
    out = tmp_path_factory.mktemp("feedforward") / "run"
    settings = (*SETTINGS, "loop.relocalize=0")
    run_recording(RECORDING, [CALIBRATION], out=out, duration_s=DURATION_S, settings=settings)
    return out


@lru_cache(maxsize=1)
def tracked(run: RunReader) -> tuple[tuple[FrameReport, WindowState], ...]:
    """What loop closing gets to see of every frame."""
    return tuple((run.report(k), run.state(k).window) for k in range(len(run)))


def close_again(run: RunReader, params: Params, described: bool = True) -> Iterator[ClosureReport | None]:
    """Loop closing alone over the recorded windows: what a run without relocalisation and with `params` would do.

    `described`: keyframes as they were recorded, where their corners are the same; else from their images.
    """
    assert run.places is not None and not params.loop.relocalize
    places = _Described(run) if described else run.places
    closure = begin(run.places)
    with recorded_images(run) as images:
        for (report, window), before in zip(tracked(run), [None, *(r for r, _ in tracked(run))], strict=False):
            if report.status is Status.FAILED:
                closure = interrupt(closure)
            if report.status is not Status.TRACKING:
                yield None
                continue
            assert before is not None
            source = _NoImages() if described else images
            asked = replace(report, closure=None)
            closure, said = close(params, places, source, closure, window, before.images[-1], asked, {})
            yield said.closure


def loops(closures: Iterator[ClosureReport | None]) -> list[tuple[int, int]]:
    """Accepted (query, match) of every frame."""
    reports = (c.loop for c in closures if c and c.loop)
    return [(r.accepted.query, r.accepted.match) for r in reports if r.accepted]


def recorded(run: RunReader) -> Iterator[ClosureReport | None]:
    return (run.report(k).closure for k in range(len(run)))


def verdict(report: LoopReport) -> tuple[object, ...]:
    return report.keyframe, report.outcome, report.accepted and report.accepted.match


class _Described(Places):
    """Places that know their keyframes from a record."""

    def __init__(self, run: RunReader) -> None:
        assert run.places is not None
        for name, value in vars(run.places).items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "by_frame", {k.frame: k for k in run.keyframes})

    def describe(self, window: WindowState, slot: int, *_: object) -> LoopKeyframe:
        return replace(self.by_frame[window.frames[slot].frame], node=None)  # type: ignore[attr-defined]


class _NoImages:
    def load(self, ref: ImageRef) -> np.ndarray:
        return np.zeros((0, 0), np.uint8)
