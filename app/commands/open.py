from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from .arguments import Calibrations


def open_page(
    path: Positional[Annotated[Path | None, arg(metavar="RECORDING|RUN", help="by default the bundled sample")]] = None,
    /,
    calib: Calibrations = (),
    port: Annotated[int, arg(metavar="N", help="a busy one becomes the next free one")] = 8080,
    host: Annotated[str, arg(metavar="H", help="address to listen at; 0.0.0.0 lets others in")] = "127.0.0.1",
    no_browser: Annotated[bool, arg(help="only print the address")] = False,
) -> None:
    """Show a run, or a recording while it is estimated, in the browser."""
    from vins_core.errors import RecordingError

    if path is not None and not path.exists():
        raise RecordingError(f"{path}: no such file or folder; give a recording, or a run made by `vinspect run`")
    from ..server import open_browser

    open_browser(path, calib, host, port, no_browser)
