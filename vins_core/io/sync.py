"""From a recording to packets: which images are frames, and the IMU samples between them (REFERENCE T2, S1-S3)."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..errors import CalibrationError, RecordingError
from ..params import Params
from ..sensors import Anomaly, Calibration, ImageRef, ImuSamples, Packet
from .anomalies import ImuWatch, image_watch
from .messages import ImuMessage
from .recording import Recording

LEAD_IN_NS = 10 * 10**9
"""How much IMU before its frame the first packet holds at most."""


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
) -> Iterator[Packet]:
    """Frames with their IMU, streaming; `start_s` and `duration_s` count from the first image.

    Uses the topics that the calibration names.  Raises RecordingError when images and IMU do not overlap and
    CalibrationError when the images have another size than the calibrated camera, both before the first packet.
    """
    recording.use(calibration)
    td_ns = round(calibration.td_s * 1e9)
    first = _check(recording, calibration, td_ns)
    start_ns = first.t_ns + round((start_s or 0.0) * 1e9)
    stop_ns = None if duration_s is None else start_ns + round(duration_s * 1e9)
    return _packets(recording, params, td_ns, start_ns, stop_ns)


def _check(recording: Recording, calibration: Calibration, td_ns: int) -> ImageRef:
    """The first image, once it is clear that the recording and the calibration go together."""
    images, imu = recording.stream(recording.image_topics[0]), recording.stream(recording.imu_topic)
    assert images.first_ns is not None and images.last_ns is not None
    assert imu.first_ns is not None and imu.last_ns is not None
    if imu.last_ns < images.first_ns + td_ns or imu.first_ns > images.last_ns + td_ns:
        raise RecordingError(
            f"{recording.path}: {imu.topic} ({_span(imu.first_ns, imu.last_ns)}) and {images.topic} "
            f"({_span(images.first_ns, images.last_ns)}) do not overlap in time: "
            "check that both are stamped by the same clock, and td in the calibration"
        )
    first = next(recording.images(0))
    rows, columns = recording.load(first).shape
    model = calibration.cameras[0].model
    if (columns, rows) != (model.width, model.height):
        raise CalibrationError(
            f"{recording.path}: images of {images.topic} are {columns}x{rows}, but the calibration "
            f"({', '.join(calibration.sources) or 'given'}) is for {model.width}x{model.height}; "
            "use the calibration of this camera at this resolution"
        )
    return first


def _packets(recording: Recording, params: Params, td_ns: int, start_ns: int, stop_ns: int | None) -> Iterator[Packet]:
    assembler = _Assembler(recording, params, td_ns)
    held: Packet | None = None  # the newest packet, so that what is noticed after the last frame is not lost
    over = False
    for event in recording.events():
        if isinstance(event, ImuMessage):
            assembler.add_sample(event)
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
    if held is None:
        imu, images = assembler.imu_stream, assembler.image_stream
        raise RecordingError(
            f"{recording.path}: no image of {images.topic} in the chosen time has IMU samples on both sides; "
            f"{imu.topic} covers {_span(imu.first_ns, imu.last_ns)}: check --start, --duration and td"
        )
    yield replace(held, anomalies=held.anomalies + assembler.last_words())


class _Assembler:
    """Images wait here until the IMU has reached them; those that are frames leave as packets."""

    def __init__(self, recording: Recording, params: Params, td_ns: int) -> None:
        self.image_stream = recording.stream(recording.image_topics[0])
        self.imu_stream = recording.stream(recording.imu_topic)
        self.waiting: deque[ImageRef] = deque()
        self._td_ns = td_ns
        self._images_watch = image_watch(self.image_stream.topic, self.image_stream.rate_hz)
        self._imu_watch = ImuWatch(self.imu_stream.topic, self.imu_stream.rate_hz)
        self._control = FrequencyControl(params.frontend.freq, params.frontend.max_gap_s)
        self._imu = ImuQueue()
        self._early: list[ImageRef] = []  # images from before the IMU begins
        self._images: list[ImageRef] = []  # images since the last frame
        self._anomalies: list[Anomaly] = []
        self._frame = 0

    def add_sample(self, sample: ImuMessage) -> None:
        if self._imu_watch.see_sample(sample):
            self._imu.append(sample, self._imu_watch.after_gap)
        if self._frame == 0:
            oldest = self.waiting[0].t_ns + self._td_ns if self.waiting else sample.t_ns
            self._imu.forget_before(oldest - LEAD_IN_NS)

    def add_image(self, image: ImageRef) -> None:
        if image.camera == 0 and self._images_watch.see(image.t_ns):
            self.waiting.append(image)

    def frames(self) -> Iterator[Packet]:
        """Packets of the waiting images that the IMU has reached."""
        while self.waiting and self._imu.reaches(self.waiting[0].t_ns + self._td_ns):
            image = self.waiting.popleft()
            self._anomalies += self._imu_watch.take() + self._images_watch.take()
            t_imu = image.t_ns + self._td_ns
            if self._imu.starts_after(t_imu):
                self._early.append(image)
                continue
            if self._early:
                self._tell(self._early[0], f"the IMU begins later; {len(self._early)} images are left out")
                self._early.clear()
            self._images.append(image)
            if not self._control.is_due(image.t_ns):
                continue
            if self._imu.in_gap(t_imu):
                self._tell(image, "samples are missing there; it is only tracked")
                continue
            self._control.publish(image.t_ns)
            yield Packet(self._frame, tuple(self._images), self._imu.cut(t_imu), tuple(self._anomalies))
            self._frame += 1
            self._images, self._anomalies = [], []

    def last_words(self) -> tuple[Anomaly, ...]:
        """What was noticed after the last frame."""
        self._anomalies += self._imu_watch.take() + self._images_watch.take()
        if self.waiting:
            self._tell(self.waiting[0], f"it ends earlier; {len(self.waiting)} images are left out")
        return tuple(self._anomalies)

    def _tell(self, image: ImageRef, why: str) -> None:
        topic = self.image_stream.topic
        text = f"the image of {topic} at {image.t_ns} ns has no IMU: {why}"
        self._anomalies.append(Anomaly("no_imu", image.t_ns, topic, text))


def _span(first_ns: int | None, last_ns: int | None) -> str:
    return "no samples" if first_ns is None or last_ns is None else f"{first_ns * 1e-9:.3f} to {last_ns * 1e-9:.3f} s"
