"""All parameters of a run."""

from __future__ import annotations

from dataclasses import dataclass, field

from .frontend import Depth, Frontend
from .gps import Gps
from .imu import Imu
from .init import Init
from .loops import Loop, PoseGraph
from .window import Health, Marginalization, Online, Projection, Solver, Window


@dataclass(frozen=True)
class Params:
    frontend: Frontend = field(default_factory=Frontend)
    imu: Imu = field(default_factory=Imu)
    init: Init = field(default_factory=Init)
    window: Window = field(default_factory=Window)
    depth: Depth = field(default_factory=Depth)
    projection: Projection = field(default_factory=Projection)
    online: Online = field(default_factory=Online)
    solver: Solver = field(default_factory=Solver)
    marginalization: Marginalization = field(default_factory=Marginalization)
    health: Health = field(default_factory=Health)
    loop: Loop = field(default_factory=Loop)
    pose_graph: PoseGraph = field(default_factory=PoseGraph)
    gps: Gps = field(default_factory=Gps)
