"""What a run knows in the end: the graph with every loop, as a trajectory and as a map for further sessions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import RunError
from ..pose_graph.graph import PoseGraph
from ..record.reader import RunReader
from ..sensors import Trajectory
from . import maps
from .closure import conclude


def final_graph(run: RunReader) -> PoseGraph:
    """With every loop accepted so far, optimised.  Raises RunError for a run without loops."""
    if run.places is None:
        raise RunError(f"{run.path} has no loops: it was made with --loops off")
    closure = run.state(len(run) - 1).closure if len(run) else None
    return conclude(run.header.params, closure)[0] if closure else run.places.graph


def optimized_trajectory(run: RunReader) -> Trajectory:
    """The run's own keyframes as the final graph has them, in the world of the graph.  Raises RunError."""
    graph = final_graph(run)
    assert run.places is not None
    own = slice(len(run.places.graph), len(graph))
    T_g_b = graph.T_corrected[own]
    when = {s.t_ns: s.t_imu_ns for s in run.summaries}
    return Trajectory(
        np.array([when.get(t, t) for t in graph.t_ns[own].tolist()], np.int64), T_g_b[:, :3], T_g_b[:, 3:]
    )


def save_map(run: RunReader, folder: Path) -> PoseGraph:
    """Write the map of a run, with all that another session needs to continue it; returns its graph.

    Raises RunError for a run without loops or keyframes, OutputError.
    """
    graph = final_graph(run)
    if not len(graph):
        raise RunError(f"{run.path} has no keyframes yet, so there is no map to save")
    assert run.places is not None
    maps.save(folder, run.places, graph, run.keyframes[: len(graph)])
    return graph
