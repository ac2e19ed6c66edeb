"""Is this the optimum?  The window of a frame through IPOPT, in a thread, when somebody asks (SPEC 5.3)."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

from vins_core.errors import RunError, VinspectError
from vins_core.pipeline import receive
from vins_core.record.fork import state_before
from vins_core.record.recording import RunReader
from vins_core.solver import backend
from vins_core.solver.ipopt import Comparison, compare_optimum
from vins_core.solver.trust_region import rules
from vins_core.whatif import recorded_tracks
from vins_core.window.step import Solved, solve_window

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


def solve_recorded(run: RunReader, k: int) -> Solved:
    """The solve of frame k once more, from the record; RunError when there was none."""
    params, calibration = run.header.params_at(k), run.header.calibration
    state, packet = state_before(run, k), run.packet(k)
    with backend.using(backend.recorded(run.header.backend)):
        arrived = receive(params, calibration, state, packet, recorded_tracks(run, k, params), {})
        if not arrived.ready:
            raise RunError(f"frame {k} was not solved: the estimator is {arrived.report.status}")
        return solve_window(params, arrived.calibration, arrived.state.window, {})


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
    turn = solve_recorded(run, frame)
    holds = rules(run.header.params_at(frame).solver).holds_gauge
    found = compare_optimum(turn.assembly.problem, turn.solution, holds)
    ids = tuple(turn.assembly.ids.tolist())
    return replace(
        OptimumView(frame), comparison=found, landmarks=ids, frames=tuple(f.frame for f in turn.window.frames)
    )
