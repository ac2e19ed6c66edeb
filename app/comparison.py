"""Two runs on one clock: which frame of B belongs to a frame of A, where B is in A's world, and what differs."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vins_core.errors import VinspectError
from vins_core.record.compare import Comparison, compare

from .context import RunView
from .runs import OpenRun
from .series import align_se3

log = logging.getLogger("vinspect")

FRESH_FRAMES = 40
"""A run that grows is compared again after so many frames."""


@dataclass(frozen=True)
class OtherRun:
    """Run B beside the run shown."""

    run: RunView
    id: str
    name: str
    growing: bool
    rows: np.ndarray  # (len(A),) frame of B at the same instant, -1 where there is none
    p_w_b: np.ndarray  # (len(B), 3) m, in A's world
    comparison: Comparison | None = None  # None while it is worked out
    problem: str = ""

    def at(self, frame: int) -> int | None:
        """B's frame at the instant of A's `frame`."""
        row = int(self.rows[frame]) if frame < len(self.rows) else -1
        return row if row >= 0 else None

    def on_clock(self, values: np.ndarray) -> np.ndarray:
        """B's values, one a frame, at the frames of A; NaN where B has none."""
        there = self.rows >= 0
        out = np.full((len(self.rows), *values.shape[1:]), np.nan)
        out[there] = values[self.rows[there]]
        return out


class Comparer:
    """What a tab compares its run with; `on_answer` is called when a comparison is done."""

    def __init__(self, on_answer: Callable[[], None]) -> None:
        self._on_answer = on_answer
        self._compared: tuple[object, ...] = ()
        self._result: Comparison | None = None
        self._problem = ""
        self._task: asyncio.Task[None] | None = None
        self._placed_for: tuple[object, ...] = ()
        self._placed = np.zeros(0, np.int64), np.zeros((0, 3))

    def look(self, first: RunView, second: OpenRun, name: str) -> OtherRun | None:
        """What is known of `second` beside `first`; None before its first frame."""
        view = second.view
        if view is None or view is first:
            return None
        key = (id(first), id(view), len(first), len(view), second.growing)
        if self._placed_for != key:
            self._placed_for = key
            self._placed = same_instants(first, view), in_world_of(first, view)
        stale = self._compared[:2] != key[:2]
        if stale:
            self._result, self._problem = None, ""
        grown = key[2] + key[3] - sum(self._compared[2:4]) if not stale else 1  # type: ignore[arg-type]
        if self._task is None and self._compared != key and (stale or not second.growing or grown >= FRESH_FRAMES):
            self._compared = key
            self._task = asyncio.get_running_loop().create_task(self._work(first, view, key))
        return OtherRun(view, second.id, name, second.growing, *self._placed, self._result, self._problem)

    @property
    def idle(self) -> bool:
        return self._task is None

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()

    async def _work(self, first: RunView, second: RunView, key: tuple[object, ...]) -> None:
        try:
            result = await asyncio.to_thread(compare, first.reader, second.reader)
            if self._compared[:2] == key[:2]:
                self._result = result
        except VinspectError as problem:
            self._problem = str(problem)
        except Exception as problem:
            log.exception("comparison")
            self._problem = f"The runs could not be compared ({problem})."
        finally:
            self._task = None
            self._on_answer()


def same_instants(first: RunView, second: RunView) -> np.ndarray:
    """(len(first),) the frame of `second` with the same stamp within half a frame, -1 where there is none."""
    a, b = (np.array([s.t_ns for s in run.summaries], np.int64) for run in (first, second))
    if not len(b) or not len(a):
        return np.full(len(a), -1)
    half = int(np.median(np.diff(a))) // 2 if len(a) > 1 else 50_000_000
    after = np.minimum(np.searchsorted(b, a), len(b) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(b[before] - a) <= np.abs(b[after] - a), before, after)
    return np.where(np.abs(b[nearest] - a) <= half, nearest, -1)


def in_world_of(first: RunView, second: RunView) -> np.ndarray:
    """(len(second), 3) positions of `second` in the world of `first`.

    A fork lives in the world of its run.  Runs that initialised apart are aligned where both have a pose.
    """
    p = second.series.p_w_b
    if related(first, second):
        return p
    rows = same_instants(first, second)
    there = rows >= 0
    mine, other = first.series.p_w_b[there], p[rows[there]]
    both = np.isfinite(mine).all(1) & np.isfinite(other).all(1)
    if both.sum() < 3:
        return p
    R, t = align_se3(other[both], mine[both])
    return p @ R.T + t


def related(first: RunView, second: RunView) -> bool:
    """Whether both carry the same initialisation: one began as the other, or both as a third, after it."""
    parents = [run.header.parent for run in (first, second)]
    family = [{run.header.id, *([p.id] if p else [])} for run, p in zip((first, second), parents)]
    if not family[0] & family[1]:
        return False
    begun = max((p.frame for p in parents if p), default=0)
    return bool(np.isfinite(first.series.p_w_b[:begun, 0]).any())
