"""Every tunable of the system, declared once: type, default, range, unit, meaning.

Command line, sliders, YAML and documentation derive from these declarations.  A parameter is addressed as
`section.name`.  "px460" is a pixel of a virtual camera of focal length 460, the unit of nearly every threshold of
VINS; "parity" names the value that reproduces the original C++.
"""

from .access import DECLARATIONS, Declaration, changed, declarations, get, parse_assignment, replace
from .all import Params
from .declaration import Doc, Range
from .frontend import Depth, Frontend
from .gps import Gps
from .imu import Imu
from .init import Init
from .loops import Loop, PoseGraph
from .window import Health, Marginalization, Online, Projection, Solver, Window

__all__ = [
    "DECLARATIONS",
    "Declaration",
    "Depth",
    "Doc",
    "Frontend",
    "Gps",
    "Health",
    "Imu",
    "Init",
    "Loop",
    "Marginalization",
    "Online",
    "Params",
    "PoseGraph",
    "Projection",
    "Range",
    "Solver",
    "Window",
    "changed",
    "declarations",
    "get",
    "parse_assignment",
    "replace",
]
