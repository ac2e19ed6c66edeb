"""A recording: what is in it, its samples in time order, and its images one at a time.

`open_recording` reads only the table of contents; everything else is read when asked for and never kept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import numpy as np

from ..errors import RecordingError
from ..sensors import Calibration, DepthRef, GpsFix, ImageRef, ImuSamples, Trajectory
from . import images
from .messages import GpsMessage, ImageMessage, ImuMessage, Message, TruthMessage
from .trajectory import from_messages

_HOW_TO_CHOOSE = (
    "name one of them in the calibration file (image_topic and imu_topic in a VINS config, rostopic in Kalibr's, "
    "topic in vinspect's own)"
)

Role = Literal["image", "imu", "gps", "truth", "depth", "other"]

WRITABLE: tuple[Role, ...] = ("image", "imu", "gps", "truth", "depth")


@dataclass(frozen=True)
class Stream:
    """One topic of a recording.  Stamps are those of the message headers."""

    topic: str
    type: str
    role: Role
    count: int
    first_ns: int | None
    last_ns: int | None

    @property
    def rate_hz(self) -> float | None:
        if self.first_ns is None or self.last_ns is None or self.last_ns <= self.first_ns:
            return None
        return (self.count - 1) / (self.last_ns - self.first_ns) * 1e9


@dataclass(frozen=True)
class TopicChoice:
    """Topics to use where the types alone leave a choice; empty means "the only one there is"."""

    images: tuple[str, ...] = ()
    imu: str = ""
    truth: str = ""
    gps: str = ""
    depth: str = ""
    cameras: int = 1  # how many there are where `images` does not name them
    has_imu: bool = True
    has_depth: bool = False

    @staticmethod
    def of(calibration: Calibration) -> TopicChoice:
        named = tuple(c.topic for c in calibration.cameras)
        depth = calibration.cameras[0].depth
        return TopicChoice(
            images=named if all(named) else (),
            imu=calibration.imu_topic,
            gps=calibration.gps_topic,
            depth=depth.topic if depth else "",
            cameras=len(calibration.cameras),
            has_imu=calibration.has_imu,
            has_depth=depth is not None,
        )


@dataclass(frozen=True)
class ImageStub:
    """An image or a depth image met while scanning: where it is, not its pixels."""

    t_ns: int
    topic: str
    index: int
    locator: int


Item = ImageStub | ImuMessage | TruthMessage | GpsMessage
"""What a scan yields."""

Event = ImuMessage | ImageRef | GpsFix | DepthRef
"""What `Recording.events` yields."""

RANK: dict[type, int] = {ImuMessage: 0, GpsMessage: 1, TruthMessage: 2, ImageStub: 3}


def time_order(item: Item) -> tuple[int, int]:
    """At equal stamps the IMU comes before the image, whatever the order in the file."""
    return item.t_ns, RANK[type(item)]


class Recording(ABC):
    """Base of all readers; a reader supplies `streams`, `scan`, `_image` and `close`.

    One thread may iterate while others call `load` and `encoded`.
    """

    kind: str
    numbered = False
    """The format numbers its sensors: where there are several of a kind, the first ones are meant."""

    def __init__(self, path: Path, topics: TopicChoice | Calibration | None = None) -> None:
        self.path = path
        self.streams: tuple[Stream, ...] = ()
        self.choice = TopicChoice()
        if topics is not None:
            self.use(topics)

    # -- what is in it -----------------------------------------------------------------------------------------------

    def use(self, topics: TopicChoice | Calibration) -> Self:
        """Choose topics by name, e.g. those a calibration names; takes effect for all later calls."""
        self.choice = TopicChoice.of(topics) if isinstance(topics, Calibration) else topics
        return self

    def stream(self, topic: str) -> Stream:
        return next(s for s in self.streams if s.topic == topic)

    def of_role(self, role: Role) -> tuple[Stream, ...]:
        return tuple(s for s in self.streams if s.role == role and s.count)

    @property
    def image_topics(self) -> tuple[str, ...]:
        """The topic of each camera, in the order of Calibration.cameras."""
        if self.choice.images:
            return tuple(self._named("image", topic) for topic in self.choice.images)
        count = self.choice.cameras
        if count == 1:
            return (self._only("image"),)
        streams = self.of_role("image")
        if len(streams) < count or (len(streams) > count and not self.numbered):
            names = ", ".join(s.topic for s in streams) or "none"
            raise RecordingError(
                f"{self.path}: expected {count} image topics, found {len(streams)} ({names}): {_HOW_TO_CHOOSE}"
            )
        return tuple(s.topic for s in streams[:count])

    @property
    def imu_topic(self) -> str:
        return self._named("imu", self.choice.imu) if self.choice.imu else self._only("imu")

    @property
    def truth_topic(self) -> str | None:
        """None when there is none, or when it is not clear which (see `candidates`)."""
        return self._named("truth", self.choice.truth) if self.choice.truth else self._maybe("truth")

    @property
    def gps_topic(self) -> str | None:
        return self._named("gps", self.choice.gps) if self.choice.gps else self._maybe("gps")

    @property
    def depth_topic(self) -> str:
        return self._named("depth", self.choice.depth) if self.choice.depth else self._only("depth")

    def topics_of(self, role: Role) -> tuple[str, ...]:
        """All that have messages of a role."""
        return tuple(s.topic for s in self.of_role(role))

    def candidates(self, role: Role) -> tuple[Stream, ...]:
        """The streams that could play a role.  Full poses win over bare positions as truth."""
        streams = self.of_role(role)
        if self.numbered:
            return streams[:1]
        poses = tuple(s for s in streams if not s.type.endswith("PointStamped"))
        return poses or streams if role == "truth" else streams

    def has(self, role: Role, topic: str) -> bool:
        """Whether there is a topic of this name and role."""
        return bool(self._alike(role, topic))

    def _maybe(self, role: Role) -> str | None:
        found = self.candidates(role)
        return found[0].topic if len(found) == 1 else None

    def _named(self, role: Role, topic: str) -> str:
        alike = self._alike(role, topic)
        if alike:
            return alike[0]
        there = ", ".join(f"{s.topic} ({s.type})" for s in self.of_role(role)) or f"no {role} topic at all"
        raise RecordingError(
            f"{self.path}: there is no {role} topic {topic}; the recording has {there}: {_HOW_TO_CHOOSE}"
        )

    def _alike(self, role: Role, topic: str) -> list[str]:
        wanted = topic.strip("/").removesuffix("/compressed")
        streams = self.of_role(role)
        exact = [s.topic for s in streams if s.topic == topic]
        return exact or [s.topic for s in streams if s.topic.strip("/").removesuffix("/compressed") == wanted]

    def _only(self, role: Role) -> str:
        candidates = self.candidates(role)
        if len(candidates) == 1:
            return candidates[0].topic
        if not candidates:
            there = ", ".join(f"{s.topic} ({s.type})" for s in self.streams) or "nothing"
            raise RecordingError(f"{self.path}: there is no {role} topic; the recording has {there}")
        names = ", ".join(s.topic for s in candidates)
        raise RecordingError(f"{self.path}: {len(candidates)} {role} topics ({names}): {_HOW_TO_CHOOSE}")

    # -- samples in time order ---------------------------------------------------------------------------------------

    @abstractmethod
    def scan(self, topics: Collection[str]) -> Iterator[Item]:
        """Items of these topics merged by `time_order`, streaming; each topic keeps the order of its file."""

    def events(self) -> Iterator[Event]:
        """What packets are made of, of the chosen topics, merged by (stamp, kind), streaming: images without pixels.

        Each topic keeps the order of its file, so that a stamp that goes back is seen to go back.
        """
        cameras = {topic: i for i, topic in enumerate(self.image_topics)}
        topics = [self.imu_topic] if self.choice.has_imu else []
        depth = self.depth_topic if self.choice.has_depth else None
        others = [topic for topic in (self.gps_topic, depth) if topic is not None]
        for item in self.scan([*topics, *cameras, *others]):
            if isinstance(item, ImageStub) and item.topic == depth:
                yield DepthRef(item.t_ns, 0, item.index, item.locator)
            elif isinstance(item, ImageStub):
                yield ImageRef(item.t_ns, cameras[item.topic], item.index, item.locator)
            elif isinstance(item, GpsMessage):
                yield item.fix
            elif isinstance(item, ImuMessage):
                yield item

    def imu(self) -> ImuSamples:
        """All samples of the chosen IMU, as they are in the file."""
        samples = [m for m in self.scan([self.imu_topic]) if isinstance(m, ImuMessage)]
        if not samples:
            return ImuSamples.empty()
        return ImuSamples(
            np.array([m.t_ns for m in samples], np.int64),
            np.array([m.gyro_rad_s for m in samples]),
            np.array([m.accel_m_s2 for m in samples]),
        )

    def images(self, camera: int = 0) -> Iterator[ImageRef]:
        for item in self.scan([self.image_topics[camera]]):
            if isinstance(item, ImageStub):
                yield ImageRef(item.t_ns, camera, item.index, item.locator)

    def truth(self) -> Trajectory | None:
        """The recording's own ground truth, None without one."""
        topic = self.truth_topic
        if topic is None:
            return None
        return from_messages(m for m in self.scan([topic]) if isinstance(m, TruthMessage))

    def gps(self) -> list[GpsFix]:
        topic = self.gps_topic
        fixes = (m for m in self.scan([topic]) if isinstance(m, GpsMessage)) if topic else ()
        return [m.fix for m in fixes]

    def messages(self) -> Iterator[Message]:
        """Everything that can be written again: all cameras, depth cameras, IMUs, GPS receivers and ground truths."""
        for item in self.scan([s.topic for s in self.streams if s.count and s.role in WRITABLE]):
            yield self._image(item) if isinstance(item, ImageStub) else item

    @property
    def left_out(self) -> tuple[str, ...]:
        """Topics that `messages` does not give."""
        return tuple(s.topic for s in self.streams if s.count and s.role not in WRITABLE)

    # -- images ------------------------------------------------------------------------------------------------------

    def load(self, ref: ImageRef) -> np.ndarray:
        """Grey image (rows, columns) uint8; raises RecordingError when it cannot be read."""
        return images.grey(self._find(ref), str(self.path))

    def load_depth(self, ref: DepthRef, scale_m: float) -> np.ndarray:
        """Depth image (rows, columns) float32 in metres, NaN where unknown; `scale_m`: of an integer image.

        Raises RecordingError when it cannot be read.
        """
        message = self._image(ImageStub(ref.t_ns, self.depth_topic, ref.index, ref.locator))
        return images.depth_m(message, scale_m, str(self.path))

    def encoded(self, ref: ImageRef) -> tuple[str, bytes]:
        """(mime type, bytes) for a browser: the stored JPEG or PNG as it is, anything else as JPEG."""
        return images.for_browser(self._find(ref), str(self.path))

    def describe_image(self, stub: ImageStub) -> str:
        """Size and encoding, e.g. "752x480 jpeg"; what is wrong when it cannot be read."""
        try:
            message = self._image(stub)
            rows, columns = images.grey(message, str(self.path)).shape
        except RecordingError as error:
            return str(error)
        return f"{columns}x{rows} {message.format}"

    def _find(self, ref: ImageRef) -> ImageMessage:
        topics = self.image_topics
        if not 0 <= ref.camera < len(topics):
            raise RecordingError(f"{self.path}: there is no camera {ref.camera}; {len(topics)} topic(s) are chosen")
        return self._image(ImageStub(ref.t_ns, topics[ref.camera], ref.index, ref.locator))

    # -- what a reader supplies --------------------------------------------------------------------------------------

    @abstractmethod
    def _image(self, stub: ImageStub) -> ImageMessage:
        """The image itself; raises RecordingError."""

    @abstractmethod
    def close(self) -> None:
        """Release files; nothing may be read afterwards."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_recording(path: Path | str, topics: TopicChoice | Calibration | None = None) -> Recording:
    """Open a ROS 1 bag, a ROS 2 bag (folder, .db3 or .mcap), an EuRoC folder (mav0 or its parent) or KITTI raw data."""
    from .asl import AslRecording, find_mav0
    from .kitti import KittiRecording, find_drive
    from .rosbag import BagRecording, is_ros1

    path = Path(path)
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder")
    if path.is_file():
        if path.suffix in (".bag", ".db3", ".mcap") or is_ros1(path):
            return BagRecording(path, topics)
        raise RecordingError(
            f"{path}: not a recording; expected a ROS 1 .bag, a ROS 2 bag (folder, .db3 or .mcap), an EuRoC folder "
            "that holds mav0, or a KITTI drive"
        )
    if (path / "metadata.yaml").exists():
        return BagRecording(path, topics)
    root = find_mav0(path)
    if root is not None:
        return AslRecording(path, root, topics)
    drive = find_drive(path)
    if drive is not None:
        return KittiRecording(path, drive, topics)
    inside = sorted(p for p in path.iterdir() if p.suffix in (".bag", ".db3", ".mcap"))
    if any(p.suffix != ".bag" for p in inside):
        raise RecordingError(
            f"{path}: metadata.yaml is missing from this ROS 2 bag; rebuild it with `ros2 bag reindex {path}`, "
            f"or open {inside[0].name} itself"
        )
    if inside:
        raise RecordingError(f"{path}: a folder with bags; open one of them: {', '.join(p.name for p in inside)}")
    what = "an empty folder" if not any(path.iterdir()) else "no recording in this folder"
    raise RecordingError(
        f"{path}: {what}; expected mav0 with cam0/data.csv and imu0/data.csv (EuRoC), metadata.yaml (ROS 2) or "
        "image_00/timestamps.txt and oxts (KITTI raw)"
    )
