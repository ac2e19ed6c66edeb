"""The same small graph through solvers that share no step with ours."""

import numpy as np
import pytest
import scipy.optimize
from pose_graph_world import laps, settings
from scipy.spatial.transform import Rotation

from vins_core.geometry import heading
from vins_core.pose_graph import levenberg_marquardt
from vins_core.pose_graph.edges import active_edges
from vins_core.pose_graph.ipopt import solve_ipopt
from vins_core.pose_graph.problem import assemble

CASES = [
    ("4", "none", "weighted"),
    ("4", "huber", "unweighted"),
    ("4", "cauchy", "weighted"),
    ("6", "huber", "unweighted"),
]


def small(dof: str, loss: str, loss_on: str, n: int = 60):
    s = settings(dof=dof, loss=loss, loss_on=loss_on, loop_weight=2.0, max_iterations=100, function_tolerance=1e-14)
    world = laps(n=n, lap=20, n_loops=12, wrong=0.2 if loss != "none" else 0.0, seed=4, turn_deg=0.3)
    return s, world.graph


@pytest.mark.parametrize(("dof", "loss", "loss_on"), CASES)
def test_ipopt_finds_the_same_optimum(dof, loss, loss_on):
    s, graph = small(dof, loss, loss_on, n=40 if dof == "6" else 60)
    problem = assemble(s, graph)
    ours, ipopt = levenberg_marquardt.solve(s, problem), solve_ipopt(problem)
    assert ipopt.termination == "Solve_Succeeded"
    assert ours.system.cost.total < 0.99 * ours.before.total
    assert ours.system.cost.total == pytest.approx(ipopt.cost, rel=1e-9)
    np.testing.assert_allclose(ours.nodes, ipopt.nodes, atol=1e-5)


@pytest.mark.parametrize("loss", ["none", "huber"])
def test_least_squares_on_residuals_written_by_hand_finds_the_same_optimum(loss):
    """4-DoF residuals from the docstring's formula, in plain NumPy, with Jacobians by differences."""
    s, graph = small("4", loss, "weighted")
    problem = assemble(s, graph)
    edges = active_edges(s, graph)
    free = problem.free
    edges = edges[np.isin(edges.j, free) | (edges.is_loop & np.isin(edges.i, free))]
    R = Rotation.from_quat(graph.T_vio[:, [4, 5, 6, 3]])
    R_ij = Rotation.from_quat(edges.T_i_j[:, [4, 5, 6, 3]])
    apart = (R[edges.i] * R_ij * R[edges.j].inv()).as_matrix()
    t_ij = np.arctan2(apart[:, 1, 0] - apart[:, 0, 1], apart[:, 0, 0] + apart[:, 1, 1])
    w_p = np.where(edges.is_loop, s.loop_weight, 1.0) / s.sigma_m
    w_r = np.where(edges.is_loop, s.loop_weight * s.loop_rotation_weight, 1.0) / np.deg2rad(s.sigma_deg)

    def residuals(y):
        p, psi = graph.T_vio[:, :3].copy(), np.zeros(len(graph))
        p[free], psi[free] = y.reshape(-1, 4)[:, :3], y.reshape(-1, 4)[:, 3]
        T = Rotation.from_rotvec(psi[edges.i, None] * [0, 0, 1]) * R[edges.i]
        r_p = T.inv().apply(p[edges.j] - p[edges.i]) - edges.T_i_j[:, :3]
        r_psi = heading.wrap(psi[edges.j] - psi[edges.i] - t_ij)
        r = np.column_stack([w_p[:, None] * r_p, w_r * r_psi])
        squared = np.sum(r * r, 1)
        share = np.where(edges.is_loop, problem.loss.rho(squared), squared) / np.maximum(squared, 1e-300)
        return (np.sqrt(share)[:, None] * r).ravel()

    start = np.column_stack([graph.T_vio[free, :3], np.zeros(len(free))]).ravel()
    theirs = scipy.optimize.least_squares(residuals, start, method="trf", xtol=1e-12, ftol=1e-13, gtol=1e-12)
    ours = levenberg_marquardt.solve(s, problem)
    assert ours.before.total == pytest.approx(0.5 * np.sum(residuals(start) ** 2), rel=1e-9)
    assert ours.system.cost.total == pytest.approx(theirs.cost, rel=1e-6)
    np.testing.assert_allclose(ours.nodes[free], theirs.x.reshape(-1, 4), atol=1e-3)
