"""Images that were taken together: the right one of a pair, the depth with its image."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from ..sensors import Anomaly
from .anomalies import StampWatch

UNSYNCHRONIZED = "unsynchronized"


class _Stamped(Protocol):
    @property
    def t_ns(self) -> int: ...


T = TypeVar("T", bound=_Stamped)


class Companions(Generic[T]):
    """Gives each image of a camera the nearest companion within a tolerance, each companion at most once.

    Images are asked for in the order of time.  What stays alone, on either side, is noted.
    """

    def __init__(
        self, topic: str, watch: StampWatch, tolerance_ns: int, offset_ns: int = 0, may_be_missing: bool = False
    ) -> None:
        """A companion is taken together with an image when its stamp is the image's plus `offset_ns`.

        `watch` looks at the companions' stamps.  `may_be_missing`: do not note what stays alone.
        """
        self._topic, self._watch = topic, watch
        self._tolerance_ns, self._offset_ns = tolerance_ns, offset_ns
        self._may_be_missing = may_be_missing
        self._waiting: deque[T] = deque()
        self._reached_ns = -(2**63)
        self._begun = False

    def add(self, companion: T) -> None:
        if self._watch.see(companion.t_ns):
            self._waiting.append(companion)

    def reach(self, t_ns: int) -> None:
        """Nothing older than `t_ns` is to be expected any more."""
        self._reached_ns = max(self._reached_ns, t_ns)

    def is_decided(self, t_ns: int) -> bool:
        """Whether nothing that may still come could be nearer to an image at `t_ns`."""
        wanted = t_ns + self._offset_ns
        return self._reached_ns > wanted + self._tolerance_ns or (
            bool(self._waiting) and self._waiting[-1].t_ns >= wanted
        )

    def take(self, t_ns: int) -> T | None:
        """The companion of the image at `t_ns`."""
        wanted, companion_topic = t_ns + self._offset_ns, self._watch.topic
        while self._waiting and self._waiting[0].t_ns < wanted - self._tolerance_ns:
            alone = self._waiting.popleft()
            if self._begun:  # those from before the first image are nobody's
                self._note(alone.t_ns, companion_topic, self._topic)
        self._begun = True
        best: T | None = None
        while self._waiting and abs(self._waiting[0].t_ns - wanted) <= self._tolerance_ns:
            if best is not None and abs(self._waiting[0].t_ns - wanted) >= abs(best.t_ns - wanted):
                break
            best = self._waiting.popleft()
        if best is None:
            self._note(t_ns, self._topic, companion_topic)
        return best

    def take_notes(self) -> list[Anomaly]:
        return self._watch.take()

    def _note(self, t_ns: int, topic: str, other: str) -> None:
        if not self._may_be_missing:
            limit_ms = self._tolerance_ns * 1e-6
            text = f"the image of {topic} at {t_ns} ns has none of {other} within {limit_ms:g} ms"
            self._watch.found.append(Anomaly(UNSYNCHRONIZED, t_ns, topic, text))


@dataclass(frozen=True)
class _Stamp:
    t_ns: int


class PairWatch:
    """Notes the images of two cameras that have no partner, from their stamps in the order of time."""

    def __init__(self, left: str, right: str, tolerance_ns: int, offset_ns: int = 0) -> None:
        self._left, self._right = left, right
        self._companions: Companions[_Stamp] = Companions(left, StampWatch(right, None), tolerance_ns, offset_ns)
        self._waiting: deque[int] = deque()

    def see(self, t_ns: int, topic: str) -> None:
        """Any message: what is not of the two cameras tells the time."""
        self._companions.reach(t_ns)
        if topic == self._right:
            self._companions.add(_Stamp(t_ns))
        elif topic == self._left and (not self._waiting or t_ns > self._waiting[-1]):
            self._waiting.append(t_ns)
        while self._waiting and self._companions.is_decided(self._waiting[0]):
            self._companions.take(self._waiting.popleft())

    def finish(self) -> list[Anomaly]:
        """All that was noted, once every message has been seen."""
        while self._waiting:
            self._companions.take(self._waiting.popleft())
        return [note for note in self._companions.take_notes() if note.kind == UNSYNCHRONIZED]
