"""A run as it is read, while it grows or later: any frame, in any order; folder.py says what lies where."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from ..errors import RunError
from ..report import FrameReport, FrameSummary, Timings, summarize
from ..sensors import DepthRef, ImageRef, Packet, Trajectory
from . import header as headers
from . import lock
from .codec import Blob, pack
from .folder import END, FRAMES, GLOBAL, HEADER, IMAGES, INDEX, MAP, TRUTH, End, is_run
from .images import decode
from .log import Block, LogReader, LogWriter
from .recent import MAX_BYTES, Recent

if TYPE_CHECKING:
    from ..fusion.conclusion import FinalTrack
    from ..loop.keyframe import Keyframes
    from ..mapping.places import Places
    from ..state import RunState
    from .closures import RecordedMap

KEEP_STATES = 4
MAX_INDEX_DIRECTORY = 64 * 1024


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
        return self.outcome is None and lock.is_held(self._frames.fileno())

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
                    return decode(self._images.read(block), (camera.height, camera.width), where)
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
        from ..state import RunState  # not needed to look at a run, and costs CasADi

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

    def _end(self) -> End | None:
        try:
            return msgspec.convert(headers.unseal(self._small_file(END), END), End)
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
