"""What each event of the page does.  The page's side of an event is in browser.py: a new one is a struct there and a
case here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .browser import (
    Apply,
    AskOptimum,
    Compare,
    Edge,
    Event,
    Fork,
    FrontEnd,
    GoTo,
    Keep,
    Knob,
    Layer,
    Link,
    Load,
    Loops,
    Open,
    Page,
    Painted,
    Pick,
    Play,
    Rename,
    Reset,
    Save,
    Seek,
    Set,
    Side,
    Span,
    Step,
    Stop,
)
from .context import Selection

if TYPE_CHECKING:
    from .session import Session


def handle(session: Session, event: Event) -> None:
    match event:
        case Seek(share):
            session.go(round(share * (session.cursor.length - 1)))
        case GoTo(frame):
            session.go(frame)
        case Step(by, keyframe):
            session.step(by, keyframe)
        case Play():
            session.play()
        case Pick("track" | "frame" as kind, id, other):
            session.select(Selection(kind, id, other) if id >= 0 else Selection())
        case Pick("loop", query, match):
            session.look_at_loop(query, match)
        case Pick("fix", row):
            session.look_at_fix(row)
        case Loops(show):
            session.show_loops(show)
        case Edge(do, earlier, later):
            session.edit_edge(do, earlier, later)
        case Apply(changes):
            session.apply_knobs(changes)
        case Knob(key):
            session.explain(key)
        case Set(key, value):
            session.set_knob(key, value)
        case Reset():
            session.reset_knobs()
        case FrontEnd(on):
            session.run_front_end(on)
        case Save():
            session.save_parameters()
        case Load(text, name):
            session.load_parameters(text, name)
        case Span(frames):
            session.set_span(frames)
        case Fork(at):
            session.fork(at)
        case AskOptimum():
            session.ask_optimum()
        case Side(name):
            session.show_prior(name)
        case Open(id):
            session.use_run(id)
        case Compare(id):
            session.compare_with(id)
        case Rename(id, name):
            session.rename(id, name)
        case Keep(id, on):
            session.keep(id, on)
        case Stop(id):
            session.stop(id)
        case Layer(name, on):
            session.show_layer(name, on)
        case Link(run, frame, layout):
            session.reproduce(run, frame, layout)
        case Page(panels, width, height, canvas):
            session.see(set(panels), (width, height), canvas)
        case Painted():
            session.drawing.painted()
