"""One entry for every window: minimise with the method that the parameters name."""

from __future__ import annotations

from ..params import Params
from . import dogleg, levenberg_marquardt
from .problem import WindowProblem
from .trust_region import Solution

METHODS = {"lm": levenberg_marquardt.solve, "dogleg": dogleg.solve}


def solve(params: Params, problem: WindowProblem) -> Solution:
    """Minimise the cost of `problem` from its initial states, in at most `window.max_iterations` steps."""
    return METHODS[params.solver.method](params.solver, params.window.max_iterations, problem)
