"""The runs a server knows: the one it was opened with, their forks, and those computed earlier, by id.

Shared by every tab.  Names that users give, and whether a run is kept, stand in a small file beside the record; the
record itself is never touched.  The page only ever says ids, never paths.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from vins_core.errors import VinspectError
from vins_core.record.folder import is_run
from vins_core.record.header import Parent

from .context import RunView
from .notes import MAX_NAME, RunNotes, read_notes, write_notes
from .runs import OpenRun, open_path
from .worker import Job, cache_folder, run_fork


@dataclass(frozen=True)
class RunEntry:
    """A row of the list of runs."""

    id: str  # "" until its header is written
    name: str
    created: str  # UTC
    parent: Parent | None
    kept: bool
    growing: bool
    frames: int
    expected: int | None
    error: str
    poses: int
    ate_m: float  # over all poses so far; NaN without truth
    cost: float  # mean over solved frames
    ms: float  # median of a frame

    @property
    def changes(self) -> Mapping[str, Any]:
        return self.parent.changes if self.parent else {}

    @property
    def share(self) -> float:
        """How much of it is computed, 0..1."""
        first = self.parent.frame if self.parent else 0
        total = (self.expected or self.frames) - first
        return min(max((self.frames - first) / total, 0.0), 1.0) if total > 0 else 0.0


class RunStore:
    def __init__(self, opened: OpenRun) -> None:
        self.first = opened
        self._runs: list[OpenRun] = [opened]
        self._notes: dict[str, RunNotes] = {}
        self._metrics: dict[OpenRun, tuple[int, tuple[int, float, float, float]]] = {}
        self._lock = threading.Lock()

    def __iter__(self) -> Iterator[OpenRun]:
        return iter(tuple(self._runs))

    def get(self, id: str) -> OpenRun | None:
        return next((run for run in self if id and run.id == id), None)

    def poll(self) -> set[OpenRun]:
        """Look at the runs that grow; those of which a tab has something new to show."""
        return {run for run in self if (run is self.first or run.growing) and run.poll()}

    def scan(self) -> None:
        """Open the runs in the user's cache that are not open yet; call it off the event loop."""
        known = {run.folder.resolve() for run in self if run.folder is not None}
        try:
            found = sorted(p for p in cache_folder().iterdir() if is_run(p) and p.resolve() not in known)
        except OSError:
            return
        for folder in found:
            try:
                run = open_path(folder)
            except VinspectError:
                continue
            with self._lock:
                if run.view is not None and self.get(run.id) is None:
                    self._runs.append(run)

    def fork(self, run: OpenRun, at: int, changes: Mapping[str, Any], frames: int | None) -> OpenRun:
        """Start repeating `run` from frame `at` in a process of its own; raises what `fork` would raise at once."""
        from vins_core.record.fork import check

        assert run.view is not None and run.folder is not None
        check(run.view.reader, at, changes, frames)
        work = functools.partial(run_fork, dict(changes), at, frames)
        job = Job.start(run.folder, (), work)
        fork = OpenRun(f"fork at {at}", job.out, job)
        with self._lock:
            self._runs.append(fork)
        return fork

    def close(self) -> None:
        for run in self:
            run.close()

    # -- names -------------------------------------------------------------------------------------------------------

    def notes(self, run: OpenRun) -> RunNotes:
        if run.id not in self._notes:
            self._notes[run.id] = read_notes(run.folder)
        return self._notes[run.id]

    def rename(self, run: OpenRun, name: str) -> None:
        self._note(run, msgspec.structs.replace(self.notes(run), name=" ".join(name.split())[:MAX_NAME]))

    def keep(self, run: OpenRun, kept: bool) -> None:
        self._note(run, msgspec.structs.replace(self.notes(run), kept=kept))

    def name(self, run: OpenRun) -> str:
        """The user's name for it, or what it is."""
        given = self.notes(run).name if run.id else ""
        if given or run.view is None or run.view.header.parent is None:
            return given or run.title
        return f"fork at {run.view.header.parent.frame}"

    def entry(self, run: OpenRun) -> RunEntry:
        view = run.view
        header = view.header if view is not None else None
        notes = self.notes(run) if run.id else RunNotes()
        poses, ate, cost, ms = self._metrics_of(run)
        return RunEntry(
            id=run.id,
            name=self.name(run),
            created=header.created_utc if header else "",
            parent=header.parent if header else None,
            kept=notes.kept,
            growing=run.growing,
            frames=len(view) if view is not None else 0,
            expected=header.expected_frames if header else None,
            error=run.error,
            poses=poses,
            ate_m=ate,
            cost=cost,
            ms=ms,
        )

    def _metrics_of(self, run: OpenRun) -> tuple[int, float, float, float]:
        """Worked out again when the run has grown."""
        view = run.view
        if view is None:
            return 0, np.nan, np.nan, np.nan
        known = self._metrics.get(run)
        if known is None or known[0] != len(view):
            known = self._metrics[run] = len(view), metrics(view)
        return known[1]

    def entries(self) -> tuple[RunEntry, ...]:
        """Every run; forks stand below the run they began as, oldest first."""
        rows = [self.entry(run) for run in self]
        ids = {row.id for row in rows if row.id}
        below: dict[str, list[RunEntry]] = {}
        for row in rows:
            above = row.parent.id if row.parent and row.parent.id in ids else ""
            below.setdefault(above, []).append(row)
        ordered: list[RunEntry] = []

        def walk(rows: list[RunEntry]) -> None:
            for row in rows:
                ordered.append(row)
                if row.id:
                    walk(below.get(row.id, []))

        walk(below.get("", []))
        return tuple(ordered)

    def _note(self, run: OpenRun, notes: RunNotes) -> None:
        if run.folder is None or not run.id:
            return
        self._notes[run.id] = notes
        write_notes(run.folder, notes)


def metrics(view: RunView) -> tuple[int, float, float, float]:
    """(poses, ATE in m, mean cost, median ms of a frame)."""
    series = view.series
    solved = np.isfinite(series.p_w_b[:, 0])
    ate = series.ate_m[np.isfinite(series.ate_m)]
    cost = series.cost.sum(1)
    cost = cost[np.isfinite(cost)]
    ms = [sum(s.ms.values()) for s in view.summaries]
    return (
        int(solved.sum()),
        float(ate[-1]) if len(ate) else np.nan,
        float(cost.mean()) if len(cost) else np.nan,
        float(np.median(ms)) if ms else np.nan,
    )
