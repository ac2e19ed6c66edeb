"""The only clock of the core: milliseconds per stage, kept beside a report and never in it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from .report import Timings


@contextmanager
def stopwatch(ms: Timings, stage: str) -> Iterator[None]:
    """Add the time spent inside to `ms[stage]`."""
    start = time.perf_counter()
    try:
        yield
    finally:
        ms[stage] = ms.get(stage, 0.0) + 1e3 * (time.perf_counter() - start)
