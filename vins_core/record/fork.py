"""A fork: what would have happened, had a parameter been another one from some frame on (SPEC 9.3c).

    restored state after frame `at` - 1  +  changed parameters  +  the recorded packets  ->  a new run

Frames before `at` are copied byte for byte, so that a fork opens as a whole run and needs its parent no more; pixels
come from the recording by reference, or from the record where they are embedded.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import uuid
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from itertools import islice
from typing import Any

from .. import params as parameters
from ..errors import ParameterError, RunError
from ..io.recording import open_recording
from ..params import Params
from ..process import prepare
from ..sensors import ImageSource, Packet
from ..solver import backend as backends
from ..solver.backend import Wish
from ..state import RunState, start
from .header import Parent, RunHeader, cpu_model, package_versions
from .reader import RunReader
from .regroup import regroup
from .replay import Progress, Result, estimate
from .writer import RunWriter


def fork(
    run: RunReader,
    at: int,
    out: str | os.PathLike[str],
    changes: Mapping[str, Any],
    frames: int | None = None,
    images: ImageSource | None = None,
    backend: Wish = "auto",
    progress: Callable[[Progress], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Result:
    """Repeat `run` with `changes` (`section.name -> value`) from frame `at` on: the first one that they apply to.

    A fork of a fork keeps its changes, also where it begins before them.
    Computes `frames` frames, by default up to the last one that `run` holds.  Without changes the fork equals the
    run bit for bit where versions and processor are the same; the notes of the result say where they are not.
    `images`: where pixels come from, by default the record or the recording it names.  `backend`: "auto" is that of
    the run; the others give the same bits (solver/backend.py).
    Raises before `out` is touched: ParameterError, RunError for a frame that is not there or a back end that is not
    available, RecordingError when the images cannot be opened.
    """
    prepare()
    params = check(run, at, changes, frames, backend)
    chosen = backends.recorded(run.header.backend, backend)
    state, packets = state_before(run, at), islice(_packets(run, at, params), frames)
    places = run.places
    header = _header(run, at, params, _expect(run, at, params, frames), chosen.name)
    with contextlib.ExitStack() as opened:
        source = images if images is not None else opened.enter_context(recorded_images(run))
        with backends.using(chosen), RunWriter(out, header, run.truth, source, places) as writer:
            writer.adopt(run, at)
            poses = sum(s.pose is not None for s in run.summaries[:at])
            return estimate(writer, header, source, state, packets, progress, cancelled, poses, places)


def check(
    run: RunReader, at: int, changes: Mapping[str, Any], frames: int | None = None, backend: Wish = "auto"
) -> Params:
    """The parameters of a fork; raises what `fork` would raise at once."""
    params = parameters.replace(run.header.params, changes)
    backends.recorded(run.header.backend, backend)
    if not 0 <= at < len(run):
        raise RunError(f"{run.path} has no frame {at} to fork at; it holds frames 0 to {len(run) - 1}")
    if frames is not None and frames < 1:
        raise ParameterError(f"a fork of {frames} frames computes nothing; expected at least 1")
    if changes.get("loop.enabled") and params.loop.enabled and run.places is None:
        raise ParameterError(f"{run.path} has no vocabulary to close loops with; run the recording with --loops on")
    run.packet(at)  # a record without packets cannot be repeated
    return params


def state_before(run: RunReader, k: int) -> RunState:
    """The state that frame k of a run was computed from."""
    return start(run.header.calibration, run.places) if k == 0 else run.state(k - 1)


@contextlib.contextmanager
def recorded_images(run: RunReader) -> Iterator[ImageSource]:
    """The pixels of a run: its own when they are embedded, else those of its recording."""
    if run.has_images:
        yield run
        return
    with open_recording(run.header.recording, run.header.calibration) as source:
        yield source


def _packets(run: RunReader, at: int, params: Params) -> Iterator[Packet]:
    recorded = (run.packet(k) for k in range(at, len(run)))
    begins = [at, *(parent.frame for parent in run.header.lineage() if parent.frame > at)]
    if all(run.header.params_at(k).frontend.freq == params.frontend.freq for k in begins):
        return recorded
    last_frame_ns = run.summary(at - 1).t_ns if at else None
    return regroup(recorded, params.frontend, at, last_frame_ns)


def _expect(run: RunReader, at: int, params: Params, frames: int | None) -> int:
    """How many frames the fork will have: an estimate where the frame rate changes."""
    rate = params.frontend.freq / run.header.params.frontend.freq
    left = round((len(run) - at) * rate)
    return at + (left if frames is None else min(frames, left))


def _header(run: RunReader, at: int, params: Params, end: int, backend: str) -> RunHeader:
    before, old = run.header, run.header.params_at(at - 1)
    changed = parameters.changed(params, old)
    kept = next((parent for parent in before.lineage() if parent.frame < at), None)
    parent = Parent(before.id, str(run.path.resolve()), at, changed, parameters.changed(old, params), kept)
    versions, cpu = package_versions(), cpu_model()
    notes = [f"{what} was {a or 'unknown'} and is {b}" for what, a, b in _other_machine(before, versions, cpu)]
    return dataclasses.replace(
        before,
        params=params,
        origins={**before.origins, **dict.fromkeys(changed, "fork")},
        expected_frames=end,
        backend=backend,
        embedded_images=run.has_images,
        parent=parent,
        notes=tuple(f"the fork may differ in its last digits: {note}" for note in notes),
        id=uuid.uuid4().hex[:12],
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=versions,
        cpu=cpu,
    )


def _other_machine(header: RunHeader, versions: Mapping[str, str], cpu: str) -> Iterator[tuple[str, str, str]]:
    pairs = [(name, header.versions.get(name, ""), version) for name, version in versions.items()]
    yield from (pair for pair in [*pairs, ("the processor", header.cpu, cpu)] if pair[1] != pair[2])
