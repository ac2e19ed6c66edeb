"""The pose graph as a value: keyframes, loops, sessions, and where the last optimisation put them.

Frames: `o` is the world in which a session's odometry runs, `g` the graph's.  A keyframe keeps both poses (HOUSE,
"Time travel"): `T_vio` = T_o_b, never changed, and `T_corrected` = T_g_b.  Keyframes that came after the last
optimisation follow it rigidly: T_corrected = drift * T_vio with the drift T_g_o of their session, which also corrects
the live odometry (REFERENCE Q5); the window itself is never moved.

Keyframes and loops are rows that only grow (rows.py), so a state costs what changed and a fork shares the past.
Ties to previous keyframes are not stored: they follow from T_vio and a parameter (edges.py).  Poses are rows
(p, q wxyz) of seven numbers; keyframes are counted from 0 over all sessions, in the order in which they came.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .. import params
from ..geometry import heading, poses, so3
from .rows import Rows

Pair = tuple[int, int]
"""An edge by its keyframes, earlier one first."""


@dataclass(frozen=True)
class Session:
    """Keyframes of one odometry without interruption; consecutive in the graph."""

    first: int  # its first keyframe
    drift: np.ndarray  # (7,) T_g_o
    group: int  # sessions of one group share one frame; the lowest session number among them
    base: bool = False  # from a loaded map: optimisation never moves it against its group


def _keyframe_rows() -> Rows:
    return Rows(("frame", np.int64, ()), ("t_ns", np.int64, ()), ("session", np.int32, ()), ("T_vio", float, (7,)))


def _loop_rows() -> Rows:
    return Rows(("pair", np.int64, (2,)), ("T_i_j", float, (7,)))


@dataclass(frozen=True)
class PoseGraph:
    """State of the graph.  `optimized` covers all keyframes there were at the last optimisation or merge."""

    n_keyframes: int = 0
    n_loops: int = 0
    sessions: tuple[Session, ...] = ()
    optimized: np.ndarray = field(default_factory=lambda: np.zeros((0, 7)))  # (m, 7) T_g_b
    disabled: frozenset[Pair] = frozenset()  # edges of either kind that do not count
    forced: frozenset[Pair] = frozenset()  # loops that count in full, without robust loss
    keyframe_rows: Rows = field(default_factory=_keyframe_rows, repr=False, compare=False)
    loop_rows: Rows = field(default_factory=_loop_rows, repr=False, compare=False)

    def __len__(self) -> int:
        return self.n_keyframes

    @property
    def frame(self) -> np.ndarray:
        """(n,) int64 frame numbers of the keyframes in their runs."""
        return self.keyframe_rows.column("frame", self.n_keyframes)

    @property
    def t_ns(self) -> np.ndarray:
        """(n,) int64."""
        return self.keyframe_rows.column("t_ns", self.n_keyframes)

    @property
    def session(self) -> np.ndarray:
        """(n,) int32."""
        return self.keyframe_rows.column("session", self.n_keyframes)

    @property
    def T_vio(self) -> np.ndarray:
        """(n, 7) T_o_b as the odometry had it."""
        return self.keyframe_rows.column("T_vio", self.n_keyframes)

    @property
    def T_corrected(self) -> np.ndarray:
        """(n, 7) T_g_b."""
        m = len(self.optimized)
        if m == self.n_keyframes:
            return self.optimized
        drifts = np.stack([s.drift for s in self.sessions])[self.session[m:]]
        return np.concatenate([self.optimized, poses.compose(drifts, self.T_vio[m:])])

    @property
    def loops(self) -> np.ndarray:
        """(l, 2) int64: earlier and later keyframe."""
        return self.loop_rows.column("pair", self.n_loops)

    @property
    def T_loops(self) -> np.ndarray:
        """(l, 7) pose of the later keyframe in the frame of the earlier one."""
        return self.loop_rows.column("T_i_j", self.n_loops)

    @property
    def groups(self) -> np.ndarray:
        """(n,) group of each keyframe's session."""
        return np.array([s.group for s in self.sessions], np.int64)[self.session]


def begin_session(graph: PoseGraph, base: bool = False, drift: np.ndarray = poses.IDENTITY) -> PoseGraph:
    """Keyframes from now on belong to a new odometry; until its first loop to another it has a frame of its own.

    `drift`: T_g_o to begin with.
    """
    session = Session(graph.n_keyframes, drift, len(graph.sessions), base)
    return replace(graph, sessions=(*graph.sessions, session))


def add_keyframe(graph: PoseGraph, frame: int, t_ns: int, p_o_b: np.ndarray, q_o_b: np.ndarray) -> PoseGraph:
    """A keyframe of the newest session, with its pose in the odometry: p (3,) in metres, q (4,) wxyz."""
    if not graph.sessions:
        graph = begin_session(graph)
    T_vio = np.concatenate([p_o_b, so3.normalize(np.asarray(q_o_b))])
    rows = graph.keyframe_rows.append(
        graph.n_keyframes, frame=frame, t_ns=t_ns, session=len(graph.sessions) - 1, T_vio=T_vio
    )
    return replace(graph, n_keyframes=graph.n_keyframes + 1, keyframe_rows=rows)


def add_loop(
    settings: params.PoseGraph, graph: PoseGraph, earlier: int, later: int, p_i_j: np.ndarray, q_i_j: np.ndarray
) -> PoseGraph:
    """An accepted loop: the pose (p, q) of keyframe `later` in the frame of keyframe `earlier`.

    The first loop between two groups of sessions moves the younger group as a whole (REFERENCE U4): by position and
    turn about gravity, or with 6 DoF by all of the pose.
    """
    if not 0 <= earlier < later < graph.n_keyframes:
        raise ValueError(f"no loop between keyframes {earlier} and {later} of {graph.n_keyframes}")
    T_i_j = np.concatenate([p_i_j, so3.normalize(np.asarray(q_i_j))])
    rows = graph.loop_rows.append(graph.n_loops, pair=(earlier, later), T_i_j=T_i_j)
    graph = replace(graph, n_loops=graph.n_loops + 1, loop_rows=rows)
    group_i, group_j = graph.groups[[earlier, later]]
    if group_i == group_j:
        return graph
    T_g_b = graph.T_corrected
    if group_i < group_j:
        moved, seen, held = later, T_g_b[later], poses.compose(T_g_b[earlier], T_i_j)
    else:
        moved, seen, held = earlier, T_g_b[earlier], poses.compose(T_g_b[later], poses.inverse(T_i_j))
    return _merge(graph, moved, min(group_i, group_j), shift(settings, held, seen))


def extend(
    graph: PoseGraph,
    frame: np.ndarray,
    t_ns: np.ndarray,
    session: np.ndarray,
    T_vio: np.ndarray,
    loops: np.ndarray,
    T_loops: np.ndarray,
) -> PoseGraph:
    """`graph` with further rows as the properties of the same names have them; merges nothing."""
    keyframes = graph.keyframe_rows.extend(graph.n_keyframes, frame=frame, t_ns=t_ns, session=session, T_vio=T_vio)
    rows = graph.loop_rows.extend(graph.n_loops, pair=loops, T_i_j=T_loops)
    return replace(
        graph,
        n_keyframes=graph.n_keyframes + len(frame),
        n_loops=graph.n_loops + len(loops),
        keyframe_rows=keyframes,
        loop_rows=rows,
    )


def shift(settings: params.PoseGraph, T_g_b: np.ndarray, T_u_b: np.ndarray) -> np.ndarray:
    """T_g_u, (7,), that takes a body from `T_u_b` to `T_g_b`, as far as the degrees of freedom allow."""
    if settings.dof == "6":
        return poses.correction(T_g_b, T_u_b)
    q = heading.about_gravity(heading.difference(T_g_b[3:], T_u_b[3:]))
    return np.concatenate([T_g_b[:3] - so3.rotate(q, T_u_b[:3]), q])


def _merge(graph: PoseGraph, keyframe: int, group: int, moved: np.ndarray) -> PoseGraph:
    """Move all sessions that share a frame with `keyframe` by the transform `moved` and give them to `group`."""
    old = graph.groups[keyframe]
    T_g_b = graph.T_corrected.copy()
    rows = graph.groups == old
    T_g_b[rows] = poses.compose(moved, T_g_b[rows])
    sessions = tuple(
        replace(s, drift=poses.compose(moved, s.drift), group=int(group)) if s.group == old else s
        for s in graph.sessions
    )
    return replace(graph, optimized=frozen(T_g_b), sessions=sessions)


def disable(graph: PoseGraph, earlier: int, later: int, off: bool = True) -> PoseGraph:
    """An edge that the next optimisation leaves out, or (`off=False`) counts again."""
    pair = {(earlier, later)}
    return replace(graph, disabled=graph.disabled | pair if off else graph.disabled - pair)


def force(graph: PoseGraph, earlier: int, later: int, on: bool = True) -> PoseGraph:
    """A loop that the next optimisation counts in full, without robust loss."""
    pair = {(earlier, later)}
    return replace(graph, forced=graph.forced | pair if on else graph.forced - pair)


def adopt(graph: PoseGraph, optimized: PoseGraph) -> PoseGraph:
    """The result of an optimisation that began on an earlier state of `graph`: later keyframes follow by the drift.

    If sessions were merged meanwhile the result speaks of frames that no longer exist, and `graph` stays as it is.
    """
    known = optimized.sessions
    if [s.group for s in known] != [s.group for s in graph.sessions[: len(known)]]:
        return graph
    sessions = (*known, *graph.sessions[len(known) :])
    return replace(graph, optimized=optimized.optimized, sessions=sessions)


def frozen(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array
