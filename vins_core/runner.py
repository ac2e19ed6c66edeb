"""From a recording to a run on disk: what the command line and the browser's worker share."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from . import params as parameters
from .errors import ParameterError
from .fusion import available
from .io import modes
from .io.calibration import read_calibration
from .io.modes import Mode
from .io.params_yaml import read_params
from .io.recording import Recording, open_recording
from .io.sync import TimeOffset, packets
from .mapping.maps import load as load_map
from .mapping.places import Places, learn_places, read_places
from .params import Params
from .process import prepare
from .record.header import RunHeader
from .record.replay import Progress, Result, estimate
from .record.writer import RunWriter
from .sensors import Calibration
from .solver import backend as backends
from .solver.backend import Wish
from .state import start

__all__ = ["Progress", "Result", "choose_parameters", "run_recording"]

PathLike = str | Path


def run_recording(
    recording: PathLike,
    calib: Sequence[PathLike] = (),
    *,
    out: PathLike,
    settings: Sequence[str] = (),
    params_file: PathLike | None = None,
    start_s: float = 0.0,
    duration_s: float | None = None,
    embed_images: bool = False,
    backend: Wish = "auto",
    vocabulary: PathLike | None = None,
    brief_pattern: PathLike | None = None,
    map_folder: PathLike | None = None,
    mode: Mode | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Result:
    """Estimate a recording into the new run folder `out`.

    `settings` are `section.name=value` and win over those of `params_file` (see io/params_yaml.py), which win over the
    tuning keys of the calibration files.  `start_s` and `duration_s` count from the first image.  `backend`: which
    code evaluates the factors, with the same results (solver/backend.py).  `vocabulary`: what places are recognised by,
    a DBoW2 file (with the pattern of its BRIEF descriptors, where it has such), by default trained on the recording's
    own images.  `map_folder`: a map that the run begins with, and whose vocabulary it uses.  `mode`: which sensors are
    used (io/modes.py), by default most of what is there.  `cancelled` is asked after each frame.  However it ends, what
    was written can be read.
    Raises VinspectError, before `out` is touched when the input is at fault.
    """
    prepare()
    chosen = backends.choose(backend)
    assignments = dict(parameters.parse_assignment(text) for text in settings)
    parameters.replace(Params(), assignments)  # a wrong one is told before anything is read
    from_file = read_params(params_file) if params_file is not None else {}
    with open_recording(recording) as source:
        given = read_calibration(calib, source)
        params, origins = choose_parameters(given.overrides, assignments, from_file)
        mode = modes.choose(source, given.calibration, mode)
        calibration, unused = modes.prepare(given.calibration, mode)
        gps_topics = source.topics_of("gps")
        calibration = available.choose_topic(calibration, gps_topics)
        no_gps = available.missing(params.gps, calibration, gps_topics)
        offset = TimeOffset(calibration.td_of(0))
        arriving = packets(source, calibration, params, start_s, duration_s, offset)
        first = next(arriving)  # what is wrong with the recording is told before a folder is made
        places = _places(params, calibration, source, vocabulary, brief_pattern, map_folder)
        header = RunHeader(
            params,
            calibration,
            mode=mode,
            origins=origins,
            recording=str(Path(recording).resolve()),
            recording_kind=source.kind,
            topics=_topics(source),
            start_s=start_s,
            duration_s=duration_s,
            expected_frames=_expect_frames(source, params, start_s, duration_s),
            backend=chosen.name,
            embedded_images=embed_images,
            notes=(*given.notes, *unused, *no_gps),
        )
        with backends.using(chosen), RunWriter(out, header, source.truth(), source, places) as writer:
            arriving = itertools.chain([first], arriving)
            state = start(calibration, places)
            return estimate(writer, header, source, state, arriving, progress, cancelled, places=places, offset=offset)


def _places(
    params: Params,
    calibration: Calibration,
    source: Recording,
    vocabulary: PathLike | None,
    brief_pattern: PathLike | None,
    map_folder: PathLike | None,
) -> Places | None:
    if not params.loop.enabled or not calibration.has_imu:  # without gravity, poses cannot be told from each other
        if map_folder is not None or vocabulary is not None:
            raise ParameterError("a map or a vocabulary serves loops, which are off; leave them out, or --loops on")
        return None
    camera = calibration.cameras[0]
    if map_folder is not None:
        if vocabulary is not None:
            raise ParameterError("a map brings its own vocabulary; give either --map or --vocabulary")
        return load_map(Path(map_folder), camera)
    if vocabulary is not None:
        return read_places(camera, Path(vocabulary), Path(brief_pattern) if brief_pattern is not None else None)
    if brief_pattern is not None:
        raise ParameterError("a BRIEF pattern belongs to a vocabulary; give that too, with --vocabulary")
    return learn_places(camera, tuple(source.images()), source)


def _without_places(params: Params, places: Places | None) -> tuple[str, ...]:
    """A note for a run that was to close loops and cannot."""
    if places is not None or not params.loop.enabled:
        return ()
    return ("the images show too little to learn a vocabulary from: no loops are closed",)


def choose_parameters(
    overrides: Mapping[str, object], assignments: Mapping[str, object], from_file: Mapping[str, object] | None = None
) -> tuple[Params, dict[str, str]]:
    """Parameters and where each comes from.

    "default" < "config" (calibration file) < "params" (parameter file) < "set" (command line): the later wins.
    """
    params, origins = Params(), dict.fromkeys(parameters.DECLARATIONS, "default")
    for origin, changes in (("config", overrides), ("params", from_file or {}), ("set", assignments)):
        params = parameters.replace(params, changes)
        origins |= dict.fromkeys(changes, origin)
    return params, origins


def _topics(source: Recording) -> dict[str, str]:
    named = {f"cam{i}": topic for i, topic in enumerate(source.image_topics)}
    imu = {"imu": source.imu_topic} if source.choice.has_imu else {}
    others = {"gps": source.gps_topic, "truth": source.truth_topic}
    return named | imu | {name: topic for name, topic in others.items() if topic}


def _expect_frames(source: Recording, params: Params, start_s: float, duration_s: float | None) -> int | None:
    """How many frames there will be, for progress bars: an estimate."""
    images = source.stream(source.image_topics[0])
    if images.first_ns is None or images.last_ns is None or not images.rate_hz:
        return None
    length_s = max((images.last_ns - images.first_ns) * 1e-9 - start_s, 0.0)
    if duration_s is not None:
        length_s = min(length_s, duration_s)
    every = math.ceil(images.rate_hz / params.frontend.freq - 0.01)  # images a frame
    return max(int(length_s * images.rate_hz / max(every, 1)), 1)
