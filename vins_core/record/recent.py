"""What was read last, bounded in number and in bytes: a hostile record can be large, but not in memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
T = TypeVar("T")

MAX_BYTES = 256 * 1024 * 1024


class Recent(Generic[K, T]):
    """A function, of a frame number as a rule, whose last results are kept.  Safe to call from several threads.

    `make(k)` gives the result and the bytes that it may occupy.
    """

    def __init__(self, make: Callable[[K], tuple[T, int]], keep: int, max_bytes: int = MAX_BYTES) -> None:
        self._make, self._keep, self._max_bytes = make, keep, max_bytes
        self._held: OrderedDict[K, tuple[T, int]] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def __call__(self, k: K) -> T:
        with self._lock:
            if k in self._held:
                self._held.move_to_end(k)
                return self._held[k][0]
        value, size = self._make(k)
        with self._lock:
            if k not in self._held:
                self._held[k] = value, size
                self._bytes += size
            while len(self._held) > self._keep or (self._bytes > self._max_bytes and self._held):
                self._bytes -= self._held.popitem(last=False)[1][1]
        return value
