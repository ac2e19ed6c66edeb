"""What-if in a tab: parameters other than the run's, and what they would have done (SPEC 9.3 a and b).

The knobs move here; every wish is computed in a thread, the latest one wins, and a result says what it belongs to, so
that the page never shows an answer to another question.  Stepping never waits for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vins_core import params as parameters
from vins_core.errors import ParameterError, VinspectError
from vins_core.io.params_yaml import read_params
from vins_core.params import Params
from vins_core.record.fork import recorded_images
from vins_core.record.reevaluate import Reevaluation
from vins_core.sensors import ImageSource
from vins_core.whatif import Effect, WhatIf, effect, needs_frontend, resolve

from .context import RunView

log = logging.getLogger("vinspect")

SETTLE_S = 0.12
"""A frame is solved again once it has been looked at for so long."""
FIRST_S = 0.005
"""Gates that were judged again are on their way to the page before a solve takes up the processor."""
BUSY_S = 0.1
"""That a question is worked on is said once it takes so long: most answers come sooner."""


@dataclass(frozen=True)
class Question:
    """What is asked: these changes to this frame of this run."""

    run: RunView
    frame: int
    changes: tuple[tuple[str, Any], ...]
    rerun: bool


@dataclass(frozen=True)
class Answer:
    """What came of a question; `problem` says why there is no `solved`."""

    question: Question
    judged: Reevaluation | None = None
    solved: WhatIf | None = None
    effect: Effect | None = None
    problem: str = ""


@dataclass(frozen=True)
class ExperimentView:
    """What the What-if panel shows."""

    params: Params  # as the knobs stand
    reference: Params  # of the run
    revision: int  # counts changes that the page does not know of yet
    rerun: bool  # the front end is run again
    judged: Reevaluation | None = None  # of these params
    solved: WhatIf | None = None  # of these params and the frame shown
    effect: Effect | None = None
    problem: str = ""
    busy: bool = False

    @property
    def changes(self) -> dict[str, Any]:
        return parameters.changed(self.params, self.reference)


class Experiment:
    """The knobs of one tab.  `refresh` is called in the event loop with the parts of the page that have news."""

    def __init__(self, refresh: Callable[..., None]) -> None:
        self._refresh = refresh
        self._reference = self._params = Params()
        self._run: RunView | None = None
        self._revision = 0
        self._rerun: bool | None = None  # None: when a parameter of the front end is changed
        self._answer: Answer | None = None
        self._tracked = False  # the last answer has tracks of its own, which the image shows
        self._asked: Question | None = None
        self._settled: tuple[RunView | None, int] = None, -1
        """The frame that was looked at long enough."""
        self._task: asyncio.Task[None] | None = None
        self._excuse: asyncio.TimerHandle | None = None
        self._images: ImageSource | None = None
        self._opened = contextlib.ExitStack()

    # -- the knobs ---------------------------------------------------------------------------------------------------

    def use(self, run: RunView) -> None:
        """Experiment with this run; changes that were made to another stay as they are."""
        if run is self._run:
            return
        changes = self.changes
        self._run, self._answer = run, None
        self._reference = run.header.params
        self._params = parameters.replace(self._reference, changes)
        self._revision += 1
        self._opened.close()
        self._images = None

    def set(self, key: str, value: Any) -> None:
        """Move a knob, None puts it back; ParameterError when it cannot stand there."""
        if value is None:
            value = parameters.get(self._reference, key)
        try:
            self._params = parameters.replace(self._params, {key: value})
        except VinspectError:
            self._revision += 1  # the page shows the wish: draw the knob where it stands
            raise

    def load(self, changes: dict[str, Any]) -> None:
        """Other changes in place of those made."""
        self._params = parameters.replace(self._reference, changes)
        self._revision += 1

    def reset(self) -> None:
        self.load({})

    def run_front_end(self, on: bool) -> None:
        self._rerun = on

    @property
    def params(self) -> Params:
        return self._params

    @property
    def changes(self) -> dict[str, Any]:
        return parameters.changed(self._params, self._reference)

    @property
    def rerun(self) -> bool:
        return needs_frontend(self.changes) if self._rerun is None else self._rerun

    # -- answers -----------------------------------------------------------------------------------------------------

    def ask(self, run: RunView, frame: int) -> None:
        """Work on what these knobs would do to a frame; gates that can be judged at once are."""
        self.use(run)
        question = Question(run, frame, tuple(self.changes.items()), self.rerun)
        if not question.changes or self._answered(question):
            return
        if run.gates.frames == len(run):
            self._judge(question)
        self._asked = question
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._work())

    def show(self) -> None:
        """The knobs have moved: draw what is known at once, that it is worked on only when that takes long."""
        answer = self._answer
        judged = answer.judged if answer and answer.question.changes == tuple(self.changes.items()) else None
        if not self.changes or (judged is not None and judged.gates):
            self._refresh("what_if")
        elif self._excuse is None or self._excuse.when() < asyncio.get_running_loop().time():
            self._excuse = asyncio.get_running_loop().call_later(BUSY_S, self._refresh, "what_if")

    def look(self, run: RunView, frame: int, *, asking: bool) -> ExperimentView:
        """What is known about a frame with these knobs; with `asking`, the rest is worked out."""
        self.use(run)
        if asking:
            self.ask(run, frame)
        question = Question(run, frame, tuple(self.changes.items()), self.rerun)
        view = ExperimentView(self._params, self._reference, self._revision, self.rerun)
        answer, busy = self._answer, self._task is not None and bool(question.changes) and not self._answered(question)
        if answer is None or answer.question.changes != question.changes:
            return replace(view, busy=busy)
        view = replace(view, judged=answer.judged)
        if answer.question != question:
            return replace(view, busy=busy)
        return replace(view, solved=answer.solved, effect=answer.effect, problem=answer.problem, busy=busy)

    def _answered(self, question: Question) -> bool:
        return self._answer is not None and self._answer.question == question

    @property
    def idle(self) -> bool:
        return self._task is None

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
        self._opened.close()

    async def _work(self) -> None:
        """Answer the latest question until there is none left."""
        try:
            while self._asked is not None and not self._answered(self._asked):
                question = self._asked
                await self._read_gates(question.run)
                if self._judge(question):
                    self._refresh("what_if")
                if (question.run, question.frame) != self._settled:
                    await asyncio.sleep(SETTLE_S)
                    if self._asked != question:
                        continue
                    self._settled = question.run, question.frame
                elif self._answer is not None and self._answer.judged is not None and self._answer.judged.gates:
                    await asyncio.sleep(FIRST_S)
                    if self._asked != question:
                        continue
                self._answer = await asyncio.to_thread(self._solve, question, self._answer)
                before, self._tracked = self._tracked, question.rerun
                self._refresh("what_if", *(["camera"] if before or self._tracked else []), "scene")
        finally:
            self._task = None

    async def _read_gates(self, run: RunView) -> None:
        """As far as they are not known."""
        while run.gates.frames < len(run) and self._asked is not None and self._asked.run is run:
            await asyncio.to_thread(run.read_gates)

    def _judge(self, question: Question) -> bool:
        """Judge the gates again, about a millisecond; False when it was done already."""
        answer = self._answer
        if answer is not None and answer.question.run is question.run and answer.question.changes == question.changes:
            return False
        self._answer = Answer(replace(question, frame=-1), question.run.gates.reevaluate(dict(question.changes)))
        return True

    def _solve(self, question: Question, known: Answer | None) -> Answer:
        judged = known.judged if known is not None and known.question.changes == question.changes else None
        answer = Answer(question, judged)
        try:
            params = parameters.replace(question.run.header.params, dict(question.changes))
            images = self._source(question) if question.rerun else None
            solved = resolve(question.run.reader, question.frame, params, images, question.rerun)
            return replace(answer, solved=solved, effect=effect(solved.before, solved.after))
        except VinspectError as problem:
            return replace(answer, problem=str(problem))
        except Exception as problem:
            log.exception("what-if of frame %d", question.frame)
            return replace(answer, problem=f"The frame could not be solved with these parameters ({problem}).")

    def _source(self, question: Question) -> ImageSource:
        if self._images is None:
            self._images = self._opened.enter_context(recorded_images(question.run.reader))
        return self._images


def parse_parameters(text: str, name: str) -> dict[str, Any]:
    """Changed parameters from the text of a YAML file that the browser read; ParameterError names it."""
    if not text:
        raise ParameterError(f"{name} is empty or too large for a file of parameters")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "parameters.yaml"
        path.write_text(text, "utf-8")
        try:
            return read_params(path)
        except ParameterError as problem:
            raise ParameterError(str(problem).replace(str(path), name)) from None
