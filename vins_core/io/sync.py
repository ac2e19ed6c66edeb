"""From a recording to packets: which images are frames, and what else arrived between them (REFERENCE T2, S1-S3)."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..errors import CalibrationError, RecordingError
from ..params import Params
from ..sensors import Anomaly, Calibration, DepthRef, GpsFix, ImageRef, ImuSamples, Packet
from .anomalies import ImuWatch, StampWatch, image_watch
from .companions import Companions
from .messages import ImuMessage
from .recording import Recording

LEAD_IN_NS = 10 * 10**9
"""How much IMU before its frame the first packet holds at most."""
STEREO_TOLERANCE_NS = 3_000_000
"""Largest difference between the stamps of a pair (VINS-Fusion: 0.003 s)."""


@dataclass
class TimeOffset:
    """The td that the next packet is cut by: a run that estimates it sets it after each frame (REFERENCE S6)."""

    td_s: float


class FrequencyControl:
    """T2: an image becomes a frame while the achieved rate stays at or below `freq`; depends on stamps alone.

    With n frames (counting from 1) since a clock of t0, an image at t is one when round(n / (t - t0)) <= freq.  When
    the achieved rate is within 1 % of freq the clock restarts at t.  The first image only sets the clock.
    """

    def __init__(self, freq: float, max_gap_s: float) -> None:
        self.freq = freq
        self.max_gap_ns = round(max_gap_s * 1e9)
        self.clock_ns: int | None = None
        self.last_ns = 0
        self.count = 1

    def is_due(self, t_ns: int) -> bool:
        """Whether the image at t_ns shall be a frame; call once per image, in order."""
        gap = self.clock_ns is not None and t_ns - self.last_ns > self.max_gap_ns
        self.last_ns = t_ns
        if self.clock_ns is None or gap:
            self.clock_ns, self.count = t_ns, 1
            return False
        return math.floor(self._rate(t_ns) + 0.5) <= self.freq  # halves round up, as in C

    def publish(self, t_ns: int) -> None:
        """The image at t_ns has become a frame."""
        if abs(self._rate(t_ns) - self.freq) < 0.01 * self.freq:
            self.clock_ns, self.count = t_ns, 0
        self.count += 1

    def _rate(self, t_ns: int) -> float:
        assert self.clock_ns is not None
        return self.count / ((t_ns - self.clock_ns) * 1e-9)


class ImuQueue:
    """IMU samples that later packets still need."""

    def __init__(self) -> None:
        self._t_ns: list[int] = []
        self._values: list[np.ndarray] = []
        self._after_gap: list[bool] = []

    def append(self, sample: ImuMessage, after_gap: bool) -> None:
        self._t_ns.append(sample.t_ns)
        self._values.append(np.concatenate([sample.gyro_rad_s, sample.accel_m_s2]))
        self._after_gap.append(after_gap)

    def reaches(self, t_ns: int) -> bool:
        return bool(self._t_ns) and self._t_ns[-1] >= t_ns

    def starts_after(self, t_ns: int) -> bool:
        return bool(self._t_ns) and self._t_ns[0] > t_ns

    def in_gap(self, t_ns: int) -> bool:
        """Whether samples are missing around a time that the queue reaches."""
        i = bisect_left(self._t_ns, t_ns)
        return self._t_ns[i] != t_ns and self._after_gap[i]

    def cut(self, t_ns: int) -> ImuSamples:
        """All samples up to t_ns, the last one interpolated there if need be; it stays as the next one's first."""
        i = bisect_left(self._t_ns, t_ns)
        if self._t_ns[i] != t_ns:
            t0, t1 = self._t_ns[i - 1], self._t_ns[i]
            w = (t_ns - t0) / (t1 - t0)
            self._t_ns.insert(i, t_ns)
            self._values.insert(i, (1.0 - w) * self._values[i - 1] + w * self._values[i])
            self._after_gap.insert(i, self._after_gap[i])
        values = np.array(self._values[: i + 1])
        samples = ImuSamples(np.array(self._t_ns[: i + 1], np.int64), values[:, :3].copy(), values[:, 3:].copy())
        self._forget(i)
        return samples

    def forget_before(self, t_ns: int) -> None:
        """Drop what is older, but keep the last sample at or before t_ns."""
        if self._t_ns and self._t_ns[0] < t_ns:
            self._forget(max(bisect_right(self._t_ns, t_ns) - 1, 0))

    def _forget(self, n: int) -> None:
        del self._t_ns[:n], self._values[:n], self._after_gap[:n]


def packets(
    recording: Recording,
    calibration: Calibration,
    params: Params,
    start_s: float | None = None,
    duration_s: float | None = None,
    offset: TimeOffset | None = None,
) -> Iterator[Packet]:
    """Frames with what belongs to them, streaming; `start_s` and `duration_s` count from the first image.

    `offset`: the time offset to follow, by default that of the calibration throughout.
    Uses the topics that the calibration names.  Raises RecordingError when images and IMU do not overlap and
    CalibrationError when the images have another size than the calibrated camera, both before the first packet.
    """
    recording.use(calibration)
    first = _check(recording, calibration)
    start_ns = first.t_ns + round((start_s or 0.0) * 1e9)
    stop_ns = None if duration_s is None else start_ns + round(duration_s * 1e9)
    offset = offset or TimeOffset(calibration.td_of(0))
    return _packets(recording, calibration, params, start_ns, stop_ns, offset)


def _check(recording: Recording, calibration: Calibration) -> ImageRef:
    """The first image, once it is clear that the recording and the calibration go together."""
    if calibration.has_imu:
        _check_overlap(recording, round(calibration.td_of(0) * 1e9))
    firsts = [next(recording.images(i)) for i in range(len(calibration.cameras))]
    for first, camera, topic in zip(firsts, calibration.cameras, recording.image_topics):
        rows, columns = recording.load(first).shape
        if (columns, rows) != (camera.model.width, camera.model.height):
            raise CalibrationError(
                f"{recording.path}: images of {topic} are {columns}x{rows}, but the calibration "
                f"({', '.join(calibration.sources) or 'given'}) is for {camera.model.width}x{camera.model.height}; "
                "use the calibration of this camera at this resolution"
            )
    return firsts[0]


def _check_overlap(recording: Recording, td_ns: int) -> None:
    images, imu = recording.stream(recording.image_topics[0]), recording.stream(recording.imu_topic)
    assert images.first_ns is not None and images.last_ns is not None
    assert imu.first_ns is not None and imu.last_ns is not None
    if imu.last_ns < images.first_ns + td_ns or imu.first_ns > images.last_ns + td_ns:
        raise RecordingError(
            f"{recording.path}: {imu.topic} ({_span(imu.first_ns, imu.last_ns)}) and {images.topic} "
            f"({_span(images.first_ns, images.last_ns)}) do not overlap in time: "
            "check that both are stamped by the same clock, and td in the calibration"
        )


def _packets(
    recording: Recording,
    calibration: Calibration,
    params: Params,
    start_ns: int,
    stop_ns: int | None,
    offset: TimeOffset,
) -> Iterator[Packet]:
    assembler = _Assembler(recording, calibration, params, offset)
    held: Packet | None = None  # the newest packet, so that what is noticed after the last frame is not lost
    over = False
    for event in recording.events():
        assembler.reach(event.t_ns)
        if isinstance(event, ImuMessage):
            assembler.add_sample(event)
        elif isinstance(event, GpsFix):
            assembler.add_fix(event, start_ns)
        elif isinstance(event, DepthRef) or event.camera:
            assembler.add_companion(event)
        elif stop_ns is not None and event.t_ns > stop_ns:
            over = True
        elif event.t_ns >= start_ns:
            assembler.add_image(event)
        for packet in assembler.frames():
            if held:
                yield held
            held = packet
        if over and not assembler.waiting:
            break
    assembler.finish()
    for packet in assembler.frames():
        if held:
            yield held
        held = packet
    if held is None:
        images, imu = assembler.image_stream, assembler.imu_stream
        if imu is None:
            raise RecordingError(f"{recording.path}: no image of {images.topic} in the chosen time: check --start")
        raise RecordingError(
            f"{recording.path}: no image of {images.topic} in the chosen time has IMU samples on both sides; "
            f"{imu.topic} covers {_span(imu.first_ns, imu.last_ns)}: check --start, --duration and td"
        )
    yield replace(held, anomalies=held.anomalies + assembler.last_words())


class _Assembler:
    """Images wait here until the IMU has reached them; those that are frames leave as packets."""

    def __init__(self, recording: Recording, calibration: Calibration, params: Params, offset: TimeOffset) -> None:
        self.image_stream = recording.stream(recording.image_topics[0])
        self.imu_stream = recording.stream(recording.imu_topic) if calibration.has_imu else None
        self.waiting: deque[ImageRef] = deque()
        self._offset = offset
        self._half_readout_s = 0.5 * calibration.cameras[0].readout_s if params.online.rolling_shutter else 0.0
        self._images_watch = image_watch(self.image_stream.topic, self.image_stream.rate_hz)
        self._imu_watch = ImuWatch(self.imu_stream.topic, self.imu_stream.rate_hz) if self.imu_stream else None
        gps = recording.gps_topic
        self._gps_watch = StampWatch(gps or "", recording.stream(gps).rate_hz if gps else None)
        self._control = FrequencyControl(params.frontend.freq, params.frontend.max_gap_s)
        self._imu = ImuQueue()
        self._right, self._depth = _right(recording, calibration), _depth(recording, calibration)
        self._companions = [companions for companions in (self._right, self._depth) if companions]
        self._watches = [watch for watch in (self._imu_watch, self._images_watch, self._gps_watch) if watch]
        self._fixes: deque[GpsFix] = deque()
        self._early: list[ImageRef] = []  # images from before the IMU begins
        self._images: list[ImageRef] = []  # images since the last frame
        self._depths: list[DepthRef | None] = []  # of camera 0's
        self._anomalies: list[Anomaly] = []
        self._frame = 0

    @property
    def _td_ns(self) -> int:
        """From the stamp of an image to the time of its middle row on the IMU's clock."""
        return round((self._offset.td_s + self._half_readout_s) * 1e9)

    def add_sample(self, sample: ImuMessage) -> None:
        assert self._imu_watch is not None
        if self._imu_watch.see_sample(sample):
            self._imu.append(sample, self._imu_watch.after_gap)
        if self._frame == 0:
            oldest = self.waiting[0].t_ns + self._td_ns if self.waiting else sample.t_ns
            self._imu.forget_before(oldest - LEAD_IN_NS)

    def add_fix(self, fix: GpsFix, start_ns: int) -> None:
        place = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        if not np.all(np.isfinite(place)):
            if fix.status >= 0:  # a receiver without a fix has no place to tell
                topic = self._gps_watch.topic
                text = f"{topic} has a place that is no number at {fix.t_ns} ns; it is dropped"
                self._gps_watch.note("nan", fix.t_ns, text)
        elif fix.t_ns >= start_ns and self._gps_watch.see(fix.t_ns):
            self._fixes.append(fix)

    def add_image(self, image: ImageRef) -> None:
        if self._images_watch.see(image.t_ns):
            self.waiting.append(image)

    def add_companion(self, companion: ImageRef | DepthRef) -> None:
        if isinstance(companion, DepthRef):
            if self._depth:
                self._depth.add(companion)
        elif self._right:
            self._right.add(companion)

    def reach(self, t_ns: int) -> None:
        """Nothing older than this will come (but for stamps that go back)."""
        for companions in self._companions:
            companions.reach(t_ns)

    def finish(self) -> None:
        """Nothing at all will come."""
        self.reach(2**63 - 1)

    def frames(self) -> Iterator[Packet]:
        """Packets of the waiting images that the IMU has reached."""
        while self.waiting and self._is_complete(self.waiting[0]):
            image = self.waiting.popleft()
            self._take_notes()
            t_imu = image.t_ns + self._td_ns
            if self.imu_stream and self._imu.starts_after(t_imu):
                self._early.append(image)
                continue
            if self._early:
                self._tell(self._early[0], f"the IMU begins later; {len(self._early)} images are left out")
                self._early.clear()
            self._add_to_frame(image)
            if not self._control.is_due(image.t_ns):
                continue
            if self.imu_stream and self._imu.in_gap(t_imu):
                self._tell(image, "samples are missing there; it is only tracked")
                continue
            self._control.publish(image.t_ns)
            yield Packet(
                self._frame,
                tuple(self._images),
                self._imu.cut(t_imu) if self.imu_stream else ImuSamples.empty(),
                tuple(self._anomalies),
                self._take_fixes(t_imu),
                tuple(self._depths),
            )
            self._frame += 1
            self._images, self._depths, self._anomalies = [], [], []

    def _is_complete(self, image: ImageRef) -> bool:
        """Whether all that belongs to an image has arrived."""
        if self.imu_stream and not self._imu.reaches(image.t_ns + self._td_ns):
            return False
        return all(companions.is_decided(image.t_ns) for companions in self._companions)

    def _add_to_frame(self, image: ImageRef) -> None:
        self._images.append(image)
        if self._right:
            right = self._right.take(image.t_ns)
            self._images += [right] if right else []
        if self._depth:
            self._depths.append(self._depth.take(image.t_ns))

    def _take_fixes(self, t_imu: int) -> tuple[GpsFix, ...]:
        taken = []
        while self._fixes and self._fixes[0].t_ns <= t_imu:
            taken.append(self._fixes.popleft())
        return tuple(taken)

    def last_words(self) -> tuple[Anomaly, ...]:
        """What was noticed after the last frame."""
        self._take_notes()
        if self.waiting:
            self._tell(self.waiting[0], f"it ends earlier; {len(self.waiting)} images are left out")
        return tuple(self._anomalies)

    def _take_notes(self) -> None:
        for watch in self._watches:
            self._anomalies += watch.take()
        for companions in self._companions:
            self._anomalies += companions.take_notes()

    def _tell(self, image: ImageRef, why: str) -> None:
        topic = self.image_stream.topic
        text = f"the image of {topic} at {image.t_ns} ns has no IMU: {why}"
        self._anomalies.append(Anomaly("no_imu", image.t_ns, topic, text))


def _right(recording: Recording, calibration: Calibration) -> Companions[ImageRef] | None:
    """The image of camera 1 that belongs to one of camera 0: taken within 3 ms of it."""
    topics = recording.image_topics
    if len(topics) == 1:
        return None
    offset_ns = round((calibration.td_of(0) - calibration.td_of(1)) * 1e9)
    stream = recording.stream(topics[1])
    return Companions(topics[0], image_watch(stream.topic, stream.rate_hz), STEREO_TOLERANCE_NS, offset_ns)


def _depth(recording: Recording, calibration: Calibration) -> Companions[DepthRef] | None:
    """The depth image that belongs to one of camera 0.  Depth may come more rarely than images."""
    wanted = calibration.cameras[0].depth
    if wanted is None:
        return None
    stream = recording.stream(recording.depth_topic)
    watch = StampWatch(stream.topic, stream.rate_hz)
    return Companions(recording.image_topics[0], watch, round(wanted.tolerance_s * 1e9), may_be_missing=True)


def _span(first_ns: int | None, last_ns: int | None) -> str:
    return "no samples" if first_ns is None or last_ns is None else f"{first_ns * 1e-9:.3f} to {last_ns * 1e-9:.3f} s"
