"""Packets into a record, frame by frame: the loop that a run, a fork and a replay share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ..clock import stopwatch
from ..fusion import conclusion
from ..io.sync import TimeOffset
from ..mapping.places import Places
from ..pipeline import step
from ..report import FrameSummary, Timings, summarize
from ..sensors import DepthRef, DepthSource, ImageRef, ImageSource, Packet
from ..state import RunState
from .folder import FINISHED, INTERRUPTED
from .header import RunHeader
from .reader import RunReader
from .writer import RunWriter


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
    notes: tuple[str, ...]  # one sentence for each thing that was ignored, assumed or differs


def estimate(
    writer: RunWriter,
    header: RunHeader,
    source: ImageSource,
    state: RunState,
    arriving: Iterable[Packet],
    progress: Callable[[Progress], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
    poses: int = 0,
    places: Places | None = None,
    offset: TimeOffset | None = None,
) -> Result:
    """Step through `arriving` from `state`, append every frame, close the record.

    `poses`: how many the record holds already.  `places`: what loops are closed with.  `offset`: what `arriving` cuts
    the IMU by, told of every estimate of the time offset.  `cancelled` is asked after each frame.
    """
    images = _TimedImages(source)
    for packet in arriving:
        state, report, ms = step(header.params, header.calibration, images, state, packet, places)
        ms = images.take_decoding_out_of(ms)
        if offset is not None:
            offset.td_s = state.window.td_s
        writer.append(report, ms, packet, state)
        poses += report.pose is not None
        progress(Progress(len(writer), header.expected_frames, poses, summarize(report, ms)))
        if cancelled():
            return _end(writer, header, INTERRUPTED, poses)
    return _end(writer, header, FINISHED, poses)


def _end(writer: RunWriter, header: RunHeader, outcome: str, poses: int) -> Result:
    """Hold the whole run to its fixes, where it has any; close the record."""
    notes = header.notes
    if header.calibration.gps_topic:
        with RunReader(writer.path) as run:
            if conclusion.has_fixes(run.summaries):
                final = conclusion.smooth_run(header, run.summaries)
                writer.conclude(final)
                notes += final.notes
    writer.close(outcome)
    return Result(len(writer), poses, outcome == FINISHED, notes)


class _TimedImages:
    """An image source whose time is told apart from that of the stage which asks for images."""

    def __init__(self, source: ImageSource) -> None:
        self._source = source
        self._ms: Timings = {}

    def load(self, ref: ImageRef) -> np.ndarray:
        with stopwatch(self._ms, "decode"):
            return self._source.load(ref)

    def load_depth(self, ref: DepthRef, scale_m: float) -> np.ndarray:
        assert isinstance(self._source, DepthSource)
        return self._source.load_depth(ref, scale_m)

    def take_decoding_out_of(self, ms: Timings) -> Timings:
        """The timings of a frame with `decode` on its own instead of within `track`."""
        decode, self._ms = self._ms.get("decode", 0.0), {}
        return {"decode": decode, **ms, "track": ms.get("track", decode) - decode}
