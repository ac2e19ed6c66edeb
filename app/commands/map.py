from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from .arguments import BackendWish, Calibrations, ParamsFile, Run, Settings
from .console import note

if TYPE_CHECKING:
    from vins_core.mapping.places import Places

Map = Positional[Annotated[Path, arg(metavar="MAP", help="folder of a map")]]
AnotherSession = Positional[Annotated[Path | None, arg(metavar="RECORDING", help="a further session in that map")]]


def save(run: Run, map: Map, /) -> None:
    """Save the map of a run: keyframes, loops, and what recognises its places."""
    from vins_core.mapping.conclusion import save_map
    from vins_core.record.reader import RunReader

    with RunReader(run) as reader:
        graph = save_map(reader, map)
    print(f"{map}: {len(graph)} keyframes, {graph.n_loops} loops; `vinspect map load {map} RECORDING` continues it")


def load(
    map: Map,
    recording: AnotherSession = None,
    /,
    out: Annotated[Path | None, arg(metavar="RUN", help="folder for the run; needed with a recording")] = None,
    calib: Calibrations = (),
    start: Annotated[float, arg(metavar="S", help="seconds after the first image")] = 0.0,
    duration: Annotated[float | None, arg(metavar="S", help="seconds from there on; to the end by default")] = None,
    backend: BackendWish = "auto",
    params: ParamsFile = None,
    settings: Settings = (),
) -> None:
    """Check a map and say what it holds; with a recording, run that against it as a further session."""
    from vins_core.errors import ParameterError
    from vins_core.mapping.maps import read

    if recording is None:
        _describe(map, read(map))
        return
    if out is None:
        raise ParameterError(f"a session in {map} is a run; say where it goes with --out RUN")
    from .run import run

    run(
        recording,
        out=out,
        calib=calib,
        start=start,
        duration=duration,
        backend=backend,
        params=params,
        settings=settings,
        loops="on",
        map=map,
    )


def _describe(folder: Path, places: Places) -> None:
    graph, words = places.graph, places.vocabulary
    print(f"{folder}: {len(graph)} keyframes in {len(graph.sessions)} sessions, {graph.n_loops} loops")
    for number, session in enumerate(graph.sessions):
        t_ns = graph.t_ns[graph.session == number]
        if len(t_ns):
            length_s = float(t_ns[-1] - t_ns[0]) * 1e-9
            print(f"  session {number}: {len(t_ns)} keyframes over {length_s:.1f} s, in the frame of {session.group}")
    camera = places.camera.model
    print(f"  camera: {camera.name}, {camera.width}x{camera.height}")
    print(f"  places: {words.n_words} words for {words.descriptor!r} descriptors")
    if not len(graph):
        note("note: it has no keyframes; a run that begins with it starts from nothing")
