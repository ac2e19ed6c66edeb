"""Depths in the normal equations: what they add, and what holding a landmark does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic_window as sw

from vins_core.factors.robust import Loss
from vins_core.params import Params
from vins_core.solver.depth_term import HELD_INFORMATION
from vins_core.solver.ipopt import compare_optimum
from vins_core.solver.linearize import Linearizer
from vins_core.solver.problem import Depths, WindowProblem
from vins_core.solver.solve import solve
from vins_core.window.assemble import assemble

PARAMS = Params()
SIGMA = 0.01


def problem(seed: int = 0, held: int = 0, share: float = 0.7, noise: float = SIGMA) -> WindowProblem:
    """A window in flight whose landmarks have depths with noise; the first `held` ones are held at the truth."""
    flight = sw.make(seed, n_tracks=120)
    assembly = assemble(PARAMS, flight.window, sw.GRAVITY)
    table = flight.truth.landmarks
    true = table.inv_depth[np.searchsorted(table.ids, assembly.ids)]
    rng = np.random.default_rng(seed)
    rows = np.flatnonzero(rng.random(len(true)) < share)
    rows, inv_depths = rows[rows >= held], assembly.problem.initial.inv_depths.copy()
    inv_depths[:held] = true[:held]
    depth_m = (1 + noise * rng.standard_normal(len(rows))) / true[rows]
    depths = Depths(rows, depth_m, SIGMA, np.arange(held))
    return replace(assembly.problem, initial=replace(assembly.problem.initial, inv_depths=inv_depths), depths=depths)


@pytest.mark.parametrize("loss", [Loss(), Loss("cauchy", 1.0), Loss("huber", 1.0)])
def test_cost_gradient_and_curvature_agree_with_differences(loss: Loss) -> None:
    window = replace(problem(1, noise=0.03), loss=loss)
    linearizer, alone = Linearizer(window), Linearizer(replace(window, depths=None))
    x, rows = window.initial, window.depths.landmark
    at, without = linearizer.linearize(x), alone.linearize(x)
    assert at.cost.depth > 0 and at.cost.total == pytest.approx(without.cost.total + at.cost.depth)
    assert at.cost.depth == pytest.approx(0.5 * loss.rho(at.residuals.depth**2).sum())
    np.testing.assert_array_equal(at.H, without.H)
    np.testing.assert_array_equal(at.W, without.W)
    assert (np.delete(at.h - without.h, rows) == 0).all() and (np.delete(at.g_l - without.g_l, rows) == 0).all()
    for row in rows[:5]:
        d = 1e-6 * np.eye(len(x.inv_depths))[row]
        costs = [linearizer.linearize(replace(x, inv_depths=x.inv_depths + s * d)).cost.depth for s in (1, -1)]
        assert (at.g_l - without.g_l)[row] == pytest.approx((costs[0] - costs[1]) / 2e-6, rel=1e-4, abs=1e-3)


def test_where_residuals_are_small_the_curved_hessian_is_the_plain_one() -> None:
    window = problem(2, noise=1e-6, share=1.0)
    exact = replace(window.initial, inv_depths=1 / window.depths.depth_m)
    linearizer, alone = Linearizer(window), Linearizer(replace(window, depths=None))
    added = [linearizer.linearize(exact, c).h - alone.linearize(exact, c).h for c in (False, True)]
    np.testing.assert_allclose(added[0], added[1], rtol=1e-6)
    np.testing.assert_allclose(added[0], (window.depths.depth_m / SIGMA) ** 2, rtol=1e-6)


def test_a_held_landmark_stays_and_its_projections_tell_the_poses_all_they_know() -> None:
    window = problem(3, held=30)
    at, free = (Linearizer(p).linearize(window.initial) for p in (window, replace(window, depths=None)))
    held = window.depths.held
    assert (at.W[held] == 0).all() and (at.g_l[held] == 0).all() and (at.h[held] == HELD_INFORMATION).all()
    np.testing.assert_array_equal(at.H, free.H)
    solution = solve(PARAMS, window)
    np.testing.assert_array_equal(solution.states.inv_depths[held], window.initial.inv_depths[held])
    assert (np.delete(solution.states.inv_depths - window.initial.inv_depths, held) != 0).all()
    assert solution.after.total < 0.5 * solution.before.total


@pytest.mark.parametrize("held", [0, 40])
def test_depths_make_the_window_know_its_scale(held: int) -> None:
    """Without IMU, and with poses and points shrunk together, nothing but depth says how large the world is."""
    window = replace(problem(4, held), imu=(), inertial=False)
    poses = window.initial.poses.copy()
    poses[:, :3] = poses[0, :3] + 0.8 * (poses[:, :3] - poses[0, :3])
    start = replace(window, initial=replace(window.initial, poses=poses))
    params = replace(PARAMS, window=replace(PARAMS.window, max_iterations=40))
    lengths = [np.linalg.norm(p[-1, :3] - p[0, :3]) for p in (solve(params, start).states.poses, sw.position([1, 2.0]))]
    assert lengths[0] == pytest.approx(lengths[1], rel=0.01)


def test_our_solution_is_the_optimum_that_ipopt_finds() -> None:
    window = replace(problem(5, held=10), loss=Loss())
    params = replace(PARAMS, window=replace(PARAMS.window, max_iterations=40))
    found = compare_optimum(window, solve(params, window))
    assert abs(found.excess) < 1e-5 and found.inv_depth.max() < 1e-3
    assert (found.inv_depth[:10] == 0).all()


def test_those_that_leave_take_their_depths_along() -> None:
    depths = Depths(np.array([0, 2, 3]), np.array([1.0, 2.0, 3.0]), SIGMA, np.array([1, 4]))
    part = depths.among(np.array([False, True, True, False, True]))
    assert part.landmark.tolist() == [1] and part.depth_m.tolist() == [2.0] and part.held.tolist() == [0, 2]
