"""ROS 1 bags and ROS 2 bags (sqlite3 and mcap, folders and bare files) through `rosbags`."""

from __future__ import annotations

import heapq
import itertools
import struct
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2

from ..errors import RecordingError
from ..sensors import Calibration
from . import ros_messages
from .messages import ImageMessage, TruthMessage
from .recording import ImageStub, Item, Recording, Role, Stream, TopicChoice, time_order

Raw = tuple[int, bytes]
"""Record time in ns and the message's bytes."""


class BagRecording(Recording):
    """Items come by header stamp; the record time only says where a message is."""

    def __init__(self, path: Path, topics: TopicChoice | Calibration | None = None) -> None:
        super().__init__(path, topics)
        self.kind = _kind(path)
        self._lock = threading.Lock()
        self._codec = ros_messages.Codec(1 if self.kind == "ros1" else 2)
        self._reader: Any = self._guard(self._open)
        self._connections: dict[str, list[Connection]] = {}
        for connection in self._reader.connections:
            same = self._connections.setdefault(connection.topic, [])
            if not same or same[0].msgtype == connection.msgtype:
                same.append(connection)
        self.streams = tuple(self._guard(self._describe, topic) for topic in sorted(self._connections))

    def close(self) -> None:
        with self._lock:
            if self._reader is not None:
                self._reader.close()
                self._reader = None

    @property
    def left_out(self) -> tuple[str, ...]:
        parts = {s.topic + part for s in self.of_role("truth") for part in (ros_messages.VELOCITY, ros_messages.BIAS)}
        return tuple(topic for topic in super().left_out if topic not in parts)

    # -- table of contents -------------------------------------------------------------------------------------------

    def _open(self) -> Any:
        if self.kind == "ros2":
            for file in [self.path] if self.path.is_file() else self.path.glob("*.db3"):
                _require_all_pages(file)
        reader: Any = Reader1(self.path) if self.kind == "ros1" else Reader2(self.path)
        reader.open()
        if self.kind == "mcap":
            _require_index(reader)
        return reader

    def _describe(self, topic: str) -> Stream:
        connections = self._connections[topic]
        msgtype = connections[0].msgtype
        count = sum(c.msgcount for c in connections)
        role: Role = ros_messages.ROLES.get(msgtype, "other")
        if not count:
            return Stream(topic, msgtype, role, 0, None, None)
        first = next(self._messages(connections))
        if role == "image" and self._is_depth(msgtype, first[1]):
            role = "depth"
        first_ns, last_ns = (
            self._codec.stamp_ns(raw) if msgtype in ros_messages.STAMPED else record_ns
            for record_ns, raw in (first, self._last(connections))
        )
        return Stream(topic, msgtype, role, count, first_ns, last_ns)

    def _last(self, connections: list[Connection]) -> Raw:
        """The last message, looked for in ever longer spans before the end."""
        for span_s in (1, 10, 100):
            found = deque(self._messages(connections, self._reader.end_time - span_s * 10**9), maxlen=1)
            if found:
                return found[0]
        return deque(self._messages(connections), maxlen=1)[0]

    def _is_depth(self, msgtype: str, raw: bytes) -> bool:
        message = self._codec.decode(raw, msgtype)
        if hasattr(message, "format"):
            return "compressedDepth" in message.format
        return message.encoding in ("16UC1", "32FC1")

    # -- reading -----------------------------------------------------------------------------------------------------

    def _messages(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[Raw]:
        for _, record_ns, raw in self._reader.messages(connections, start_ns, stop_ns):
            yield record_ns, raw

    def scan(self, topics: Collection[str]) -> Iterator[Item]:
        """One pass over the bag; each topic waits in its own queue until all others have reached its stamp."""
        parts = [
            topic + part
            for topic in topics
            if self.stream(topic).role == "truth"
            for part in (ros_messages.VELOCITY, ros_messages.BIAS)
            if topic + part in self._connections
        ]
        source = _Demultiplexer(self, [*parts, *sorted(topics)])
        streams = (self._items(topic, source) for topic in sorted(topics))
        return heapq.merge(*streams, key=time_order)

    def _items(self, topic: str, source: _Demultiplexer) -> Iterator[Item]:
        msgtype, role = self._connections[topic][0].msgtype, self.stream(topic).role
        if role in ("image", "depth"):
            for index, (record_ns, raw) in enumerate(source.of(topic)):
                yield ImageStub(self._guard(self._codec.stamp_ns, raw), topic, index, record_ns)
            return
        convert: Callable[..., Any] = {"imu": ros_messages.imu, "gps": ros_messages.gps, "truth": ros_messages.truth}[
            role
        ]
        items = (
            convert(self._guard(self._codec.decode, raw, msgtype), self._guard(self._codec.stamp_ns, raw), topic)
            for _, raw in source.of(topic)
        )
        yield from self._join_truth(items, topic, source) if role == "truth" else items

    def _join_truth(self, poses: Iterable[TruthMessage], topic: str, source: _Demultiplexer) -> Iterator[TruthMessage]:
        """Poses with the velocity and the biases of the same stamp (see ros_messages)."""
        velocities = _Follower(self._twists(topic + ros_messages.VELOCITY, source))
        biases = _Follower(self._twists(topic + ros_messages.BIAS, source))
        for pose in poses:
            velocity, bias = velocities.at(pose.t_ns), biases.at(pose.t_ns)
            if velocity:
                pose = replace(pose, v_w_b=velocity[1])
            if bias:
                pose = replace(pose, b_g=bias[0], b_a=bias[1])
            yield pose

    def _twists(self, topic: str, source: _Demultiplexer) -> Iterator[tuple[int, tuple[np.ndarray, np.ndarray]]]:
        if topic not in self._connections:
            return
        for _, raw in source.of(topic):
            twist = self._guard(self._codec.decode, raw, "geometry_msgs/msg/TwistStamped").twist
            angular, linear = (np.array([v.x, v.y, v.z]) for v in (twist.angular, twist.linear))
            yield self._codec.stamp_ns(raw), (angular, linear)

    def _image(self, stub: ImageStub) -> ImageMessage:
        return self._guard(self._find_image, stub)

    def _find_image(self, stub: ImageStub) -> ImageMessage:
        connections = self._connections[stub.topic]
        with self._lock:
            found = next(
                (
                    raw
                    for _, raw in self._messages(connections, stub.locator, stub.locator + 1)
                    if self._codec.stamp_ns(raw) == stub.t_ns
                ),
                None,
            )
        if found is None:
            raise RecordingError(f"{self.path}: {stub.topic} has no image {stub.index} at {stub.t_ns} ns")
        message = self._codec.decode(found, connections[0].msgtype)
        return ros_messages.image(message, stub.t_ns, stub.topic, str(self.path))

    def _guard(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Damaged files make the reader raise nearly anything; the user gets one sentence and the repair command."""
        try:
            return call(*arguments)
        except (RecordingError, StopIteration):
            raise
        except PermissionError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror}") from error
        except Exception as error:
            detail = " ".join(str(error).split())[:200] or type(error).__name__
            raise RecordingError(
                f"{self.path}: the bag is damaged, cut short or without an index ({detail}); "
                f"repair it with `{_repair(self.kind, self.path)}`"
            ) from error


class _Demultiplexer:
    """The messages of several topics from one pass over the bag, each topic to be read at its own pace."""

    def __init__(self, bag: BagRecording, topics: Collection[str]) -> None:
        self._bag = bag
        self._queues: dict[str, deque[Raw]] = {topic: deque() for topic in topics}
        self._left = {topic: sum(c.msgcount for c in bag._connections[topic]) for topic in topics}
        self._images = {topic for topic in topics if bag.stream(topic).role in ("image", "depth")}
        self._source = bag._reader.messages([c for topic in topics for c in bag._connections[topic]])

    def of(self, topic: str) -> Iterator[Raw]:
        queue = self._queues[topic]
        while queue or (self._left[topic] and self._advance()):
            if queue:
                yield queue.popleft()

    def _advance(self) -> bool:
        with self._bag._lock:
            found = self._bag._guard(next, self._source, None)
        if found is None:
            return False
        connection, record_ns, raw = found
        self._left[connection.topic] -= 1
        if connection.topic in self._images:
            raw = raw[:12]  # the stamp; pixels do not wait in queues
        self._queues[connection.topic].append((record_ns, raw))
        return True


class _Follower:
    """A stamped stream that is asked for one stamp after the other."""

    def __init__(self, items: Iterator[tuple[int, Any]]) -> None:
        self._items = items
        self._next = next(items, None)

    def at(self, t_ns: int) -> Any:
        while self._next and self._next[0] < t_ns:
            self._next = next(self._items, None)
        return self._next[1] if self._next and self._next[0] == t_ns else None


def is_ros1(path: Path) -> bool:
    """By the first bytes, for bags of any name (a bag being recorded ends in .bag.active)."""
    try:
        with path.open("rb") as file:
            return file.read(7) == b"#ROSBAG"
    except OSError:
        return False


def _kind(path: Path) -> str:
    """ros1, ros2 (sqlite3) or mcap."""
    if path.suffix == ".bag" or (path.is_file() and is_ros1(path)):
        return "ros1"
    is_mcap = path.suffix == ".mcap" or (path.is_dir() and any(path.glob("*.mcap*")))
    return "mcap" if is_mcap else "ros2"


def _repair(kind: str, path: Path) -> str:
    if kind == "ros1":
        return f"rosbag reindex {path}"
    if kind == "mcap":
        file = next(iter(sorted(path.glob("*.mcap"))), path) if path.is_dir() else path
        return f"mcap recover {file} -o repaired.mcap"
    return f"ros2 bag reindex {path if path.is_dir() else path.parent}"


def _require_all_pages(file: Path) -> None:
    """SQLite notices a missing end only when it gets there; its header says at once (page size, page count)."""
    with file.open("rb") as stream:
        header = stream.read(100)
    if len(header) < 100 or not header.startswith(b"SQLite format 3\0"):
        raise ValueError(f"{file.name} is no SQLite file")
    page, pages = struct.unpack_from(">H", header, 16)[0], struct.unpack_from(">I", header, 28)[0]
    if file.stat().st_size < (65536 if page == 1 else page) * pages:
        raise ValueError(f"{file.name} ends before its last page")


def _require_index(reader: Reader2) -> None:
    """Without chunk and message index every image would cost a pass over the file."""
    storage: Any = reader.storage
    for file in getattr(storage, "storages", [storage]):
        indexed = sum(itertools.chain.from_iterable(c.channel_count.values() for c in file.chunks))
        if file.metadata.message_count and not indexed:
            raise ValueError("there is no message index")
