from dataclasses import replace

import numpy as np
import pytest
from gps_run import settings

from vins_core.factors.robust import Loss
from vins_core.fusion.chain import (
    Chain,
    Fixes,
    Linearizer,
    difference,
    first_prior,
    free_components,
    full_covariance,
    marginalize_first,
    predict,
    predict_covariance,
    retract,
)
from vins_core.fusion.drift import between
from vins_core.fusion.ipopt import solve_ipopt
from vins_core.fusion.judge import chi_squares, judge
from vins_core.fusion.solve import solve
from vins_core.fusion.tridiagonal import BlockTridiagonal
from vins_core.geometry import heading, so3

SETTINGS = {"4": settings(), "6": settings(dof="6"), "known scale": settings(scale_sigma=0.0)}


def world(name: str = "4", n: int = 12, seed: int = 0, noise_m: float = 1.0) -> tuple[Chain, np.ndarray]:
    """A chain of n nodes with a fix each, and its true nodes."""
    gps, rng = SETTINGS[name], np.random.default_rng(seed)
    course = np.cumsum(rng.normal(0, 0.2, n - 1))
    ways = 5.0 * np.stack([np.cos(course), np.sin(course), 0.02 * rng.normal(size=n - 1)], 1)
    increments, free = between(gps, ways, 0.5 * np.ones(n - 1)), free_components(gps)
    truth = np.empty((n, 8))
    truth[0] = [3.0, -2.0, 1.0, *heading.about_gravity(0.8), 0.01 * gps.scale_sigma]
    for k in range(n - 1):
        L = np.linalg.cholesky(increments.covariance[k][np.ix_(free, free)])
        truth[k + 1] = retract(free, predict(truth[k], increments[k])[None], (L @ rng.normal(size=len(free)))[None])[0]
    lever = rng.normal(size=(n, 3))
    R = np.array([np.diag(rng.uniform(0.5, 1.5, 3) ** 2) for _ in range(n)])
    z = truth[:, :3] + so3.rotate(truth[:, 3:7], lever)
    z += noise_m * np.einsum("nab,nb->na", np.sqrt(R), rng.normal(size=(n, 3)))
    prior = first_prior(gps, np.append(truth[0, :7], 0.0))
    return Chain(free, increments, Fixes(np.arange(n), lever, z, R), prior, Loss("none")), truth


def dense(chain: Chain, x: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H and g as one matrix and one vector."""
    at = Linearizer(chain).linearize(x, used)
    n, t = at.g.shape
    H = np.zeros((n, t, n, t))
    for k in range(n):
        H[k, :, k] = at.diagonal[k]
    for k in range(n - 1):
        H[k, :, k + 1], H[k + 1, :, k] = at.above[k], at.above[k].T
    return H.reshape(n * t, n * t), at.g.ravel()


def in_sigmas(chain: Chain, x: np.ndarray, reference: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """By how many standard deviations two estimates differ, (n, t)."""
    return difference(chain.free, x, reference) / np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))


def assert_same_spread(P: np.ndarray, Q: np.ndarray, tolerance: float) -> None:
    """Covariances agree, each entry against its standard deviations."""
    sigma = np.sqrt(np.diagonal(Q, axis1=-2, axis2=-1)) + 1e-12
    scale = sigma[..., :, None] * sigma[..., None, :]
    np.testing.assert_allclose(P / scale, Q / scale, atol=tolerance)


def every(chain: Chain) -> np.ndarray:
    return np.ones(len(chain.fixes), bool)


@pytest.mark.parametrize("n", [1, 2, 9])
def test_block_elimination_is_the_dense_solution_and_its_inverse(n):
    rng, t = np.random.default_rng(n), 4
    A = rng.normal(size=(n, t, t))
    diagonal = A @ np.swapaxes(A, 1, 2) + 8 * np.eye(t)
    above, b = rng.normal(size=(n - 1, t, t)), rng.normal(size=(n, t))
    H = np.zeros((n, t, n, t))
    for k in range(n):
        H[k, :, k] = diagonal[k]
    for k in range(n - 1):
        H[k, :, k + 1], H[k + 1, :, k] = above[k], above[k].T
    inverse = np.linalg.inv(H.reshape(n * t, n * t)).reshape(n, t, n, t)
    factor = BlockTridiagonal(diagonal, above)
    np.testing.assert_allclose(factor.solve(b), np.einsum("kalb,lb->ka", inverse, b), atol=1e-12)
    np.testing.assert_allclose(factor.covariances(), np.stack([inverse[k, :, k] for k in range(n)]), atol=1e-12)


def test_a_chain_that_nothing_holds_is_refused():
    chain, truth = world()
    with pytest.raises(np.linalg.LinAlgError):
        solve(SETTINGS["4"], chain, truth, np.zeros(len(chain.fixes), bool))


@pytest.mark.parametrize("name", SETTINGS)
def test_gradient_is_that_of_the_cost(name):
    chain, truth = world(name)
    rng, used = np.random.default_rng(5), every(chain)
    linearizer = Linearizer(chain)
    x = retract(chain.free, truth, 0.01 * rng.normal(size=(len(chain), len(chain.free))))
    g = linearizer.linearize(x, used).g
    for _ in range(3):
        d, h = rng.normal(size=g.shape), 1e-6
        ahead, behind = (linearizer.linearize(retract(chain.free, x, s * h * d), used).cost for s in (1, -1))
        assert (ahead - behind) / (2 * h) == pytest.approx(float(np.sum(g * d)), rel=1e-4)


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("loss", ["none", "huber"])
def test_ipopt_finds_the_same_minimum(name, loss):
    chain, truth = world(name)
    chain = replace(chain, loss=Loss(loss, 1.0))
    start = retract(chain.free, truth, np.random.default_rng(1).normal(0, 0.05, (len(chain), len(chain.free))))
    used = every(chain)
    used[3] = False
    ours, theirs = solve(SETTINGS[name], chain, start, used), solve_ipopt(chain, start, used)
    assert theirs.termination == "Solve_Succeeded"
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-6)
    np.testing.assert_allclose(in_sigmas(chain, ours.x, theirs.x, ours.covariances()), 0, atol=5e-3)


@pytest.mark.parametrize("name", SETTINGS)
def test_what_the_first_node_leaves_is_all_that_it_knew(name):
    chain, truth = world(name, noise_m=0.3)
    used = every(chain)
    used[0] = name != "4"  # whether or not its own fix counted
    whole = solve(SETTINGS[name], chain, truth, used)
    rest = Chain(
        chain.free,
        chain.increments[1:],
        Fixes(chain.fixes.node[1:] - 1, chain.fixes.lever_o[1:], chain.fixes.z_e[1:], chain.fixes.covariance[1:]),
        marginalize_first(chain, whole.x, used),
        chain.loss,
    )
    part = solve(SETTINGS[name], rest, whole.x[1:], used[1:])
    np.testing.assert_allclose(in_sigmas(chain, part.x, whole.x[1:], part.covariances()), 0, atol=5e-3)
    assert_same_spread(part.covariances(), whole.covariances()[1:], 1e-2)


def test_prediction_and_its_covariance_are_those_of_a_chain_with_one_node_more():
    chain, truth = world("6")
    n = len(chain)
    fixes = chain.fixes
    shorter = replace(
        chain,
        increments=chain.increments[: n - 2],
        fixes=Fixes(fixes.node[:-1], fixes.lever_o[:-1], fixes.z_e[:-1], fixes.covariance[:-1]),
    )
    last = np.append(np.ones(n - 1, bool), False)
    longer, short = solve(SETTINGS["6"], chain, truth, last), solve(SETTINGS["6"], shorter, truth[:-1], last[:-1])
    way = chain.increments[n - 2]
    np.testing.assert_allclose(predict(short.x[-1], way), longer.x[-1], atol=1e-6)
    P = predict_covariance(short.x[-1], way, full_covariance(chain.free, short.covariances()[-1]))
    assert_same_spread(P, full_covariance(chain.free, longer.covariances()[-1]), 1e-3)


def test_leaving_a_fix_out_gives_the_chi_square_that_solving_without_it_gives():
    chain, truth = world()
    used = every(chain)
    whole = solve(SETTINGS["4"], chain, truth, used)
    chi2 = chi_squares(Linearizer(chain), whole.x, whole.covariances(), used)
    for m in (0, 5, len(chain.fixes) - 1):
        without = used.copy()
        without[m] = False
        left = solve(SETTINGS["4"], chain, whole.x, without)
        again = chi_squares(Linearizer(chain), left.x, left.covariances(), without)
        assert chi2[m] == pytest.approx(again[m], rel=0.02)


@pytest.mark.parametrize("seed", range(5))
def test_outliers_among_good_fixes_are_taken_out_and_nothing_else(seed):
    chain, truth = world(n=30, seed=seed)
    rng = np.random.default_rng(seed)
    outlier = np.zeros(30, bool)
    outlier[rng.choice(30, 4, replace=False)] = True
    z = chain.fixes.z_e.copy()
    z[outlier, :2] += 12.0 * np.stack([np.cos(a := rng.uniform(0, 6.28, 4)), np.sin(a)], 1)
    chain = replace(chain, fixes=replace(chain.fixes, z_e=z))
    result = judge(SETTINGS["4"], Linearizer(chain), truth, every(chain))
    np.testing.assert_array_equal(result.used, ~outlier)


def test_fixes_that_were_left_out_for_no_reason_come_back():
    chain, truth = world(n=20)
    start = np.arange(20) % 3 == 0
    assert judge(SETTINGS["4"], Linearizer(chain), truth, start).used.all()
