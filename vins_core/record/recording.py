"""A run on disk: a folder that only ever grows, readable while it is written and after a crash (SPEC 9.1).

    header.json   how the run came about
    truth.log     ground truth of the recording, when it has one
    frames.log    a block a frame: report, timings, packet, and the state after it (HOUSE, "Time travel")
    index.log     a block a frame: where it lies in frames.log, and its summary; made again when missing or damaged
    map/          with loops: the map that the run begins with, its vocabulary at least (mapping/maps.py)
    images.log    with --embed-images: the images of each frame and its depth, losslessly
    global.log    with GPS: the final trajectory, written when the run ends (fusion/conclusion.py)
    end.json      written last: how the run ended

The state of every frame comes back bit for bit without replay: see codec.py for how a window costs little.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from ..clock import stopwatch
from ..errors import OutputError, RunError
from ..report import FrameReport, FrameSummary, Timings, summarize
from ..sensors import DepthRef, DepthSource, ImageRef, ImageSource, Packet, Trajectory
from . import header as headers
from .codec import Blob, Ledger, pack, pack_series
from .header import RunHeader
from .log import Block, LogReader, LogWriter
from .recent import MAX_BYTES, Recent

if TYPE_CHECKING:
    from ..fusion.conclusion import FinalTrack
    from ..loop.keyframe import Keyframes
    from ..mapping.places import Places
    from ..pipeline import RunState
    from .closures import RecordedMap

try:
    import fcntl
except ImportError:  # not on this system: a run that was killed looks like one that still grows
    fcntl = None  # type: ignore[assignment]

HEADER, TRUTH, FRAMES, INDEX, IMAGES, GLOBAL, END, MAP = (
    "header.json",
    "truth.log",
    "frames.log",
    "index.log",
    "images.log",
    "global.log",
    "end.json",
    "map",
)
KEEP_STATES = 4
MAX_INDEX_DIRECTORY = 64 * 1024
MAX_IMAGE_PIXELS = 2**26
FINISHED, INTERRUPTED = "finished", "interrupted"


class _End(msgspec.Struct):
    outcome: str  # FINISHED, INTERRUPTED, or the sentence of the error that ended the run
    frames: int


def is_run(path: str | os.PathLike[str]) -> bool:
    """Whether a folder is a run rather than a recording."""
    return (Path(path) / HEADER).is_file()


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
        if fcntl:
            with contextlib.suppress(OSError):  # some network folders cannot lock
                fcntl.flock(self._frames.fileno(), fcntl.LOCK_EX)
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
                own["images"] = [self._image_log.append(_encode(self._images.load(ref))) for ref in report.images]
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


class RunReader:
    """Any frame of a run, in any order, by its number.  Safe to use from several threads.

    Raises RunError when `path` is not a run.  Everything it returns is read-only and may be kept.
    """

    def __init__(self, path: str | os.PathLike[str], keep: int = 64) -> None:
        """`keep`: how many frames stay in memory."""
        self.path = Path(path)
        if not self.path.is_dir():
            raise RunError(f"{self.path} is not a folder; a run is the folder given to `vinspect run --out`")
        if not is_run(self.path):
            raise RunError(f"{self.path} is not a run: it has no {HEADER}")
        self.header = headers.from_json(self._small_file(HEADER), str(self.path / HEADER))
        self.summaries: list[FrameSummary] = []
        self._blocks: list[Block] = []
        self._frames = LogReader(self.path / FRAMES)
        self._index: LogReader | None = None
        self._index_end = 0
        self._images = LogReader(self.path / IMAGES) if (self.path / IMAGES).is_file() else None
        self._truth: Trajectory | None = None
        self._final_track: FinalTrack | None = None
        self._refreshing = threading.Lock()
        self._blob = Recent(self._read_blob, keep)
        self._reports = Recent(self._read_report, keep)
        self._states = Recent(self._read_state, min(keep, KEEP_STATES))
        self.refresh()

    def __len__(self) -> int:
        return len(self.summaries)

    def refresh(self) -> int:
        """Look for frames appended since the last look; returns how many there are."""
        with self._refreshing:
            before = len(self)
            self._follow_index()
            self._follow_frames()
            return len(self) - before

    @property
    def outcome(self) -> str | None:
        """How the run ended; None while it grows, or when its process was killed."""
        end = self._end()
        return end.outcome if end else None

    @property
    def complete(self) -> bool:
        """The run ended and every frame of it has been read."""
        end = self._end()
        return end is not None and end.frames <= len(self)

    @property
    def growing(self) -> bool:
        """Some process still writes it."""
        if self.outcome is not None or not fcntl:
            return self.outcome is None
        try:
            fcntl.flock(self._frames.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(self._frames.fileno(), fcntl.LOCK_UN)
        return False

    @property
    def truth(self) -> Trajectory | None:
        if self._truth is None and (self.path / TRUTH).is_file():
            self._truth = self._read_block(TRUTH).get("truth", Trajectory)
        return self._truth

    @property
    def final_track(self) -> FinalTrack | None:
        """What was kept when the run ended; None while it grows, and where no fixes are fused."""
        if self._final_track is None and (self.path / GLOBAL).is_file() and self.complete:
            from ..fusion.conclusion import FinalTrack

            self._final_track = self._read_block(GLOBAL).get("final", FinalTrack)
        return self._final_track

    def summary(self, k: int) -> FrameSummary:
        return self.summaries[self._number(k)]

    def report(self, k: int) -> FrameReport:
        """All that frame k said."""
        return self._reports(self._number(k))

    def timings(self, k: int) -> Timings:
        return self.summary(k).ms

    def packet(self, k: int) -> Packet:
        """What arrived for frame k."""
        return self._section(k, "packet", Packet)

    def state(self, k: int) -> RunState:
        """The state after frame k, bit for bit."""
        return self._states(self._number(k))

    @property
    def has_images(self) -> bool:
        """Whether the pixels are in the record; else they must be loaded from the recording."""
        return self._images is not None

    def load(self, ref: ImageRef) -> np.ndarray:
        """The grey image of a reference, as an `ImageSource`; RunError when it is not in the record."""
        if self._images is None:
            raise RunError(f"{self.path} holds no images: it was made without --embed-images")
        times = np.array([s.t_ns for s in self.summaries], np.int64)
        k = int(np.searchsorted(times, ref.t_ns))
        if k < len(self):
            for mine, block in zip(self.report(k).images, self._section(k, "images", list[Block]), strict=True):
                if mine == ref:
                    camera = self.header.calibration.cameras[ref.camera].model
                    where = f"{self.path / IMAGES} at byte {block.offset}"
                    return _decode(self._images.read(block), (camera.height, camera.width), where)
        raise RunError(f"{self.path} holds no image {ref.index} of camera {ref.camera} at {ref.t_ns} ns")

    def load_depth(self, ref: DepthRef, scale_m: float) -> np.ndarray:
        """The depth image of a reference in metres, as a `DepthSource`, as it was scaled when the run was made."""
        if self._images is None:
            raise RunError(f"{self.path} holds no images: it was made without --embed-images")
        times = np.array([s.t_ns for s in self.summaries], np.int64)
        k = int(np.searchsorted(times, ref.t_ns))
        for near in range(max(k - 1, 0), min(k + 2, len(self))):
            if self.packet(near).depth == ref:
                block = self._section(near, "depth", Block)
                where = f"{self.path / IMAGES} at byte {block.offset}"
                depth_m = Blob(self._images.read(block), where).get("depth_m", np.ndarray)
                if depth_m.ndim != 2 or depth_m.dtype != np.float32:
                    raise RunError(f"{where} does not hold a depth image")
                return depth_m
        raise RunError(f"{self.path} holds no depth image {ref.index} at {ref.t_ns} ns")

    def same_bytes(self, other: RunReader, k: int) -> bool:
        """Whether frame k is known to be the same in both, as those that a fork copied are."""
        return self._blocks[k] == other._blocks[k]

    def copy_logs(self, n: int, frames: LogWriter, index: LogWriter, images: LogWriter | None) -> None:
        """The first n frames into empty logs."""
        frames.adopt(self._frames, self._blocks[n - 1].end if n else 0)
        for block, summary in zip(self._blocks[:n], self.summaries[:n]):
            index.append(pack({"block": block, "summary": summary}))
        if images and self._images:
            held = (self._section(k, "images", list[Block]) for k in range(n - 1, -1, -1))
            images.adopt(self._images, next((blocks[-1].end for blocks in held if blocks), 0))

    def close(self) -> None:
        for log in (self._frames, self._index, self._images):
            if log:
                log.close()

    def __enter__(self) -> RunReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _number(self, k: int) -> int:
        if not 0 <= k < len(self):
            raise RunError(f"{self.path} has no frame {k}; it holds {len(self)} frames")
        return k

    def _section(self, k: int, name: str, kind: Any) -> Any:
        return self._holding(k, name).get(name, kind)

    def _holding(self, k: int, name: str) -> Blob:
        blob = self._blob(self._number(k))
        if name not in blob:
            raise RunError(f"frame {k} of {self.path} was recorded without its {name}")
        return blob

    @property
    def places(self) -> Places | None:
        """What the run closes loops with; None when it closes none.  Raises MapError when that is damaged."""
        return self._map.places if self._map else None

    @property
    def keyframes(self) -> Keyframes:
        """Every keyframe of the map the run began with, and of the run, as loop closing keeps them."""
        if self._map is None:
            raise RunError(f"{self.path} has no loops: it was made with --loops off")
        self._map.follow(self.summaries)
        return self._map.keyframes

    @cached_property
    def _map(self) -> RecordedMap | None:
        if not (self.path / MAP).is_dir():
            return None
        from ..mapping import maps
        from .closures import RecordedMap
        from .keyframes import KeyframeRecord

        places = maps.load(self.path / MAP, self.header.calibration.cameras[0])
        return RecordedMap(places, lambda k: self._section(k, "keyframe", KeyframeRecord), str(self.path / FRAMES))

    def _read_blob(self, k: int) -> tuple[Blob, int]:
        blob = Blob(self._frames.read(self._blocks[k]), f"frame {k} of {self.path / FRAMES}")
        return blob, blob.cost

    def _read_report(self, k: int) -> tuple[FrameReport, int]:
        blob = self._blob(k)
        return blob.get("report", FrameReport), blob.cost

    def _read_state(self, k: int) -> tuple[RunState, int]:
        from ..pipeline import RunState  # not needed to look at a run, and costs CasADi

        blobs = {0: self._holding(k, "state")}

        def earlier(back: int) -> Blob:
            if back not in blobs:
                blobs[back] = self._blob(self._number(k - back))
                if sum(blob.cost for blob in blobs.values()) > MAX_BYTES:
                    raise RunError(f"the state of frame {k} of {self.path} refers to more than a state can hold")
            return blobs[back]

        state = blobs[0].get("state", RunState, earlier)
        if "closure" in blobs[0]:
            state = self._with_closure(state, blobs[0], earlier)
        return state, sum(blob.cost for blob in blobs.values())

    def _with_closure(self, state: RunState, blob: Blob, earlier: Callable[[int], Blob]) -> RunState:
        from .closures import ClosureMark

        if self._map is None:
            raise RunError(
                f"{self.path} lacks its folder {MAP}, which its loops need; copy the whole folder of the run"
            )
        self._map.follow(self.summaries)
        return replace(state, closure=self._map.restore(blob.get("closure", ClosureMark, earlier)))

    def _follow_index(self) -> None:
        """Take new index entries, as long as they are whole and frames.log holds what they promise."""
        if self._index is None:
            if not (self.path / INDEX).is_file():
                return
            self._index = LogReader(self.path / INDEX)
        size = self._frames.size()
        for entry, payload in self._index.scan(self._index_end):
            try:
                blob = Blob(payload, str(self.path / INDEX), MAX_INDEX_DIRECTORY)
                block, summary = blob.get("block", Block), blob.get("summary", FrameSummary)
            except RunError:
                return
            if summary.frame > len(self) or block.end > size:
                return
            self._index_end = entry.end
            if summary.frame == len(self):
                self._add(block, summary)

    def _follow_frames(self) -> None:
        """Take whole frames that the index does not list (yet, or because it was lost)."""
        for block, payload in self._frames.scan(self._blocks[-1].end if self._blocks else 0):
            blob = Blob(payload, f"frame {len(self)} of {self.path / FRAMES}")
            report, timings = blob.get("report", FrameReport), blob.get("timings", Timings)
            if report.frame != len(self):
                raise RunError(f"{self.path / FRAMES} holds frame {report.frame} where {len(self)} should be")
            self._add(block, summarize(report, timings))

    def _add(self, block: Block, summary: FrameSummary) -> None:
        self._blocks.append(block)
        self.summaries.append(summary)

    def _end(self) -> _End | None:
        try:
            return msgspec.convert(headers.unseal(self._small_file(END), END), _End)
        except (RunError, msgspec.MsgspecError):
            return None

    def _read_block(self, name: str) -> Blob:
        log = LogReader(self.path / name)
        payload = next((payload for _, payload in log.scan(0)), None)
        log.close()
        if payload is None:
            raise RunError(f"{self.path / name} is damaged: its checksum does not match")
        return Blob(payload, str(self.path / name))

    def _small_file(self, name: str) -> bytes:
        path = self.path / name
        try:
            if path.stat().st_size > headers.MAX_HEADER_BYTES:
                raise RunError(f"{path} is larger than any header of ours; it is not a vinspect run")
            return path.read_bytes()
        except OSError as problem:
            raise RunError(f"cannot read {path}: {problem.strerror}") from None


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


def _encode(image: np.ndarray) -> bytes:
    import cv2

    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def _decode(png: bytes, shape: tuple[int, int], where: str) -> np.ndarray:
    import cv2

    width, height = int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")  # of the IHDR chunk
    if (height, width) != shape or height * width > MAX_IMAGE_PIXELS:  # told before a forged size takes memory
        raise RunError(f"{where} holds an image of {width}x{height} where {shape[1]}x{shape[0]} is calibrated")
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise RunError(f"{where} does not hold an image")
    return image
