from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from .arguments import Calibrations, Format, Recording
from .console import progress_bar


def convert(
    recording: Recording,
    out: Positional[Annotated[Path, arg(metavar="OUT", help="file or folder that does not exist yet")]],
    /,
    format: Format,
    calib: Calibrations = (),
) -> None:
    """Write a recording in another format, without losing a bit."""
    from vins_core.io.calibration import read_calibration
    from vins_core.io.recording import open_recording
    from vins_core.io.write import convert

    with open_recording(recording) as source, progress_bar(f"writing {out.name}") as report:
        settings = read_calibration(calib, source) if calib else None
        written = convert(source, out, format, settings, report)
    print(f"{written}: {format}")
