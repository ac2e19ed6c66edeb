"""The state of loop closing in a record: a mark a frame that says how far the things are that only grow.

Keyframes lie in the frames that made them, poses and edges of the graph in their summaries; the map that a run begins
with lies beside it.  So restoring any frame costs its mark, and what is then asked of it (HOUSE, "Time travel").
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from ..errors import RunError
from ..loop.keyframe import Keyframes, LoopKeyframe
from ..loop.relocalize import RelocalisationRequest
from ..loop.step import LoopState, Moved
from ..mapping.closure import Closure, Optimization, PendingLoop
from ..mapping.maps import check_keyframe
from ..mapping.places import Places
from ..pose_graph.graph import Pair, PoseGraph, Session, extend
from ..report import FrameSummary, KeyframeEntry, LoopEdge
from .keyframes import KeyframeRecord, complete


@dataclass(frozen=True)
class GraphMark:
    """A pose graph without the rows that only grow."""

    n_keyframes: int
    n_loops: int
    sessions: tuple[Session, ...]
    optimized: np.ndarray
    disabled: tuple[Pair, ...]
    forced: tuple[Pair, ...]


@dataclass(frozen=True)
class ClosureMark:
    """A `Closure` without what only grows."""

    n: int
    seen: int
    since: int
    graph: GraphMark
    session_open: bool
    pending: tuple[PendingLoop, ...]
    requests: tuple[RelocalisationRequest, ...]
    optimization: tuple[int, GraphMark] | None
    begun_ns: int | None
    n_loops_begun: int
    fast_drift: np.ndarray
    moved: Moved | None = None


def mark(closure: Closure) -> ClosureMark:
    begun = closure.optimization
    return ClosureMark(
        closure.loops.n,
        closure.loops.seen,
        closure.loops.since,
        _mark_graph(closure.graph),
        closure.session_open,
        closure.pending,
        closure.requests,
        (begun.t_ns, _mark_graph(begun.graph)) if begun else None,
        closure.begun_ns,
        closure.n_loops_begun,
        closure.fast_drift,
        closure.loops.moved,
    )


def _mark_graph(graph: PoseGraph) -> GraphMark:
    return GraphMark(
        graph.n_keyframes,
        graph.n_loops,
        graph.sessions,
        graph.optimized,
        tuple(sorted(graph.disabled)),
        tuple(sorted(graph.forced)),
    )


class RecordedMap:
    """What a run has added to the map it began with, as far as it has been read."""

    def __init__(self, places: Places, load: Callable[[int], KeyframeRecord], where: str) -> None:
        """`load`: the keyframe that a frame made; `where` names the file that it is read from."""
        self.places = places
        self._load, self._where = load, where
        self._frames: list[int] = []  # that made a keyframe
        self._graph = places.graph
        self._keyframes = Keyframes(places.keyframes)
        self._read = 0
        self._lock = Lock()

    def follow(self, summaries: Sequence[FrameSummary]) -> None:
        """Take what further frames added."""
        with self._lock:
            new = [(s.frame, s.closure) for s in summaries[self._read :] if s.closure is not None]
            made = [(frame, said.keyframe) for frame, said in new if said.keyframe is not None]
            edges = [edge for _, said in new for edge in said.edges]
            self._read = len(summaries)
            if made or edges:
                self._graph = _extended(self._graph, [entry for _, entry in made], edges)
            if made:
                self._frames += [frame for frame, _ in made]
                recorded = _Recorded(self.places.keyframes, tuple(self._frames), self._checked)
                self._keyframes = Keyframes(recorded, self._keyframes.known)

    @property
    def keyframes(self) -> Keyframes:
        return self._keyframes

    def restore(self, mark: ClosureMark) -> Closure:
        begun = mark.optimization
        return Closure(
            LoopState(self._keyframes, self.places.vocabulary.limits, mark.n, mark.seen, mark.since, mark.moved),
            self._graph_at(mark.graph),
            mark.session_open,
            mark.pending,
            mark.requests,
            Optimization(begun[0], self._graph_at(begun[1])) if begun else None,
            mark.begun_ns,
            mark.n_loops_begun,
            mark.fast_drift,
        )

    def _checked(self, number: int, frame: int) -> LoopKeyframe:
        record = self._load(frame)
        try:
            keyframe = complete(record, self.places)
            check_keyframe(number, keyframe, self.places.vocabulary)
        except ValueError as problem:
            raise RunError(f"frame {frame} of {self._where} is damaged: {problem}") from None
        return keyframe

    def _graph_at(self, mark: GraphMark) -> PoseGraph:
        return replace(
            self._graph,
            n_keyframes=mark.n_keyframes,
            n_loops=mark.n_loops,
            sessions=mark.sessions,
            optimized=mark.optimized,
            disabled=frozenset(mark.disabled),
            forced=frozenset(mark.forced),
        )


def _extended(graph: PoseGraph, entries: list[KeyframeEntry], edges: list[LoopEdge]) -> PoseGraph:
    return extend(
        graph,
        np.array([e.frame for e in entries], np.int64),
        np.array([e.t_ns for e in entries], np.int64),
        np.array([e.session for e in entries], np.int32),
        np.array([e.T_vio for e in entries], float).reshape(-1, 7),
        np.array([(e.earlier, e.later) for e in edges], np.int64).reshape(-1, 2),
        np.array([e.T_i_j for e in edges], float).reshape(-1, 7),
    )


class _Recorded(Sequence[LoopKeyframe]):
    """Keyframes of a map, then those of a run's frames, each read when it is asked for."""

    def __init__(
        self, base: Sequence[LoopKeyframe], frames: tuple[int, ...], load: Callable[[int, int], LoopKeyframe]
    ) -> None:
        """`load(number, frame)`"""
        self._base, self._frames, self._load = base, frames, load

    def __len__(self) -> int:
        return len(self._base) + len(self._frames)

    def __getitem__(self, k):
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        n = len(self._base)
        return self._base[k] if k < n else self._load(k, self._frames[k - n])
