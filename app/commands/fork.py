from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from .arguments import BackendWish, ParamsFile, Run, Settings
from .console import note, progress_bar

if TYPE_CHECKING:
    from vins_core.record.replay import Progress


def fork(
    run: Run,
    /,
    at: Annotated[int, arg(metavar="FRAME", help="the first frame computed with the changed parameters; from 0")],
    out: Annotated[Path, arg(metavar="RUN2", help="folder for the fork; must not exist or be empty")],
    frames: Annotated[int | None, arg(metavar="N", help="how many frames; to the end of RUN by default")] = None,
    backend: BackendWish = "auto",
    params: ParamsFile = None,
    settings: Settings = (),
) -> None:
    """Repeat a run from one of its frames on with other parameters."""
    from vins_core.io.params_yaml import read_params
    from vins_core.params import parse_assignment
    from vins_core.record.fork import fork
    from vins_core.record.reader import RunReader

    changes = read_params(params) if params else {}
    changes |= dict(parse_assignment(text) for text in settings)
    with RunReader(run) as reader, progress_bar(f"{run.name} from frame {at}") as report:
        done = at

        def progress(now: Progress) -> None:
            nonlocal done
            done = now.frames
            report((done - at) / max((now.expected or done) - at, 1), f"frame {done}, {now.poses} poses")

        try:
            result = fork(reader, at, out, changes, frames, backend=backend, progress=progress)
        except KeyboardInterrupt:
            note(f"{out} holds the {done} frames so far")
            raise
    for text in result.notes:
        note(f"note: {text}")
    print(f"{out}: {result.frames} frames, {result.poses} poses; `vinspect compare {run} {out}` says what differs")
