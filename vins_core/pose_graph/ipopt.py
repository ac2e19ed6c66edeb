"""Is this the optimum?  The same graph through IPOPT, a solver that shares only the residual with ours (SPEC 5.3).

The robust cost is written as one CasADi expression over all edges, and IPOPT gets its exact gradient and Hessian.
With 6 DoF a free pose is moved by (1, d/2) normalised, which reaches all rotations but that by 180 degrees.  Meant for
graphs of some hundred keyframes: building the Hessian takes longer than solving.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..factors.symbolic import multiply, small_rotation
from .problem import Problem


@dataclass(frozen=True)
class Optimum:
    nodes: np.ndarray  # (n, size) of all keyframes
    cost: float
    iterations: int
    termination: str  # IPOPT's return status


def solve_ipopt(problem: Problem, max_iterations: int = 200, tolerance: float = 1e-10) -> Optimum:
    """The minimum of `problem` from its nodes; `tolerance` is IPOPT's, on the gradient in units of the residual."""
    dof, m = problem.variant.dof, len(problem.free)
    d = ca.SX.sym("d", dof, m)
    move = _move(problem)
    nodes = ca.SX(problem.nodes.T)
    for column, keyframe in enumerate(problem.free.tolist()):
        nodes[:, keyframe] = move(nodes[:, keyframe], d[:, column])
    y = ca.vec(d)
    solver = ca.nlpsol(
        "pose_graph",
        "ipopt",
        {"x": y, "f": _cost(problem, nodes)},
        {
            "print_time": False,
            "error_on_fail": False,
            "ipopt": {"print_level": 0, "sb": "yes", "max_iter": max_iterations, "tol": tolerance},
        },
    )
    solution = solver(x0=np.zeros(m * dof))
    stats = solver.stats()
    found = np.array(ca.Function("nodes", [y], [nodes])(solution["x"])).T
    return Optimum(found, float(solution["f"]), int(stats["iter_count"]), str(stats["return_status"]))


def _move(problem: Problem) -> ca.Function:
    """(node, d) -> node moved by d, exactly on the manifold."""
    size, dof = problem.nodes.shape[1], problem.variant.dof
    x, d = ca.SX.sym("x", size), ca.SX.sym("d", dof)
    is_pose = problem.variant.factor.blocks[0].is_pose
    moved = ca.vertcat(x[:3] + d[:3], multiply(x[3:], small_rotation(d[3:]))) if is_pose else x + d
    return ca.Function("move", [x, d], [moved])


def _cost(problem: Problem, nodes: ca.SX) -> ca.SX:
    residual = problem.variant.factor.function(())
    total = ca.SX(0)
    for row, (i, j) in enumerate(zip(problem.edges.i.tolist(), problem.edges.j.tolist())):
        s = ca.sumsqr(residual(nodes[:, i], nodes[:, j], problem.data[:, row]))
        rho = problem.loss.rho_symbolic(s) if problem.robust[row] else s
        total += 0.5 * problem.outer[row] ** 2 * rho
    return total
