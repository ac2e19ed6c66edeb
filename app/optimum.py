"""Is this the optimum?  The window of a frame through IPOPT, in a thread, when somebody asks (SPEC 5.3)."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass

from vins_core.errors import RunError, VinspectError
from vins_core.examine import solved_window
from vins_core.record.reader import RunReader
from vins_core.solver.ipopt import Comparison, compare_optimum
from vins_core.solver.trust_region import rules

from .context import RunView

log = logging.getLogger("vinspect")


@dataclass(frozen=True)
class OptimumView:
    """What is known about one frame's window."""

    frame: int
    comparison: Comparison | None = None
    landmarks: tuple[int, ...] = ()  # track ids in the order of the comparison's inverse depths
    frames: tuple[int, ...] = ()  # of its slots
    busy: bool = False
    problem: str = ""


class Optimum:
    """The last question of a tab and its answer."""

    def __init__(self, on_answer: Callable[[], None]) -> None:
        self._on_answer = on_answer
        self._run: RunView | None = None
        self._view: OptimumView | None = None
        self._task: asyncio.Task[None] | None = None

    def ask(self, run: RunView, frame: int) -> None:
        if self._task is None:
            self._run, self._view = run, OptimumView(frame, busy=True)
            self._task = asyncio.get_running_loop().create_task(self._work(run, frame))

    def look(self, run: RunView, frame: int) -> OptimumView | None:
        """The answer about this frame, None when it was not asked about."""
        view = self._view
        return view if view is not None and self._run is run and view.frame == frame else None

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()

    async def _work(self, run: RunView, frame: int) -> None:
        try:
            self._view = await asyncio.to_thread(compared, run.reader, frame)
        except VinspectError as problem:
            self._view = OptimumView(frame, problem=str(problem))
        except Exception as problem:
            log.exception("optimum of frame %d", frame)
            self._view = OptimumView(frame, problem=f"IPOPT could not solve this window ({problem}).")
        finally:
            self._task = None
            self._on_answer()


def compared(run: RunReader, frame: int) -> OptimumView:
    turn = solved_window(run, frame)
    if turn is None:
        raise RunError(f"frame {frame} was not solved: the estimator is {run.report(frame).status}")
    solved, holds = turn.solved, rules(run.header.params_at(frame).solver).holds_gauge
    found = compare_optimum(solved.assembly.problem, solved.solution, holds)
    ids = tuple(solved.assembly.ids.tolist())
    return OptimumView(frame, found, ids, tuple(f.frame for f in solved.window.frames))
