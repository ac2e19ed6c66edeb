"""What a panel sees: the run, the frame shown, what is selected.  Plain values; no viser, no browser.

A panel is a module in `app/panels` with

    TITLE: str   of its tab
    ICON: str    name in `viser.Icon`
    KEY: str     names it in layouts; its html carries it once as `data-vip="KEY"`, so that only visible panels render
    render(ctx: PanelContext) -> str             html of this frame, a pure function
    exists(run: RunView) -> bool                 optional: whether there is anything to show of a run at all
    backdrop(ctx: PanelContext) -> str           optional: html that depends only on the run, shown above `render`'s
                                                 and sent again only when the run grows
    backdrop_of(ctx: PanelContext) -> object     optional: what the backdrop depends on instead; sent when it changes

Text that comes from a file (topic, path, name) is escaped before it enters html.

In the page there is one helper object, `vi` (see browser.py), for html attributes:

    vi.send({k:'frame', i:12})                   go to a frame
    vi.send({k:'pick', t:'track', i:57})         select ("track", "frame", "loop" or "fix"); i:-1 clears;
                                                 j: a second frame, or the earlier keyframe of a loop
    vi.send({k:'step', d:1, kf:false})           one frame on, or one keyframe
    vi.send({k:'knob', key:'window.loss'})       to the knob of a parameter, in the What-if panel
    onpointerdown/onpointermove='vi.scrub(event,this)'   seek by the pointer's share of the element's width
    onwheel='vi.wheel(event,this)' onpointermove='vi.pan(event)' ondblclick='vi.reset()'   zoom and pan of an image;
                                                 with data-zoom='map' it has a zoom of its own, and vi.reset(this)

and CSS variables on the root: `--vi-x`, `--vi-y` (px) and `--vi-z` hold zoom and pan of the image, so that they
survive new content.  An element of class `vi-head` in a lane is moved to the shown frame's place in the run.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

from vins_core.errors import RunError
from vins_core.report import FrameReport, FrameSummary, Timings
from vins_core.sensors import Trajectory

from .series import RunSeries, run_series

if TYPE_CHECKING:
    from vins_core.fusion.conclusion import FinalTrack
    from vins_core.mapping.study import LoopStudy
    from vins_core.record.reader import RunReader
    from vins_core.record.reevaluate import GateHistory

    from .comparison import OtherRun
    from .experiment import ExperimentView
    from .graph import GraphView
    from .loops import LoopsView
    from .optimum import OptimumView
    from .prior import DepartureView, PriorView
    from .store import RunEntry

GATE_SLICE = 50
"""Frames whose gates are read at a time, so that whoever waits gets its turn."""


@dataclass(frozen=True)
class Selection:
    """What the user picked: nothing, a track (and with it its landmark), or one or two frames of the window."""

    kind: str = ""  # "" | "track" | "frame" | "loop" | "fix"
    id: int = -1  # of the track or the frame; of a loop, its later keyframe; of a fix, its row in the series
    other: int = -1  # a second frame, of a block of the prior that couples two; of a loop, its earlier keyframe

    def is_track(self, id: int) -> bool:
        return self.kind == "track" and self.id == id

    def is_frame(self, frame: int) -> bool:
        return self.kind == "frame" and frame in (self.id, self.other)


class RunView:
    """A run as the interface reads it: reports on demand (the last few hundred are kept), arrays over all frames."""

    def __init__(self, reader: RunReader) -> None:
        self.reader = reader
        self.report = lru_cache(maxsize=400)(reader.report)
        self.prior = lru_cache(maxsize=32)(self._prior)
        self._series = run_series([], None)
        self._reading = threading.Lock()

    def __len__(self) -> int:
        return len(self.summaries)

    @property
    def header(self) -> Any:
        return self.reader.header

    @property
    def complete(self) -> bool:
        """False while the estimator is still writing it."""
        return self.reader.complete

    @property
    def summaries(self) -> list[FrameSummary]:
        return self.reader.summaries

    @property
    def truth(self) -> Trajectory | None:
        return self.reader.truth

    @property
    def final(self) -> FinalTrack | None:
        """The trajectory held to all fixes; None while the run grows, and where there is none or it is damaged."""
        try:
            return self.reader.final_track
        except RunError:
            return None

    def ms(self, k: int) -> Timings:
        return self.summaries[k].ms

    @property
    def series(self) -> RunSeries:
        """Arrays over the frames read so far."""
        if len(self._series) != len(self.summaries):
            self._series = run_series(self.summaries, self.truth)
        return self._series

    def _prior(self, k: int) -> PriorView | None:
        """The prior after frame k; RunError when the record does not hold states."""
        from .prior import prior_view  # with it comes the estimator

        return prior_view(self.reader, k)

    @cached_property
    def gates(self) -> GateHistory:
        """Every gate of the run so far as columns; filled by `read_gates`."""
        from vins_core.record.reevaluate import GateHistory  # with it come the estimator and CasADi

        return GateHistory()

    @property
    def loops(self) -> LoopStudy:
        """The run's loops looked into on demand; RunError for a run without.  Safe in any thread."""
        with self._reading:
            return self._loops

    @cached_property
    def _loops(self) -> LoopStudy:
        from vins_core.mapping.study import LoopStudy  # with it comes the estimator

        return LoopStudy(self.reader)

    def read_gates(self, at_most: int = GATE_SLICE) -> int:
        """Take the gates of the next frames; returns how many frames are still missing.  Safe in any thread."""
        with self._reading:
            return self.gates.follow(self.reader, at_most)


@dataclass(frozen=True)
class PanelContext:
    run: RunView
    frame: int
    report: FrameReport
    ms: Timings
    selection: Selection
    image_uri: str  # data: URI of the frame's image, "" when there is none
    image_note: str  # why there is none, one sentence
    width: int  # of the image, px
    height: int
    second_uri: str = ""  # of the image that a second camera took with it
    second_note: str = ""  # why there is none
    playing: bool = False
    signals: tuple[str, ...] = ()  # names of the signals the layout wants plotted; empty: all
    progress: str = ""  # what the estimator is doing while it still runs, one sentence
    experiment: ExperimentView | None = None  # the knobs, and what they would have done here
    fork_frames: int = 0  # how many frames a fork computes; 0: to the end
    run_id: str = ""  # of the run shown
    runs: tuple[RunEntry, ...] = ()  # every run there is to open or compare with
    other: OtherRun | None = None  # the run compared with
    optimum: OptimumView | None = None  # what IPOPT said about this frame's window, when it was asked
    layers: tuple[tuple[str, str, bool], ...] = ()  # (name, title, drawn) of every layer of the 3D view
    prior_side: str = "after"  # which matrix the Prior panel shows: "after" | "before" | "fill-in"
    loops: LoopsView | None = None  # why loops close and do not; None for a run without
    graph: GraphView | None = None  # the pose graph, once it is worked out
    pair_uris: tuple[str, str] = ("", "")  # images of the two keyframes of `loops.pair`, the later first
    pair_notes: tuple[str, str] = ("", "")  # why there is none
    depth_uri: str = ""  # data: URI of the frame's depth image, coloured; "" where there is none, or nobody looks
    departure: DepartureView | None = None  # what marginalisation started from, once it is worked out
