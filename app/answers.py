"""What a tab has worked out in threads: everything about a frame or a run that takes longer than a step may.

Each asks for what is missing when it is looked at, answers the latest wish only, and says which parts of the page have
something new to show.  A panel that needs another slow thing gets a `Latest` here and a field in `PanelContext`.
"""

from __future__ import annotations

from collections.abc import Callable

from .comparison import Comparer
from .experiment import Experiment
from .graph import graph_view
from .latest import Latest
from .loops import Loops
from .optimum import Optimum
from .prior import departure_view
from .uncertainty import uncertainty


class Answers:
    """`refresh(*parts)` draws parts of the page again: KEYs of panels and "scene"."""

    def __init__(self, refresh: Callable[..., None]) -> None:
        self.experiment = Experiment(refresh)
        self.comparer = Comparer(lambda: refresh("runs"))
        self.optimum = Optimum(lambda: refresh("inspect"))
        self.loops = Loops(lambda: refresh("loops", "pair", "graph", "scene"))
        self.graph = Latest(graph_view, lambda: refresh("graph", "scene"))
        self.departure = Latest(departure_view, lambda: refresh("prior"))
        self.uncertainty = Latest(uncertainty, lambda: refresh("scene"))

    def close(self) -> None:
        for work in (
            self.experiment, self.comparer, self.optimum, self.loops, self.graph, self.departure, self.uncertainty,
        ):  # fmt: skip
            work.close()
