"""Is this the minimum?  The same chain through IPOPT, which shares only the residuals with our solver (SPEC 5.3).

The cost is one CasADi expression, of which IPOPT gets the exact gradient and Hessian.  Nodes are moved on the manifold
by (1, d/2) normalised.  Meant for some hundred nodes: building the Hessian takes longer than solving.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..factors.gps import ANTENNA, DRIFT
from ..factors.symbolic import conjugate, multiply, small_rotation
from .chain import Chain
from .drift import SIZE


@dataclass(frozen=True)
class Optimum:
    x: np.ndarray  # (n, 8)
    cost: float
    iterations: int
    termination: str  # IPOPT's return status


def solve_ipopt(
    chain: Chain, x: np.ndarray, used: np.ndarray, max_iterations: int = 200, tolerance: float = 1e-10
) -> Optimum:
    """The minimum from nodes (n, 8) with the fixes of the mask (m,); `tolerance` is IPOPT's, on the scaled gradient."""
    n, t = len(chain), len(chain.free)
    d = ca.SX.sym("d", t, n)
    full = ca.SX.zeros(SIZE, n)
    for row, component in enumerate(chain.free.tolist()):
        full[component, :] = d[row, :]
    nodes = [_move(x[k], full[:, k]) for k in range(n)]
    y = ca.vec(d)
    solver = ca.nlpsol(
        "gps_chain",
        "ipopt",
        {"x": y, "f": _cost(chain, nodes, used)},
        {
            "print_time": False,
            "error_on_fail": False,
            "ipopt": {"print_level": 0, "sb": "yes", "max_iter": max_iterations, "tol": tolerance},
        },
    )
    solution = solver(x0=np.zeros(n * t))
    stats = solver.stats()
    found = np.array(ca.Function("nodes", [y], [ca.horzcat(*nodes)])(solution["x"])).T
    return Optimum(found, float(solution["f"]), int(stats["iter_count"]), str(stats["return_status"]))


def _move(x: np.ndarray, d: ca.SX) -> ca.SX:
    return ca.vertcat(x[:3] + d[:3], multiply(ca.SX(x[3:7]), small_rotation(d[3:6])), x[7] + d[6])


def _cost(chain: Chain, nodes: list[ca.SX], used: np.ndarray) -> ca.SX:
    free, first, prior = chain.free.tolist(), nodes[0], chain.prior
    turned = 2 * multiply(conjugate(ca.SX(prior.at[3:7])), first[3:7])[1:]
    d = ca.vertcat(first[:3] - prior.at[:3], turned, first[7] - prior.at[7])[free]
    total = ca.dot(ca.DM(prior.gradient), d) + 0.5 * ca.bilin(ca.DM(prior.information), d, d)
    drift, antenna = DRIFT.function(()), ANTENNA.function(())
    for k, information in enumerate(chain.increment_information):
        i, j = nodes[k], nodes[k + 1]
        r = drift(i[:7], i[7], j[:7], j[7], chain.increment_data[:, k])[free]
        total += 0.5 * ca.bilin(ca.DM(information), r, r)
    for m in np.flatnonzero(used).tolist():
        r = antenna(nodes[chain.fixes.node[m]][:7], chain.fix_data[:, m])
        total += 0.5 * chain.loss.rho_symbolic(ca.bilin(ca.DM(chain.fix_information[m]), r, r))
    return total
