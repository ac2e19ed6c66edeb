"""Something slow about the frame shown, worked out in a thread: the latest wish wins, stepping never waits."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

from vins_core.errors import VinspectError

from .context import RunView

log = logging.getLogger("vinspect")
Answer = TypeVar("Answer")
SETTLE_S = 0.12
"""A frame is worked on once it has been looked at for so long."""


class Latest(Generic[Answer]):
    """`work(run, frame, ...)` gives the answer; `on_answer` is called in the event loop when there is one."""

    def __init__(self, work: Callable[..., Answer | None], on_answer: Callable[[], None]) -> None:
        self._work, self._on_answer = work, on_answer
        self._asked: tuple[Any, ...] | None = None
        self._done: tuple[Any, ...] | None = None
        self._answer: Answer | None = None
        self._task: asyncio.Task[None] | None = None

    def look(self, run: RunView, frame: int, *more: Hashable) -> Answer | None:
        """The answer about this frame and whatever else is asked; while there is none, it is asked for."""
        if self._done == (run, frame, *more):
            return self._answer
        self._asked = run, frame, *more
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._loop())
        return None

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()

    async def _loop(self) -> None:
        try:
            while self._asked is not None and self._asked != self._done:
                asked = self._asked
                await asyncio.sleep(SETTLE_S)
                if asked != self._asked:
                    continue
                try:
                    self._answer = await asyncio.to_thread(self._work, *asked)
                except VinspectError:
                    self._answer = None
                except Exception:
                    log.exception("frame %d", asked[1])
                    self._answer = None
                self._done = asked
                self._on_answer()
        finally:
            self._task = None
