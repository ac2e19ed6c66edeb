from dataclasses import replace

import numpy as np
import pytest
import synthetic_window as sw

from vins_core.geometry import so3
from vins_core.params import Params
from vins_core.solver import levenberg_marquardt as lm
from vins_core.solver import trust_region
from vins_core.solver.linearize import Linearizer
from vins_core.window.assemble import assemble, unpack

SETTINGS = Params().solver


def problem(**options):
    flight = sw.make(n_tracks=80, **options)
    return flight, assemble(Params(), flight.window, sw.GRAVITY)


def relative(frames) -> tuple[np.ndarray, np.ndarray]:
    """Positions and attitudes seen from the oldest frame: free of position and yaw."""
    p, q = np.array([f.p_w_b for f in frames]), np.array([f.q_w_b for f in frames])
    back = so3.inverse(q[0])
    return so3.rotate(back, p - p[0]), so3.multiply(back, q)


def test_truth_is_recovered_without_noise():
    flight, built = problem(pixel_sigma=0.0, imu_noise=0.0, imu_hz=1000.0)
    solution = lm.solve(replace(SETTINGS, function_tolerance=0.0), 30, built.problem)
    solved = unpack(flight.window, built, solution.states)
    p, q = relative(solved.frames)
    p_true, q_true = relative(flight.truth.frames)
    np.testing.assert_allclose(p, p_true, atol=2e-4)
    np.testing.assert_allclose(so3.difference(q, q_true), 0, atol=2e-4)
    np.testing.assert_allclose([f.b_g for f in solved.frames], np.tile(sw.B_G, (11, 1)), atol=1e-4)


def test_accepted_steps_lower_the_cost_and_rejected_ones_change_nothing():
    _, built = problem(outliers=0.05, perturbation=3.0)
    linearizer = Linearizer(built.problem)
    at = lm.init(replace(SETTINGS, initial_radius=1e4), linearizer, built.problem.initial)
    for _ in range(8):
        before, at = at, lm.step(SETTINGS, linearizer, at)
        if at.reports[-1].accepted:
            assert at.system.cost.total < before.system.cost.total
            assert at.system.cost.total == at.reports[-1].cost
        else:
            assert at.states is before.states and at.system is before.system
            assert at.radius < before.radius


def test_a_bad_step_is_rejected_and_the_region_shrinks_faster_each_time():
    _, built = problem()
    linearizer = Linearizer(built.problem)
    strict = replace(SETTINGS, min_gain_ratio=100.0)
    at = lm.init(strict, linearizer, built.problem.initial)
    radii = [at.radius]
    for _ in range(3):
        at = lm.step(strict, linearizer, at)
        radii.append(at.radius)
    assert not any(r.accepted for r in at.reports)
    np.testing.assert_allclose(np.divide(radii[:-1], radii[1:]), [2, 4, 8])


def test_the_quadratic_model_predicts_the_cost_near_the_optimum():
    _, built = problem(pixel_sigma=0.2)
    quadratic = replace(built.problem, loss=replace(built.problem.loss, kind="none"))
    optimum = lm.solve(replace(SETTINGS, function_tolerance=0.0), 25, quadratic).states
    linearizer = Linearizer(quadratic)
    rng = np.random.default_rng(0)
    near = linearizer.retract(
        optimum, rng.normal(0, 1e-5, linearizer.layout.size), rng.normal(0, 1e-5, len(optimum.inv_depths))
    )
    at = lm.step(SETTINGS, linearizer, lm.init(SETTINGS, linearizer, near))
    assert at.reports[-1].gain_ratio == pytest.approx(1.0, abs=0.02)


def test_position_and_yaw_of_the_oldest_frame_are_held():
    _, built = problem()
    solution = lm.solve(SETTINGS, 8, built.problem)
    before, after = built.problem.initial.poses[0], solution.states.poses[0]
    np.testing.assert_allclose(after[:3], before[:3], atol=1e-6)
    turn = so3.multiply(after[3:], so3.inverse(before[3:]))
    assert np.linalg.norm(turn[1:3]) > 1e-3  # roll and pitch are observable and free
    assert abs(turn[3]) < 1e-2 * np.linalg.norm(turn[1:3])


def test_the_minimum_does_not_depend_on_how_strongly_the_gauge_is_held(monkeypatch):
    _, built = problem()
    exact = replace(SETTINGS, function_tolerance=0.0)
    costs = []
    for information in (1e4, 1e8):
        monkeypatch.setattr(trust_region, "GAUGE_INFORMATION", information)
        costs.append(lm.solve(exact, 30, built.problem).after.total)
    assert costs[0] == pytest.approx(costs[1], rel=1e-7)


def test_stepping_by_hand_equals_solving():
    _, built = problem()
    linearizer = Linearizer(built.problem)
    at = lm.init(SETTINGS, linearizer, built.problem.initial)
    while (why := lm.terminate(SETTINGS, at, 5)) is None:
        at = lm.step(SETTINGS, linearizer, at)
    solution = lm.solve(SETTINGS, 5, built.problem)
    assert solution.termination == why and solution.iterations == at.reports
    np.testing.assert_array_equal(solution.states.poses, at.states.poses)


def test_same_problem_gives_the_same_bits():
    one, two = (lm.solve(SETTINGS, 8, problem(outliers=0.05)[1].problem) for _ in range(2))
    assert one.states.poses.tobytes() == two.states.poses.tobytes()
    assert one.states.inv_depths.tobytes() == two.states.inv_depths.tobytes()
    assert one.after == two.after


def test_termination_says_why():
    _, built = problem()
    p = built.problem
    assert lm.solve(SETTINGS, 2, p).termination == "stopped after 2 iterations"
    assert "less than 0.001 of itself" in lm.solve(replace(SETTINGS, function_tolerance=1e-3), 50, p).termination
    optimum = lm.solve(replace(SETTINGS, function_tolerance=0.0), 40, p).states
    again = lm.solve(SETTINGS, 8, replace(p, initial=optimum))
    assert len(again.iterations) == 1 and again.termination.startswith("converged")
    empty = replace(p, projections=p.projections[:0], imu=(), prior=None)
    assert lm.solve(SETTINGS, 8, empty).termination == "converged: the cost is zero"
    lost = replace(p.initial, poses=np.full_like(p.initial.poses, np.nan))
    assert "not finite" in lm.solve(SETTINGS, 8, replace(p, initial=lost)).termination


def test_the_robust_loss_keeps_outliers_from_moving_the_window():
    def solved(kind: str, outliers: float) -> np.ndarray:
        flight, built = problem(outliers=outliers, pixel_sigma=0.3)  # same scene and noise, but for the outliers
        p = replace(built.problem, loss=replace(built.problem.loss, kind=kind))
        return relative(unpack(flight.window, built, lm.solve(SETTINGS, 30, p).states).frames)[0]

    moved = {kind: np.linalg.norm(solved(kind, 0.05) - solved(kind, 0.0)) for kind in ("none", "cauchy", "huber")}
    assert moved["cauchy"] < 0.3 * moved["none"]
    assert moved["huber"] < 0.6 * moved["none"]
