from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from .arguments import BackendWish, Calibrations, Loops, ModeWish, ParamsFile, Recording, Settings
from .console import note, progress_bar

if TYPE_CHECKING:
    from vins_core.runner import Progress


def run(
    recording: Recording,
    /,
    out: Annotated[Path, arg(metavar="RUN", help="folder for the run; must not exist or be empty")],
    calib: Calibrations = (),
    mode: ModeWish = None,
    start: Annotated[float, arg(metavar="S", help="seconds after the first image")] = 0.0,
    duration: Annotated[float | None, arg(metavar="S", help="seconds from there on; to the end by default")] = None,
    embed_images: Annotated[bool, arg(help="store the images in the run, for sharing it")] = False,
    backend: BackendWish = "auto",
    params: ParamsFile = None,
    settings: Settings = (),
    loops: Loops = None,
    vocabulary: Annotated[
        Path | None,
        arg(metavar="FILE", help="DBoW2: brief_k10L6.bin or ORBvoc.txt; by default one trained on the images"),
    ] = None,
    brief_pattern: Annotated[Path | None, arg(metavar="FILE", help="brief_pattern.yml of a BRIEF vocabulary")] = None,
    map: Annotated[Path | None, arg(metavar="MAP", help="a map to begin with, from `vinspect map save`")] = None,
) -> None:
    """Estimate a recording and record everything the estimator knew."""
    from vins_core.runner import run_recording

    anomalies, reason, frames = 0, "no attempt was made", 0
    with progress_bar(f"{recording.name}") as report:

        def progress(now: Progress) -> None:
            nonlocal anomalies, reason, frames
            frames = now.frames
            anomalies += now.summary.n_anomalies
            reason = now.summary.initialization or reason
            report(now.frames / max(now.expected or 0, now.frames, 1), f"frame {now.frames}, {now.poses} poses")

        try:
            result = run_recording(
                recording,
                calib,
                out=out,
                settings=(*settings, *([f"loop.enabled={loops}"] if loops else [])),
                params_file=params,
                start_s=start,
                duration_s=duration,
                embed_images=embed_images,
                backend=backend,
                vocabulary=vocabulary,
                brief_pattern=brief_pattern,
                map_folder=map,
                mode=mode,
                progress=progress,
            )
        except KeyboardInterrupt:
            note(f"{out} holds the {frames} frames so far")
            raise
    for text in result.notes:
        note(f"note: {text}")
    if anomalies:
        note(f"note: {anomalies} anomalies in the recording; `vinspect info {recording}` lists them")
    if not result.poses:
        note(f"note: it never initialised; last reason: {reason}")
    print(f"{out}: {result.frames} frames, {result.poses} poses; `vinspect open {out}` shows them")
