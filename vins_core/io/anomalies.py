"""Watchers that read along with a stream of stamps or samples and say what a careful user wants to know (SPEC 1.3).

Each `see` returns whether the sample may be used; what it noticed waits in `found`.
"""

from __future__ import annotations

import numpy as np

from ..sensors import Anomaly
from .messages import ImuMessage

GAP_FACTOR = 2.5  # a stamp this many periods after the last one is a gap: at least one sample is missing
RATE_TOLERANCE = 0.2
RATE_WINDOW = 50
UNIT_WINDOW = 200


class StampWatch:
    """Order, gaps and rate of one topic's stamps."""

    def __init__(
        self, topic: str, rate_hz: float | None, gap_kind: str = "gap", gap_factor: float = GAP_FACTOR
    ) -> None:
        self.topic = topic
        self.found: list[Anomaly] = []
        self.last_ns: int | None = None
        self.after_gap = False
        """Whether samples are missing before the newest one."""
        self._period_ns = 1e9 / rate_hz if rate_hz else None  # the mean, until a median is known
        self._measured = False
        self._gap_kind = gap_kind
        self._gap_factor = gap_factor
        self._steps: list[int] = []
        self._longest_ns = 0
        self._going_back = False

    def note(self, kind: str, t_ns: int, message: str) -> None:
        self.found.append(Anomaly(kind, t_ns, self.topic, message))

    @property
    def longest_s(self) -> float | None:
        """The longest time between two samples so far."""
        return self._longest_ns * 1e-9 if self._longest_ns else None

    @property
    def median_period_s(self) -> float | None:
        """Over the newest samples; the mean period before there are enough of them."""
        return self._period_ns * 1e-9 if self._period_ns else None

    def take(self) -> list[Anomaly]:
        found, self.found = self.found, []
        return found

    def see(self, t_ns: int) -> bool:
        """False for a stamp that repeats or goes back."""
        last = self.last_ns
        if last is not None and t_ns <= last:
            if t_ns == last:
                self.note("duplicate", t_ns, f"{self.topic} repeats the stamp {t_ns} ns; the later sample is dropped")
            elif not self._going_back:
                back = (last - t_ns) * 1e-9
                self._going_back = True
                self.note(
                    "reversal",
                    t_ns,
                    f"{self.topic} goes back by {back:.6g} s to {t_ns} ns; samples are dropped until time advances",
                )
            return False
        self._going_back = False
        self.after_gap = False
        if last is not None:
            self._step(t_ns, t_ns - last)
        self.last_ns = t_ns
        return True

    def _step(self, t_ns: int, step: int) -> None:
        self._longest_ns = max(self._longest_ns, step)
        if self._period_ns and step > self._gap_factor * self._period_ns:
            missing = round(step / self._period_ns) - 1
            self.after_gap = True
            self.note(
                self._gap_kind,
                t_ns,
                f"{self.topic} is silent for {step * 1e-9:.3f} s before {t_ns} ns: about {missing} samples are missing",
            )
            return
        self._steps.append(step)
        if len(self._steps) < RATE_WINDOW:
            return
        period = float(np.median(self._steps))
        self._steps.clear()
        if self._measured and self._period_ns and abs(period / self._period_ns - 1) > RATE_TOLERANCE:
            self.note(
                "rate_change",
                t_ns,
                f"{self.topic} changes from {1e9 / self._period_ns:.4g} to {1e9 / period:.4g} Hz before {t_ns} ns",
            )
        self._period_ns, self._measured = period, True


def image_watch(topic: str, rate_hz: float | None) -> StampWatch:
    """A camera's watch: one missing image is already worth a note."""
    return StampWatch(topic, rate_hz, "dropped_image", gap_factor=1.6)


class ImuWatch(StampWatch):
    """Stamps, and whether the values can be rad/s and m/s^2 of a working IMU."""

    def __init__(self, topic: str, rate_hz: float | None) -> None:
        super().__init__(topic, rate_hz)
        self._first: list[np.ndarray] = []

    def see_sample(self, sample: ImuMessage) -> bool:
        values = np.concatenate([sample.gyro_rad_s, sample.accel_m_s2])
        if not np.all(np.isfinite(values)):
            self.note(
                "nan", sample.t_ns, f"{self.topic} has a value that is no number at {sample.t_ns} ns; it is dropped"
            )
            return False
        if not self.see(sample.t_ns):
            return False
        if len(self._first) < UNIT_WINDOW:
            self._first.append(values)
            if len(self._first) == UNIT_WINDOW:
                self._judge(sample.t_ns, np.array(self._first))
        return True

    def _judge(self, t_ns: int, first: np.ndarray) -> None:
        gyro, accel = (float(np.median(np.linalg.norm(part, axis=1))) for part in (first[:, :3], first[:, 3:]))
        if 0.7 < accel < 1.4:
            text = f"the median acceleration is {accel:.3g}: that looks like g, expected m/s^2 (about 9.8)"
            self.note("unit_suspicion", t_ns, f"{self.topic}: {text}")
        elif not 4.0 < accel < 25.0:
            text = f"the median acceleration is {accel:.3g} m/s^2, expected about 9.8: wrong unit, or gravity removed"
            self.note("unit_suspicion", t_ns, f"{self.topic}: {text}")
        if gyro > 6.0:
            text = f"the median turn rate is {gyro:.3g}: that looks like deg/s, expected rad/s"
            self.note("unit_suspicion", t_ns, f"{self.topic}: {text}")
        names = [f"{sensor} {axis}" for sensor in ("gyroscope", "accelerometer") for axis in "xyz"]
        frozen = [name for name, spread in zip(names, np.ptp(first, axis=0)) if spread == 0.0]
        if frozen:
            text = f"{', '.join(frozen)} never changes over {len(first)} samples: is that axis connected?"
            self.note("axis_suspicion", t_ns, f"{self.topic}: {text}")
