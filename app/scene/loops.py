"""The pose graph in 3D: keyframes before and after, loops by what became of them, and the selected pair.

before, by the odometry     faint
after                       solid; keyframes and landmarks of a loaded map rose
accepted loop               solid green; thinner the less the robust loss lets it count
refused candidate           dashed vermillion
selected pair               yellow
after the user's edits      pink
seen again by the window    pink pyramid: the earlier keyframe as the window placed it
"""

from __future__ import annotations

import numpy as np
import viser

from vins_core.geometry import se3

from .. import palette
from ..graph import GraphView
from .comparison import dash_edges, pyramid
from .frame import SceneFrame, vertical_fov
from .nodes import Points, Segments
from .trajectory import polyline

FAINT = (62, 74, 86)
MOST_REFUSED = 400


class LoopLayer:
    toggles = {  # noqa: RUF012
        "loops.graph": "pose graph: before, after",
        "loops.accepted": "loops: accepted",
        "loops.refused": "loops: refused",
        "loops.window": "relocalisation in the window",
    }

    def __init__(self, scene: viser.SceneApi) -> None:
        colour = palette.rgb
        self._before = Segments(scene, "/loops/before", FAINT, 1.4)
        self._after = Segments(scene, "/loops/after", colour(palette.OK), 2.0)
        self._base = Segments(scene, "/loops/base", colour(palette.UNTRACKED), 2.0)
        self._map = Points(scene, "/loops/map", colour(palette.UNTRACKED), "circle", 0.02)
        self._edited = Segments(scene, "/loops/edited", colour(palette.FORK), 2.4)
        self._accepted = Segments(scene, "/loops/accepted", colour(palette.OK), 1.6)
        self._doubted = Segments(scene, "/loops/doubted", colour(palette.OK), 0.7)
        self._refused = Segments(scene, "/loops/refused", colour(palette.BAD), 1.0)
        self._selected = Segments(scene, "/loops/selected", colour(palette.SELECTION), 3.0)
        self._window = Segments(scene, "/loops/window", colour(palette.FORK), 2.0)
        self._nodes: dict[str, tuple[Segments | Points, ...]] = {
            "loops.graph": (self._before, self._after, self._base, self._map, self._edited),
            "loops.accepted": (self._accepted, self._doubted, self._selected),
            "loops.refused": (self._refused,),
            "loops.window": (self._window,),
        }
        self._run: object = None
        self._graph: GraphView | None = None  # the newest there is, until another is worked out

    def update(self, frame: SceneFrame) -> None:
        if self._run is not frame.run:
            self._run, self._graph = frame.run, None
        graph = self._graph = frame.graph or self._graph
        self._window.update(seen_again(frame))
        nothing = np.zeros((0, 2, 3))
        if graph is None:
            lines = (self._before, self._after, self._base, self._edited, self._accepted, self._doubted, self._refused)
            for node in (*lines, self._selected):
                node.update(nothing)
            self._map.update(np.zeros((0, 3)), 0.01)
            return
        self._before.update(sessions(graph.before, graph.session))
        self._after.update(sessions(graph.after, np.where(graph.base, -1, graph.session)))
        self._base.update(sessions(graph.after, np.where(graph.base, graph.session, -1)))
        self._edited.update(nothing if graph.edited is None else sessions(graph.edited, graph.session))
        self._map.update(graph.map_points, 0.005 * frame.unit_m)
        firm, doubted = accepted(graph)
        self._accepted.update(firm)
        self._doubted.update(doubted)
        self._refused.update(refused(graph, frame))
        self._selected.update(chosen(graph, frame))

    def show(self, toggle: str, on: bool) -> None:
        for node in self._nodes[toggle]:
            node.show(on)


def sessions(p: np.ndarray, session: np.ndarray) -> np.ndarray:
    """(m, 2, 3): a line through the keyframes of each session; -1 is none."""
    lines = [polyline(p[session == s]) for s in np.unique(session[session >= 0])]
    return np.concatenate([np.zeros((0, 2, 3)), *lines])


def accepted(graph: GraphView) -> tuple[np.ndarray, np.ndarray]:
    """Edges in the graph that count at least half, and those that count less; switched off ones are left out."""
    p = graph.after if graph.edited is None else graph.edited
    edges = [e for e in graph.edges if e.pair not in graph.edits.disabled]
    pairs = np.array([e.pair for e in edges], int).reshape(-1, 2)
    firm = np.array([e.weight >= 0.5 for e in edges], bool)
    return p[pairs[firm]], p[pairs[~firm]]


def refused(graph: GraphView, frame: SceneFrame) -> np.ndarray:
    """(m, 2, 3) dashes between the keyframes of candidates that were looked at up to the frame shown."""
    known = frame.loops.refused if frame.loops is not None else ()
    pairs = np.array([pair for pair in known if pair[1] < len(graph.after)], int).reshape(-1, 2)
    return dash_edges(graph.after[pairs[-MOST_REFUSED:]])


def chosen(graph: GraphView, frame: SceneFrame) -> np.ndarray:
    """(m, 2, 3) the pair looked at, dashed unless it is a loop."""
    pair = frame.loops.pair if frame.loops is not None else None
    if pair is None or pair.candidate is None or pair.candidate.query >= len(graph.after):
        return np.zeros((0, 2, 3))
    ends = (pair.candidate.match, pair.candidate.query)
    line = (graph.after if graph.edited is None else graph.edited)[np.array([ends])]
    return line if pair.candidate.accepted else dash_edges(line)


def seen_again(frame: SceneFrame) -> np.ndarray:
    """(m, 2, 3) pyramids of the earlier keyframes where this frame's window placed them."""
    fov, aspect = vertical_fov(frame.camera)
    drawn = [np.zeros((0, 2, 3))]
    for report in frame.report.relocalizations:
        T_w_b = se3.from_quaternion_translation(report.T_w_match[3:], report.T_w_match[:3])
        drawn.append(dash_edges(pyramid(T_w_b @ frame.camera.T_b_c, fov, aspect, 0.08 * frame.unit_m)))
    return np.concatenate(drawn)
