from dataclasses import replace

import dense
import numpy as np
import pytest
import synthetic_window as sw

from vins_core import params as settings
from vins_core.factors.robust import Loss
from vins_core.geometry import so3
from vins_core.params import Params
from vins_core.solver import schur
from vins_core.solver.linearize import Linearizer
from vins_core.window.assemble import assemble

FORMS = ("plane", "sphere")


def problem(form: str = "plane", prior: bool = True, free_extrinsics: bool = False, **options):
    params = settings.replace(Params(), {"projection.residual": form, "window.size": 6})
    flight = sw.steady(params, n_tracks=60) if prior else sw.make(n_frames=7, n_tracks=60)
    built = assemble(params, flight.window, sw.GRAVITY).problem
    return replace(built, free_extrinsics=free_extrinsics, **options)


def stacked(linearizer: Linearizer, states) -> np.ndarray:
    r = linearizer.linearize(states).residuals
    return np.concatenate([r.visual.ravel(), r.imu.ravel(), r.prior])


def whole(system) -> tuple[np.ndarray, np.ndarray]:
    """The arrow system as one matrix."""
    P = system.W.shape[1]
    D, m = len(system.H), len(system.h)
    A = np.zeros((D + m, D + m))
    A[:D, :D], A[D:, :P], A[:P, D:] = system.H, system.W, system.W.T
    A[range(D, D + m), range(D, D + m)] = system.h
    return A, np.concatenate([system.g, system.g_l])


@pytest.mark.parametrize("free_extrinsics", [False, True])
@pytest.mark.parametrize("form", FORMS)
def test_normal_equations_are_those_of_a_differentiated_residual(form, free_extrinsics):
    p = problem(form, free_extrinsics=free_extrinsics, loss=Loss("none"))
    linearizer = Linearizer(p)
    states, D, m = p.initial, linearizer.layout.size, p.n_landmarks
    h, columns = 1e-6, []
    for e in np.eye(D + m):
        up, down = (linearizer.retract(states, s * h * e[:D], s * h * e[D:]) for s in (1, -1))
        columns.append((stacked(linearizer, up) - stacked(linearizer, down)) / (2 * h))
    J, r = np.stack(columns, 1), stacked(linearizer, states)
    A, b = whole(linearizer.linearize(states))
    scale = np.sqrt(np.outer(A.diagonal(), A.diagonal()))
    np.testing.assert_allclose(A / scale, J.T @ J / scale, atol=2e-6)
    np.testing.assert_allclose(b / np.sqrt(A.diagonal()), J.T @ r / np.sqrt(A.diagonal()), rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("loss", [Loss("none"), Loss("cauchy", 1.0), Loss("huber", 0.7)], ids=str)
def test_gradient_is_that_of_the_robust_cost(loss):
    p = problem(loss=loss)
    linearizer = Linearizer(p)
    system = linearizer.linearize(p.initial)
    rng = np.random.default_rng(0)
    D = linearizer.layout.size
    scale = 1 / np.sqrt(np.append(system.H.diagonal(), system.h))
    for _ in range(4):
        d = scale * rng.normal(size=D + p.n_landmarks)
        up, down = (linearizer.linearize(linearizer.retract(p.initial, s * d[:D], s * d[D:])) for s in (1e-4, -1e-4))
        numeric = (up.cost.total - down.cost.total) / 2e-4
        assert d[:D] @ system.g + d[D:] @ system.g_l == pytest.approx(numeric, rel=1e-4, abs=1e-4)


def test_cost_is_half_the_robust_sum_of_the_residuals():
    p = problem()
    linearizer = Linearizer(p)
    system = linearizer.linearize(p.initial)
    cost, r = system.cost, system.residuals
    assert cost.visual == pytest.approx(0.5 * p.loss.rho((r.visual**2).sum(0)).sum())
    assert cost.imu == pytest.approx(0.5 * (r.imu**2).sum())
    assert cost.prior == pytest.approx(0.5 * (r.prior**2).sum())


@pytest.mark.parametrize("form", FORMS)
def test_null_space_of_a_fresh_window_is_position_and_yaw(form):
    p = problem(form, prior=False)
    J, _, linearizer = dense.jacobian(p)
    singular = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    assert (singular[-4:] < 1e-13).all()
    assert singular[-5] > 1e-8

    n, up = p.n_frames, np.array([0.0, 0.0, 1.0])
    poses, speeds = p.initial.poses, p.initial.speed_biases
    directions = np.zeros((4, J.shape[1]))
    directions[:3, : 6 * n] = np.tile(np.hstack([np.eye(3), np.zeros((3, 3))]), n)
    turn = np.hstack([np.cross(up, poses[:, :3]), so3.rotate(so3.inverse(poses[:, 3:]), np.tile(up, (n, 1)))])
    directions[3, : 6 * n] = turn.ravel()
    velocity = np.hstack([np.cross(up, speeds[:, :3]), np.zeros((n, 6))])
    directions[3, linearizer.layout.visual : linearizer.layout.size] = velocity.ravel()
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(J @ directions.T, 0, atol=1e-14 * np.abs(J).max())


def test_schur_complement_solves_the_whole_system():
    p = problem()
    linearizer = Linearizer(p)
    system = linearizer.linearize(p.initial)
    Dc, Dl = 1e-3 * system.H.diagonal(), 1e-3 * system.h
    oldest = np.diag(np.arange(6.0)) * 1e5
    dc, dl = schur.solve_damped(system, Dc, Dl, oldest)
    A, b = whole(system)
    A[range(len(A)), range(len(A))] += np.append(Dc, Dl)
    A[:6, :6] += oldest
    scale = 1 / np.sqrt(A.diagonal())
    expected = -scale * np.linalg.solve(A * np.outer(scale, scale), scale * b)
    np.testing.assert_allclose(np.append(dc, dl) / scale, expected / scale, atol=1e-5 * np.abs(expected / scale).max())


def test_an_indefinite_system_is_refused():
    p = problem()
    system = Linearizer(p).linearize(p.initial)
    broken = replace(system, H=system.H - 2 * np.diag(system.H.diagonal()))
    assert schur.solve_damped(broken, np.zeros(len(system.H)), np.zeros(len(system.h))) is None


def test_terms_that_are_missing_add_nothing():
    p = problem()
    nothing = replace(p, projections=p.projections[:0], imu=(), prior=None)
    system = Linearizer(nothing).linearize(p.initial)
    assert system.cost.total == 0 and not system.H.any() and not system.W.any()
    only_imu = Linearizer(replace(nothing, imu=p.imu)).linearize(p.initial)
    assert only_imu.cost.total == Linearizer(p).linearize(p.initial).cost.imu > 0


def test_negative_and_zero_inverse_depths_stay_finite():
    p = problem()
    inv_depths = p.initial.inv_depths.copy()
    inv_depths[:3] = [-0.2, 0.0, -1e-12]
    system = Linearizer(p).linearize(replace(p.initial, inv_depths=inv_depths))
    assert np.isfinite(system.cost.total)
    assert all(np.isfinite(a).all() for a in (system.H, system.g, system.W, system.h, system.g_l))


def test_earlier_results_are_not_overwritten_by_later_ones():
    p = problem()
    linearizer = Linearizer(p)
    first = linearizer.linearize(p.initial)
    kept = first.H.copy(), first.W.copy()
    linearizer.linearize(linearizer.retract(p.initial, np.full(linearizer.layout.size, 0.01), 0.01 + 0 * first.h))
    np.testing.assert_array_equal(first.H, kept[0])
    np.testing.assert_array_equal(first.W, kept[1])
