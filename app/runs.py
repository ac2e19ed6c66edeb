"""What was opened: a run, finished or still growing, with its images and the worker that computes it.

Read-only and shared by every tab; `poll` is called by the server, a few times a second while the run grows.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vins_core.errors import VinspectError
from vins_core.io.recording import open_recording
from vins_core.record.folder import is_run
from vins_core.record.reader import RunReader

from .context import RunView
from .images import EmbeddedImages, ImageBytes, Images, NoImages
from .landmark_map import LandmarkMap
from .worker import Job

MAP_SLICE = 5
"""Reports read per poll to fill the map of landmarks that left the window."""


class OpenRun:
    """A run as tabs see it.  `view` is None until its first frame is there; `error` says why it never will be."""

    def __init__(self, title: str, folder: Path | None, job: Job | None = None, error: str = "") -> None:
        self.title = title
        self.job = job
        self.error = error
        self.growing = job is not None
        self.view: RunView | None = None
        self.images = Images(NoImages("this run has no images"))
        self.map = LandmarkMap()
        self.folder = folder
        self._told: tuple[object, ...] = ()
        self._reader: RunReader | None = None

    @property
    def id(self) -> str:
        """What names the run wherever its folder is; empty until its header is written."""
        return self._reader.header.id if self._reader is not None else ""

    @property
    def progress(self) -> float | None:
        """0..1 while the estimator runs, None when it does not or its end is not known."""
        if not self.growing or self.view is None or not self.view.header.expected_frames:
            return None
        return min(len(self.view) / self.view.header.expected_frames, 1.0)

    @property
    def doing(self) -> str:
        """One sentence about the estimator: where it is, or that it ended early; empty when the run is finished."""
        if self._reader is None or self.view is None:
            return "The estimator is starting." if self.growing else ""
        if self.growing:
            expected = self.view.header.expected_frames
            return f"The estimator is at frame {len(self.view)}" + (f" of about {expected}." if expected else ".")
        match self._reader.outcome:
            case "finished":
                return ""
            case "interrupted" | None:
                return f"The estimator was stopped after frame {len(self.view) - 1}."
            case sentence:
                return f"The estimator stopped: {sentence}"

    def poll(self) -> bool:
        """Read what has been written since the last look; True when a tab has something new to show."""
        running = self.job is not None and self.job.running  # asked first, so that nothing written later is missed
        try:
            self._read()
        except VinspectError as problem:
            self.error = str(problem)
        if self.job is not None:
            self.growing, self.error = running, self.job.error or self.error
        elif self._reader is not None:
            self.growing = self._reader.growing
        told, self._told = self._told, (0 if self.view is None else len(self.view), self.growing, self.error)
        return told != self._told

    @property
    def map_behind(self) -> bool:
        """The map of passed landmarks lacks frames."""
        return self.view is not None and self.map.frames < len(self.view)

    def extend_map(self) -> bool:
        """Read a few more reports into the map of passed landmarks; False when it is complete."""
        if self.view is None:
            return False
        for k in range(self.map.frames, min(self.map.frames + MAP_SLICE, len(self.view))):
            self.map.extend(self.view.reader.report(k))
        return self.map_behind

    def close(self) -> None:
        """Stop the estimator, if it runs."""
        if self.job is not None:
            self.job.cancel()
            self.job.wait()

    def _read(self) -> None:
        if self.folder is None or (self.job is not None and not is_run(self.folder)):
            return
        if self._reader is None:
            self._reader = RunReader(self.folder)
            self.images = Images(image_source(self._reader))
        else:
            self._reader.refresh()
        if self.view is None and len(self._reader):
            self.view = RunView(self._reader)


def image_source(run: RunReader) -> ImageBytes:
    """Where the images of a run come from: the record itself, or the recording it was made from."""
    if run.has_images:
        return EmbeddedImages(run)
    try:
        return open_recording(run.header.recording, run.header.calibration)
    except VinspectError as problem:
        return NoImages(f"The images are not in the run, and its recording cannot be opened: {problem}")


def open_path(path: Path, calib: Sequence[Path] = ()) -> OpenRun:
    """A run folder, or a recording whose estimator is started in a process of its own.

    What cannot be opened becomes an OpenRun whose `error` says why, so that the page can say it too.
    """
    if is_run(path):
        opened = OpenRun(path.name, path)
    else:
        try:
            open_recording(path).close()
            job = Job.start(path, calib)
            opened = OpenRun(path.name, job.out, job)
        except VinspectError as problem:
            return OpenRun(path.name, None, error=str(problem))
    opened.poll()
    return opened
