from dataclasses import replace

import numpy as np
import pytest
import synthetic_window as sw

from vins_core import params as settings
from vins_core.params import Params
from vins_core.solver import dogleg, schur, trust_region
from vins_core.solver import levenberg_marquardt as lm
from vins_core.solver.linearize import Linearizer
from vins_core.solver.solve import solve
from vins_core.window.assemble import assemble

SETTINGS = Params().solver
CERES = replace(SETTINGS, damping="ceres")


def problem(seed: int = 0, **options):
    return assemble(Params(), sw.make(seed, n_tracks=80, **options).window, sw.GRAVITY).problem


def biased(seed: int = 0):
    """Near its minimum but for the accelerometer bias, which all frames share."""
    flight = sw.make(seed, n_tracks=80, perturbation=0.3)
    offset = np.array([0.05, -0.05, 0.025])
    frames = tuple(replace(f, b_a=f.b_a + offset) for f in flight.window.frames)
    return assemble(Params(), replace(flight.window, frames=frames), sw.GRAVITY).problem


def scaled(linearizer: Linearizer, at: dogleg.Iteration, after: dogleg.Iteration) -> np.ndarray:
    """The step between two iterations in the coordinates of the trust region."""
    path = dogleg._path(trust_region.rules(SETTINGS), at.system, at.states, at.mu)
    u, _ = dogleg._leave(path, at.radius)
    states = linearizer.retract(at.states, *np.split(u / path.scale, [len(at.system.g)]))
    np.testing.assert_array_equal(states.poses, after.states.poses)
    return u


def test_dogleg_and_levenberg_marquardt_find_the_same_minimum():
    p, exact = problem(perturbation=0.3), replace(SETTINGS, function_tolerance=0.0)
    by_dogleg, by_lm = dogleg.solve(exact, 40, p), lm.solve(exact, 40, p)
    assert by_dogleg.after.total == pytest.approx(by_lm.after.total, rel=1e-9)
    np.testing.assert_allclose(by_dogleg.states.poses, by_lm.states.poses, atol=1e-4)


@pytest.mark.parametrize("leg", ["gradient", "dogleg", "gauss-newton"])
def test_each_leg_ends_where_it_should(leg):
    p = problem()
    linearizer = Linearizer(p)
    at = dogleg.init(SETTINGS, linearizer, p.initial)
    path = dogleg._path(trust_region.rules(SETTINGS), at.system, at.states, at.mu)
    first, second = path.cauchy * np.linalg.norm(path.gradient), np.linalg.norm(path.gauss_newton)
    radius = {"gradient": 0.5 * first, "dogleg": np.sqrt(first * second), "gauss-newton": 1e12}[leg]
    at = replace(at, radius=radius)
    after = dogleg.step(SETTINGS, linearizer, at)
    assert after.reports[-1].leg == leg and after.reports[-1].accepted
    u = scaled(linearizer, at, after)
    if leg == "gauss-newton":
        H, h = at.system.H, at.system.h
        gauge = trust_region.gauge_damping(at.states.poses[0])
        expected = np.concatenate(schur.solve_damped(at.system, 1e-12 * H.diagonal(), 1e-12 * h, gauge))
        np.testing.assert_allclose(u / path.scale, expected)
    else:
        assert np.linalg.norm(u) == pytest.approx(radius)
    if leg == "gradient":
        np.testing.assert_allclose(u / radius, -path.gradient / np.linalg.norm(path.gradient))


def test_the_cauchy_point_is_the_lowest_along_the_gradient():
    p = problem()
    at = dogleg.init(SETTINGS, Linearizer(p), p.initial)
    path = dogleg._path(trust_region.rules(SETTINGS), at.system, at.states, at.mu)
    D = len(at.system.g)

    def model(t: float) -> float:
        d = -t * path.gradient / path.scale
        slope = at.system.g @ d[:D] + at.system.g_l @ d[D:]
        return slope + 0.5 * dogleg._curvature(at.system, d[:D], d[D:])

    assert model(path.cauchy) < min(model(0.99 * path.cauchy), model(1.01 * path.cauchy), 0.0)


def test_a_rejected_step_keeps_the_path_and_halves_itself():
    p, strict = problem(), replace(SETTINGS, min_gain_ratio=100.0, curved_below=0.0)
    linearizer = Linearizer(p)
    first = dogleg.step(strict, linearizer, dogleg.init(strict, linearizer, p.initial))
    second = dogleg.step(strict, linearizer, first)
    assert not any(r.accepted for r in second.reports)
    assert second.states is p.initial and second.path is first.path is not None
    length = np.linalg.norm(first.path.gauss_newton)
    assert first.radius == pytest.approx(length / 2) and second.radius == pytest.approx(length / 4)
    assert [r.leg for r in second.reports] == ["gauss-newton", "dogleg"]


def test_ceres_halves_the_radius_and_tries_the_same_step_again():
    p, strict = problem(), replace(CERES, min_gain_ratio=100.0)
    linearizer = Linearizer(p)
    at = replace(dogleg.init(strict, linearizer, p.initial), radius=1e12)
    for _ in range(2):
        at = dogleg.step(strict, linearizer, at)
    assert at.radius == 0.25e12 and at.reports[0].step_norm == at.reports[1].step_norm


def test_an_indefinite_system_is_damped_until_it_is_not():
    p = problem()
    at = dogleg.init(SETTINGS, Linearizer(p), p.initial)
    dented = replace(at.system, H=at.system.H - 1e-4 * np.diag(at.system.H.diagonal()))
    path = dogleg._path(trust_region.CERES, dented, at.states, trust_region.CERES.min_mu)
    assert 1e-5 < path.mu < 1
    hopeless = replace(at.system, H=-at.system.H)
    assert dogleg._path(trust_region.CERES, hopeless, at.states, trust_region.CERES.min_mu) is None


def test_the_quadratic_model_predicts_the_cost_near_the_optimum():
    p = problem(pixel_sigma=0.2)
    quadratic = replace(p, loss=replace(p.loss, kind="none"))
    optimum = dogleg.solve(replace(SETTINGS, function_tolerance=0.0), 25, quadratic).states
    linearizer = Linearizer(quadratic)
    rng = np.random.default_rng(0)
    near = linearizer.retract(
        optimum, rng.normal(0, 1e-5, linearizer.layout.size), rng.normal(0, 1e-5, len(optimum.inv_depths))
    )
    at = dogleg.step(SETTINGS, linearizer, dogleg.init(SETTINGS, linearizer, near))
    assert at.reports[-1].gain_ratio == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("method", ["lm", "dogleg"])
def test_ceres_damping_stalls_where_ours_does_not(method):
    """SOLVER.md: the information of the bias random walk makes diagonal damping freeze the bias all frames share."""
    minimise = {"lm": lm.solve, "dogleg": dogleg.solve}[method]
    for seed in range(3):
        p = biased(seed)
        optimum = lm.solve(replace(SETTINGS, function_tolerance=0.0), 60, p)
        moved = np.linalg.norm(optimum.states.speed_biases[0, 3:6] - p.initial.speed_biases[0, 3:6])
        ours, ceres = (minimise(s, 8, p) for s in (SETTINGS, CERES))
        best = optimum.after.total
        assert ceres.after.total > best * (1 + 5e-3)
        assert ours.after.total - best < 0.1 * (ceres.after.total - best)
        stuck = np.linalg.norm(ceres.states.speed_biases[0, 3:6] - p.initial.speed_biases[0, 3:6])
        assert stuck < 0.1 * moved


def test_the_parameters_choose_method_and_damping():
    p = problem()
    chosen = {
        (method, damping): solve(
            settings.replace(Params(), {"solver.method": method, "solver.damping": damping}), p
        ).iterations
        for method in ("lm", "dogleg")
        for damping in ("ours", "ceres")
    }
    assert all(bool(i.leg) == (method == "dogleg") for (method, _), its in chosen.items() for i in its)
    assert all(its[0].damping == (1e4 if damping == "ceres" else 1e12) for (_, damping), its in chosen.items())
    assert len(solve(settings.replace(Params(), {"window.max_iterations": 2}), p).iterations) == 2


def test_stepping_by_hand_equals_solving():
    p = problem(outliers=0.05)
    linearizer = Linearizer(p)
    at = dogleg.init(SETTINGS, linearizer, p.initial)
    while (why := trust_region.terminate(SETTINGS, at, 6)) is None:
        at = dogleg.step(SETTINGS, linearizer, at)
    solution = dogleg.solve(SETTINGS, 6, p)
    assert solution.termination == why and solution.iterations == at.reports
    assert solution.states.poses.tobytes() == at.states.poses.tobytes()


@pytest.mark.parametrize("minimise", [lm.solve, dogleg.solve], ids=["lm", "dogleg"])
def test_the_curvature_of_the_loss_ends_nearer_to_the_minimum(minimise):
    p = assemble(Params(), sw.steady(Params(), seed=3, n_tracks=150, outliers=0.02).window, sw.GRAVITY).problem
    optimum = lm.solve(replace(SETTINGS, function_tolerance=0.0), 80, p).after.total
    with_it, without = (
        minimise(replace(SETTINGS, function_tolerance=0.0, curved_below=below), 8, p).after.total - optimum
        for below in (SETTINGS.curved_below, 0.0)
    )
    assert with_it < 0.1 * without


@pytest.mark.parametrize("method", [lm, dogleg], ids=["lm", "dogleg"])
def test_a_step_that_the_curvature_spoilt_is_tried_again_without(method):
    p = problem(perturbation=0.3)
    linearizer = Linearizer(p)
    at = method.init(SETTINGS, linearizer, p.initial)
    while not at.curved:
        at = method.step(SETTINGS, linearizer, at)
    refused = method.step(replace(SETTINGS, min_gain_ratio=100.0), linearizer, at)
    assert not refused.curved and not refused.may_curve and refused.radius == at.radius
    assert refused.states is at.states and refused.system.cost == at.system.cost
    plain = linearizer.linearize(at.states)
    assert refused.system.H.tobytes() == plain.H.tobytes() != at.system.H.tobytes()
    again = method.step(SETTINGS, linearizer, refused)
    assert again.reports[-1].accepted and not again.curved
