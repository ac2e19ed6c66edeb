"""From a recording to a run on disk: the loop that the command line and the browser's worker share."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from . import params as parameters
from .clock import stopwatch
from .io.calibration import Settings, read_calibration
from .io.recording import Recording, open_recording
from .io.sync import packets
from .params import Params
from .pipeline import start, step
from .record.header import RunHeader
from .record.recording import FINISHED, INTERRUPTED, RunWriter
from .report import FrameSummary, Timings, summarize
from .sensors import ImageRef, ImageSource, Packet

PathLike = str | Path

BACKEND = "numpy-tape"
"""What evaluates the factors: their CasADi expressions, replayed as NumPy operations over all factors at once."""


@dataclass(frozen=True)
class Progress:
    """After each frame: how far the run is and what came of the frame."""

    frames: int
    expected: int | None
    poses: int
    summary: FrameSummary


@dataclass(frozen=True)
class Result:
    """How a run ended."""

    frames: int
    poses: int
    finished: bool  # False: cancelled
    notes: tuple[str, ...]  # one sentence for each key of the calibration files that was ignored or assumed


def run_recording(
    recording: PathLike,
    calib: Sequence[PathLike] = (),
    *,
    out: PathLike,
    settings: Sequence[str] = (),
    start_s: float = 0.0,
    duration_s: float | None = None,
    embed_images: bool = False,
    progress: Callable[[Progress], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Result:
    """Estimate a recording into the new run folder `out`.

    `settings` are `section.name=value` and win over the tuning keys of the calibration files; `start_s` and
    `duration_s` count from the first image.  `cancelled` is asked after each frame.  However it ends, what was
    written can be read.  Raises VinspectError, before `out` is touched when the input is at fault.
    """
    cv2.setNumThreads(1)  # several fight with each other and with the page for a few cores
    assignments = dict(parameters.parse_assignment(text) for text in settings)
    parameters.replace(Params(), assignments)  # a wrong one is told before anything is read
    with open_recording(recording) as source:
        given = read_calibration(calib, source)
        params, origins = choose_parameters(given.overrides, assignments)
        arriving = packets(source, given.calibration, params, start_s, duration_s)
        first = next(arriving)  # what is wrong with the recording is told before a folder is made
        header = RunHeader(
            params,
            given.calibration,
            origins=origins,
            recording=str(Path(recording).resolve()),
            recording_kind=source.kind,
            topics=_topics(source),
            start_s=start_s,
            duration_s=duration_s,
            expected_frames=_expect_frames(source, params, start_s, duration_s),
            backend=BACKEND,
            embedded_images=embed_images,
            notes=given.notes,
        )
        with RunWriter(out, header, source.truth(), source) as writer:
            return _estimate(writer, given, header, source, itertools.chain([first], arriving), progress, cancelled)


def _estimate(
    writer: RunWriter,
    given: Settings,
    header: RunHeader,
    source: Recording,
    arriving: Iterator[Packet],
    progress: Callable[[Progress], None],
    cancelled: Callable[[], bool],
) -> Result:
    images, state, poses = _TimedImages(source), start(given.calibration), 0
    for packet in arriving:
        state, report, ms = step(header.params, given.calibration, images, state, packet)
        ms = images.take_decoding_out_of(ms)
        writer.append(report, ms, packet, state)
        poses += report.pose is not None
        progress(Progress(len(writer), header.expected_frames, poses, summarize(report, ms)))
        if cancelled():
            writer.close(INTERRUPTED)
            return Result(len(writer), poses, False, given.notes)
    writer.close(FINISHED)
    return Result(len(writer), poses, True, given.notes)


def choose_parameters(
    overrides: Mapping[str, object], assignments: Mapping[str, object]
) -> tuple[Params, dict[str, str]]:
    """Parameters and where each comes from: "default", "config" (calibration file) or "set" (wins)."""
    params = parameters.replace(parameters.replace(Params(), overrides), assignments)
    origins = dict.fromkeys(parameters.DECLARATIONS, "default")
    return params, origins | dict.fromkeys(overrides, "config") | dict.fromkeys(assignments, "set")


class _TimedImages:
    """An image source whose time is told apart from that of the stage which asks for images."""

    def __init__(self, source: ImageSource) -> None:
        self._source = source
        self._ms: Timings = {}

    def load(self, ref: ImageRef) -> np.ndarray:
        with stopwatch(self._ms, "decode"):
            return self._source.load(ref)

    def take_decoding_out_of(self, ms: Timings) -> Timings:
        """The timings of a frame with `decode` on its own instead of within `track`."""
        decode, self._ms = self._ms.get("decode", 0.0), {}
        return {"decode": decode, **ms, "track": ms.get("track", decode) - decode}


def _topics(source: Recording) -> dict[str, str]:
    named = {f"cam{i}": topic for i, topic in enumerate(source.image_topics)}
    truth = source.truth_topic
    return named | {"imu": source.imu_topic} | ({"truth": truth} if truth else {})


def _expect_frames(source: Recording, params: Params, start_s: float, duration_s: float | None) -> int | None:
    """How many frames there will be, for progress bars: an estimate."""
    images = source.stream(source.image_topics[0])
    if images.first_ns is None or images.last_ns is None or not images.rate_hz:
        return None
    length_s = max((images.last_ns - images.first_ns) * 1e-9 - start_s, 0.0)
    if duration_s is not None:
        length_s = min(length_s, duration_s)
    every = math.ceil(images.rate_hz / params.frontend.freq - 0.01)  # images a frame
    return max(int(length_s * images.rate_hz / max(every, 1)), 1)
