from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from .arguments import Run, Trajectory
from .eval import trajectory_of


def export(
    run: Run,
    /,
    tum: Annotated[Path, arg(metavar="FILE", help="text file of poses: t x y z qx qy qz qw")],
    trajectory: Trajectory = "odometry",
) -> None:
    """Write the poses of a run."""
    from vins_core.errors import RunError
    from vins_core.io.trajectory import write_tum
    from vins_core.record.reader import RunReader

    with RunReader(run) as reader:
        poses = trajectory_of(reader, trajectory)
    if not len(poses):
        raise RunError(f"{run} has no poses: it never initialised; `vinspect open {run}` shows why")
    write_tum(tum, poses)
    print(f"{tum}: {len(poses)} poses")
