"""A run as it is written, frame by frame; folder.py says what lies where."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..clock import stopwatch
from ..errors import OutputError
from ..report import FrameReport, Timings, summarize
from ..sensors import DepthRef, DepthSource, ImageSource, Packet, Trajectory
from . import header as headers
from . import lock
from .codec import Ledger, pack, pack_series
from .folder import END, FINISHED, FRAMES, GLOBAL, HEADER, IMAGES, INDEX, INTERRUPTED, MAP, TRUTH
from .header import RunHeader
from .images import encode
from .log import LogWriter

if TYPE_CHECKING:
    from ..fusion.conclusion import FinalTrack
    from ..mapping.places import Places
    from ..state import RunState
    from .reader import RunReader


class RunWriter:
    """Appends frames to a new run.  Raises OutputError when the folder is not empty or cannot be written."""

    def __init__(
        self,
        path: str | os.PathLike[str],
        header: RunHeader,
        truth: Trajectory | None = None,
        images: ImageSource | None = None,
        places: Places | None = None,
    ) -> None:
        """`images`: where to take the pixels of frames from when the header says that they are embedded.

        `places`: what the run closes loops with.
        """
        self.path = Path(path)
        self._images = images if header.embedded_images else None
        self._depth = header.calibration.cameras[0].depth
        self._ledger = Ledger()
        self._create_folder()
        self._frames = LogWriter(self.path / FRAMES)
        self._index = LogWriter(self.path / INDEX)
        self._image_log = LogWriter(self.path / IMAGES) if self._images else None
        lock.hold(self._frames.fileno())
        if truth is not None:
            self._write_block(TRUTH, {"truth": truth})
        if places is not None:
            from ..mapping import maps

            maps.save(self.path / MAP, places, places.graph, places.keyframes)
        self._write(HEADER, headers.to_json(header))  # last: a folder with a header can be opened

    def adopt(self, other: RunReader, frames: int) -> None:
        """Begin with the first `frames` frames of another run, byte for byte; its images come along."""
        if len(self) or not 0 <= frames <= len(other):
            raise ValueError(f"cannot begin with {frames} frames of {other.path} after {len(self)} of its own")
        other.copy_logs(frames, self._frames, self._index, self._image_log)
        self._ledger = Ledger(frames)

    def append(
        self, report: FrameReport, timings: Timings, packet: Packet | None = None, state: RunState | None = None
    ) -> None:
        """The next frame; with `packet` and `state` (the one after the step) it can be restored and replayed.

        Adds how long it took to the frame's timings, as `record`.
        """
        if report.frame != len(self):
            raise ValueError(f"frame {report.frame} cannot follow {len(self) - 1}: frames are numbered from 0")
        own: dict[str, Any] = {"report": report, "timings": timings}
        if packet is not None:
            own["packet"] = packet
        timings = dict(timings)
        with stopwatch(timings, "record"):  # known too late for frames.log: only the index has it
            if self._image_log and self._images:
                if self._depth and packet is not None and packet.depth is not None:
                    own["depth"] = self._image_log.append(self._packed_depth(packet.depth))
                own["images"] = [self._image_log.append(encode(self._images.load(ref))) for ref in report.images]
            if state is not None and report.closure is not None and report.closure.keyframe is not None:
                own["keyframe"] = _newest_keyframe(state)
            payload, self._ledger = pack_series(own, {} if state is None else state_sections(state), self._ledger)
            block = self._frames.append(payload)
        self._index.append(pack({"block": block, "summary": summarize(report, timings)}))

    def __len__(self) -> int:
        return self._ledger.blob

    def conclude(self, final: FinalTrack) -> None:
        """The trajectory that the fixes make of the whole run, once its last frame is there."""
        self._write_block(GLOBAL, {"final": final})

    def close(self, outcome: str = FINISHED) -> None:
        """Ends the run; `outcome` says how, one sentence when it failed."""
        if self._frames.closed:
            return
        for log in (self._frames, self._index, self._image_log):
            if log:
                log.close()
        self._write(END, headers.seal({"outcome": outcome, "frames": len(self)}))

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None, trace: Any) -> None:
        if problem is None:
            self.close()
        else:
            self.close(f"{problem or kind}" if isinstance(problem, Exception) else INTERRUPTED)

    def _packed_depth(self, ref: DepthRef) -> bytes:
        assert self._depth is not None and isinstance(self._images, DepthSource)
        return pack({"depth_m": self._images.load_depth(ref, self._depth.scale_m)})

    def _create_folder(self) -> None:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            occupied = any(self.path.iterdir())
        except OSError as problem:
            raise OutputError(f"cannot create the run folder {self.path}: {problem.strerror}") from None
        if occupied:
            raise OutputError(
                f"{self.path} is not empty; a run is never overwritten: choose another folder or remove it"
            )

    def _write_block(self, name: str, sections: dict[str, Any]) -> None:
        log = LogWriter(self.path / name)
        log.append(pack(sections))
        log.close()

    def _write(self, name: str, data: bytes) -> None:
        path = self.path / name
        partial = path.with_suffix(".part")
        try:
            partial.write_bytes(data)
            partial.replace(path)
        except OSError as problem:
            raise OutputError(f"cannot write {path}: {problem.strerror}") from None


def state_sections(state: RunState) -> dict[str, Any]:
    """The sections of a state: what only grows is elsewhere (closures.py)."""
    if state.closure is None:
        return {"state": state}
    from .closures import mark

    return {"state": replace(state, closure=None), "closure": mark(state.closure)}


def _newest_keyframe(state: RunState) -> Any:
    from .keyframes import reduce

    assert state.closure is not None
    return reduce(state.closure.loops.keyframes[len(state.closure.loops) - 1])
