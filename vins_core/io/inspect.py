"""What is in a recording and what is odd about it: the answer to `vinspect info`."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import RecordingError
from ..fusion import available
from ..params import Gps
from ..sensors import Anomaly, Calibration
from .anomalies import ImuWatch, StampWatch, image_watch
from .companions import PairWatch
from .messages import ImuMessage
from .modes import ModeInfo, inspect_modes
from .recording import ImageStub, Recording, Stream
from .sync import STEREO_TOLERANCE_NS

READABLE = ("image", "imu", "gps", "truth", "depth")
MAX_LISTED = 200
"""Anomalies listed of one kind on one topic; all are counted."""


@dataclass(frozen=True)
class StreamInfo:
    """One topic.  Rates and gaps are None where the topic was not read (unknown types) or has too few samples."""

    topic: str
    type: str
    role: str
    count: int
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    median_period_s: float | None = None
    longest_gap_s: float | None = None
    image: str = ""  # e.g. "752x480 jpeg"


@dataclass(frozen=True)
class RecordingInfo:
    path: str
    kind: str
    first_ns: int | None
    last_ns: int | None
    streams: tuple[StreamInfo, ...]
    anomalies: tuple[Anomaly, ...]
    counts: dict[str, int]  # anomalies of each kind, also those not listed
    modes: tuple[ModeInfo, ...] = ()
    gps: str = ""  # whether its fixes can be fused, one sentence; empty where it has none

    @property
    def duration_s(self) -> float:
        return 0.0 if self.first_ns is None or self.last_ns is None else (self.last_ns - self.first_ns) * 1e-9

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dataclasses.asdict(self) | {"duration_s": self.duration_s}


def inspect(
    recording: Recording, progress: Callable[[float], None] | None = None, calibration: Calibration | None = None
) -> RecordingInfo:
    """Read all stamps and IMU samples once.  `progress` gets the share that is done, about a hundred times.

    With a calibration of two cameras, images that have no partner are anomalies, too.
    """
    readable = {s.topic: s for s in recording.streams if s.count and s.role in READABLE}
    watches = {topic: _watch(stream) for topic, stream in readable.items()}
    total = sum(s.count for s in readable.values())
    bare: dict[str, list[ImageStub]] = {s.topic: [] for s in recording.of_role("image")}
    pairs = _pairs(recording, calibration)
    for done, item in enumerate(recording.scan(list(readable))):
        if pairs:
            pairs.see(item.t_ns, item.topic)
        watch = watches[item.topic]
        if isinstance(watch, ImuWatch) and isinstance(item, ImuMessage):
            watch.see_sample(item)
        else:
            watch.see(item.t_ns)
        if isinstance(item, ImageStub) and item.topic in bare and not bare[item.topic]:
            bare[item.topic].append(item)
        if progress and done % (total // 100 + 1) == 0:
            progress(done / total)
    found = [a for watch in watches.values() for a in watch.found] + _overlap(recording)
    found += pairs.finish() if pairs else []
    found.sort(key=lambda a: a.t_ns)
    times = [t for s in recording.streams for t in (s.first_ns, s.last_ns) if t is not None]
    return RecordingInfo(
        str(recording.path),
        recording.kind,
        min(times, default=None),
        max(times, default=None),
        tuple(_stream_info(recording, s, watches.get(s.topic), bare.get(s.topic, [])) for s in recording.streams),
        _first_of_each(found),
        dict(Counter(a.kind for a in found)),
        inspect_modes(recording, calibration),
        _gps(recording, calibration),
    )


def _gps(recording: Recording, calibration: Calibration | None) -> str:
    topics = recording.topics_of("gps")
    if not topics:
        return ""
    if calibration is None:
        return f"GPS: fixes of {' and '.join(topics)}; whether they can be fused, a calibration tells (--calib)"
    chosen = available.choose_topic(calibration, topics)
    sentences = available.missing(Gps(), chosen, topics)
    if sentences or chosen.p_b_gps is None:
        return " ".join(sentences)
    place = ", ".join(f"{v:g}" for v in chosen.p_b_gps)
    return f"GPS: fixes of {chosen.gps_topic} are fused, from an antenna at ({place}) m on the body"


def _pairs(recording: Recording, calibration: Calibration | None) -> PairWatch | None:
    if calibration is None or len(calibration.cameras) < 2:
        return None
    recording.use(calibration)
    try:
        left, right = recording.image_topics[:2]
    except RecordingError:  # what is missing is told with the modes
        return None
    offset_ns = round((calibration.td_of(0) - calibration.td_of(1)) * 1e9)
    return PairWatch(left, right, STEREO_TOLERANCE_NS, offset_ns)


def _watch(stream: Stream) -> StampWatch:
    if stream.role == "imu":
        return ImuWatch(stream.topic, stream.rate_hz)
    if stream.role == "image":
        return image_watch(stream.topic, stream.rate_hz)
    return StampWatch(stream.topic, stream.rate_hz)


def _stream_info(recording: Recording, s: Stream, watch: StampWatch | None, images: list[ImageStub]) -> StreamInfo:
    info = StreamInfo(s.topic, s.type, s.role, s.count, s.first_ns, s.last_ns, s.rate_hz)
    if watch is not None:
        info = dataclasses.replace(info, median_period_s=watch.median_period_s, longest_gap_s=watch.longest_s)
    if images:
        info = dataclasses.replace(info, image=recording.describe_image(images[0]))
    return info


def _overlap(recording: Recording) -> list[Anomaly]:
    """Images that no IMU can cover, where there is just one IMU to ask."""
    imus = recording.of_role("imu")
    if len(imus) != 1 or imus[0].first_ns is None or imus[0].last_ns is None:
        return []
    found = []
    for s in recording.of_role("image"):
        if s.first_ns is None or s.last_ns is None:
            continue
        if s.last_ns < imus[0].first_ns or s.first_ns > imus[0].last_ns:
            text = f"{s.topic} and {imus[0].topic} do not overlap in time"
            found.append(Anomaly("no_imu", s.first_ns, s.topic, text))
            continue
        if s.first_ns < imus[0].first_ns:
            early = (imus[0].first_ns - s.first_ns) * 1e-9
            text = f"{s.topic} begins {early:.3f} s before {imus[0].topic}; those images are left out"
            found.append(Anomaly("no_imu", s.first_ns, s.topic, text))
        if s.last_ns > imus[0].last_ns:
            late = (s.last_ns - imus[0].last_ns) * 1e-9
            text = f"{s.topic} ends {late:.3f} s after {imus[0].topic}; those images are left out"
            found.append(Anomaly("no_imu", imus[0].last_ns, s.topic, text))
    return found


def _first_of_each(found: list[Anomaly]) -> tuple[Anomaly, ...]:
    seen: Counter[tuple[str, str]] = Counter()
    listed = []
    for anomaly in found:
        seen[anomaly.kind, anomaly.topic] += 1
        if seen[anomaly.kind, anomaly.topic] <= MAX_LISTED:
            listed.append(anomaly)
    return tuple(listed)
