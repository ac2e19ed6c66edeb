"""Optimisations of the pose graph beside the frames: begun and adopted at times of the recording, never of the clock.

An optimisation is a pure function of the graph it begins with, so it does not matter when it is computed: `prefetch`
starts it in a thread, `result` waits for it, or computes it when nobody did.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from .. import params
from ..pose_graph.graph import PoseGraph
from ..pose_graph.optimize import optimize
from ..report import PoseGraphReport

Optimized = tuple[PoseGraph, PoseGraphReport]


class Optimizer:
    """Remembers the one optimisation that was begun last."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._begun: tuple[params.PoseGraph, PoseGraph, Future[Optimized]] | None = None

    def prefetch(self, settings: params.PoseGraph, graph: PoseGraph) -> None:
        self._pool = self._pool or ThreadPoolExecutor(1, "pose graph")
        self._begun = settings, graph, self._pool.submit(optimize, settings, graph)

    def result(self, settings: params.PoseGraph, graph: PoseGraph) -> Optimized:
        if self._begun is not None and self._begun[0] == settings and self._begun[1] is graph:
            return self._begun[2].result()
        return optimize(settings, graph)
