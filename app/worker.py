"""The estimator in a process of its own: only the run folder, a cancel flag and one sentence connect it to the page.

A process and not a thread, because the estimator would hold up every answer to the page.  Spawned and not forked,
because the server has threads.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import tempfile
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

from vins_core.errors import VinspectError

from .notes import read_notes

NICENESS = 10
"""An estimator takes the time that the page leaves it: stepping stays quick while a fork runs."""
KEEP_RUNS = 10
"""Runs computed for the page are kept in the user's cache; older ones are removed."""

Estimate = Callable[[Path, Sequence[Path], Path, Callable[[], bool]], None]
"""(recording, calibration files, run folder, whether to stop) -> writes the run; raises VinspectError."""


def run_estimator(recording: Path, calib: Sequence[Path], out: Path, cancelled: Callable[[], bool]) -> None:
    from vins_core.runner import run_recording

    run_recording(recording, calib, out=out, cancelled=cancelled)


def run_fork(
    changes: Mapping[str, Any],
    at: int,
    frames: int | None,
    run: Path,
    calib: Sequence[Path],
    out: Path,
    cancelled: Callable[[], bool],
) -> None:
    """Repeat the run in `run` with `changes` from frame `at` on; without the first three, an `Estimate`."""
    from vins_core.record.fork import fork
    from vins_core.record.reader import RunReader

    with RunReader(run) as parent:
        fork(parent, at, out, changes, frames, cancelled=cancelled)


class Job:
    """One estimator at work."""

    def __init__(self, out: Path, process: multiprocessing.process.BaseProcess, flag: Event, news: Connection) -> None:
        self.out = out
        self._process, self._flag, self._news = process, flag, news
        self._error = ""
        self.cancelled = False

    @classmethod
    def start(cls, recording: Path, calib: Sequence[Path], estimate: Estimate = run_estimator) -> Job:
        spawn = multiprocessing.get_context("spawn")
        flag, (news, sender) = spawn.Event(), spawn.Pipe(duplex=False)
        out = new_run_folder(recording)
        arguments = (estimate, recording.resolve(), [c.resolve() for c in calib], out, flag, sender)
        process = spawn.Process(target=_work, args=arguments, name="vinspect estimator", daemon=True)
        process.start()
        sender.close()
        return cls(out, process, flag, news)

    @property
    def running(self) -> bool:
        return self._process.is_alive()

    @property
    def error(self) -> str:
        """Why it stopped before its end; empty while it runs, when it is done and when it was cancelled."""
        if not self._error and not self.running and not self.cancelled:
            try:
                self._error = self._news.recv() if self._news.poll() else ""
            except EOFError:
                self._error = ""
            if not self._error and self._process.exitcode:
                self._error = f"The estimator ended unexpectedly (exit code {self._process.exitcode})."
        return self._error

    def cancel(self) -> None:
        """Ask it to stop after its current frame; what it wrote stays."""
        self.cancelled = True
        self._flag.set()

    def wait(self, timeout_s: float = 5.0) -> None:
        self._process.join(timeout_s)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _work(
    estimate: Estimate, recording: Path, calib: Sequence[Path], out: Path, flag: Event, sender: Connection
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal reaches the server, which cancels us
    if hasattr(os, "nice"):  # not on Windows
        os.nice(NICENESS)
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is imported; see app.__main__
    server = os.getppid()
    try:
        estimate(recording, calib, out, lambda: flag.is_set() or os.getppid() != server)
    except VinspectError as problem:
        sender.send(str(problem))


def cache_folder() -> Path:
    """`vinspect/runs` in the user's cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "vinspect" / "runs"


def new_run_folder(recording: Path) -> Path:
    """A folder that does not exist yet, named after the recording; the oldest of many are removed."""
    parent = cache_folder()
    try:
        parent.mkdir(parents=True, exist_ok=True)
        old = sorted((p for p in parent.iterdir() if p.is_dir()), key=lambda p: p.stat().st_mtime)
        old = [p for p in old if not read_notes(p).kept]
        for folder in old[: max(len(old) - KEEP_RUNS + 1, 0)]:
            if time.time() - folder.stat().st_mtime > 3600:
                shutil.rmtree(folder, ignore_errors=True)
    except OSError:
        parent = Path(tempfile.mkdtemp(prefix="vinspect-"))
    return parent / f"{recording.stem}-{time.strftime('%Y%m%d-%H%M%S')}-{uuid.uuid4().hex[:4]}"
