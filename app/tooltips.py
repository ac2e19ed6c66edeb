"""What every quantity and gate on the page means: equation, unit, frame, source.

An element with `data-tip="key"` shows `TIPS[key]` under the pointer; page.js gets the whole dictionary once.
Parameters explain themselves through their declaration (`param.section.name`), and so does every gate that has no
entry of its own here (`gate.section.name`, the parameter behind it).
The tips themselves stand in `tips/`, a file a subject.
Sources: "seed 004.10" is section 10 of the founding document 004, "W4" a line of the inventory of VINS.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from vins_core.params import DECLARATIONS, Declaration
from vins_core.report import Gate

from .tips.calibration import CALIBRATION
from .tips.depth import DEPTH
from .tips.frontend import FRONTEND
from .tips.gates import GATES
from .tips.gps import GPS
from .tips.hand_eye import HAND_EYE
from .tips.loops import LOOPS
from .tips.prior import PRIOR
from .tips.stages import STAGES
from .tips.time_travel import WHAT_IF
from .tips.tip import Tip
from .tips.window import SOLVE, STATE, WINDOW


def _of_parameter(d: Declaration) -> Tip:
    span = f"{d.low:g} to {d.high:g}" if d.low is not None and d.high is not None else ", ".join(d.choices)
    default = {True: "on", False: "off"}.get(d.default, d.default) if d.type is bool else d.default
    return Tip(
        d.key,
        d.doc[:1].upper() + d.doc[1:] + ".",
        f"default {default}" + (f"   range {span}" if span else ""),
        unit=d.unit,
    )


_PARAMETERS = {f"param.{d.key}": _of_parameter(d) for d in DECLARATIONS.values()}
_GATES_BY_PARAMETER = {
    f"gate.{d.key}": Tip(d.key.split(".")[1].replace("_", " "), tip.text, unit=d.unit)
    for d, tip in zip(DECLARATIONS.values(), _PARAMETERS.values())
}

TIPS: Mapping[str, Tip] = MappingProxyType(
    {
        **_PARAMETERS,
        **_GATES_BY_PARAMETER,
        **GATES,
        **FRONTEND,
        **WINDOW,
        **SOLVE,
        **STATE,
        **STAGES,
        **HAND_EYE,
        **WHAT_IF,
        **PRIOR,
        **LOOPS,
        **GPS,
        **CALIBRATION,
        **DEPTH,
    }
)


def gate_tip(gate: Gate) -> str:
    """Key of the tip that explains a gate: of loop closing by its name, of others by the parameter behind it, or by its
    name; "" when there is none."""
    of_loops = f"gate.loop.{gate.name}" if gate.knob.startswith("loop.") else ""
    return next((key for key in (of_loops, f"gate.{gate.knob or gate.name}") if key in TIPS), "")


def parameter_tip(key: str) -> str:
    """Key of a parameter's tip, "" for a parameter of another version."""
    return f"param.{key}" if key in DECLARATIONS else ""


def page_tips() -> dict[str, str]:
    """Every tip as html, for the page."""
    return {key: tip.html() for key, tip in TIPS.items()}
