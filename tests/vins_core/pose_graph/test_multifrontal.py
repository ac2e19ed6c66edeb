import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from vins_core.pose_graph.cholesky import BlockCholesky
from vins_core.pose_graph.dissection import LEAF, dissect


def chain(n: int, chords: int, seed: int = 0, reach: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A chain with chords, each pair once, and coordinates that know nothing of the chords."""
    rng = np.random.default_rng(seed)
    pairs = {(a, a + d) for d in range(1, reach + 1) for a in range(n - d)}
    while chords:
        a, b = sorted(rng.integers(0, n, 2).tolist())
        if a < b and (a, b) not in pairs:
            pairs.add((a, b))
            chords -= 1
    i, j = np.array(sorted(pairs)).T
    return i, j, np.column_stack([rng.normal(size=n), np.arange(n)])


def blocks(n: int, i: np.ndarray, j: np.ndarray, size: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Diagonal and off-diagonal blocks of a positive definite matrix."""
    rng = np.random.default_rng(seed)
    off = rng.normal(size=(len(i), size, size))
    diagonal = rng.normal(size=(n, size, size))
    diagonal = diagonal @ diagonal.transpose(0, 2, 1)
    weight = np.zeros(n)
    norms = np.linalg.norm(off, axis=(1, 2))
    np.add.at(weight, i, norms)
    np.add.at(weight, j, norms)
    return diagonal + (weight + 0.1)[:, None, None] * np.eye(size), off


def dense(diagonal: np.ndarray, off: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    n, size, _ = diagonal.shape
    H = np.zeros((n, size, n, size))
    H[np.arange(n), :, np.arange(n), :] = diagonal
    H[i, :, j, :] = off
    H[j, :, i, :] = off.transpose(0, 2, 1)
    return H.reshape(n * size, n * size)


@pytest.mark.parametrize("n", [1, 2, LEAF, LEAF + 1, 300])
@pytest.mark.parametrize("size", [1, 3, 6])
def test_solution_is_that_of_the_dense_matrix(n, size):
    i, j, coordinates = chain(n, n // 5 if n > 20 else 0) if n > 1 else (np.zeros(0, int),) * 2 + (np.zeros((1, 2)),)
    diagonal, off = blocks(n, i, j, size)
    cholesky = BlockCholesky(dissect(i, j, coordinates), i, j, size)
    b = np.random.default_rng(1).normal(size=(n, size))
    assert cholesky.factorize(diagonal, off)
    expected = np.linalg.solve(dense(diagonal, off, i, j), b.ravel()).reshape(n, size)
    np.testing.assert_allclose(cholesky.solve(b), expected, rtol=1e-9, atol=1e-12)
    assert cholesky.factorize(2 * diagonal, 2 * off)  # the same pattern again
    np.testing.assert_allclose(cholesky.solve(b), expected / 2, rtol=1e-9, atol=1e-12)


def test_the_larger_node_may_stand_first_in_a_pair():
    i, j, coordinates = chain(120, 20)
    diagonal, off = blocks(120, i, j, 3)
    swapped = BlockCholesky(dissect(j, i, coordinates), j, i, 3)
    assert swapped.factorize(diagonal, off.transpose(0, 2, 1).copy())
    b = np.ones((120, 3))
    expected = np.linalg.solve(dense(diagonal, off, i, j), b.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(swapped.solve(b), expected, rtol=1e-9)


def test_parts_without_any_edge_between_them_are_solved_apart():
    i, j, coordinates = chain(200, 30)
    apart = (i < 100) == (j < 100)
    i, j = i[apart], j[apart]
    diagonal, off = blocks(200, i, j, 2)
    cholesky = BlockCholesky(dissect(i, j, coordinates), i, j, 2)
    assert cholesky.factorize(diagonal, off)
    b = np.zeros((200, 2))
    b[:100] = 1
    x = cholesky.solve(b)
    assert np.abs(x[:100]).min() > 0 and not np.any(x[100:])


def test_a_matrix_that_is_not_positive_definite_is_refused():
    i, j, coordinates = chain(90, 10)
    diagonal, off = blocks(90, i, j, 3)
    diagonal[50] = -np.eye(3)
    assert not BlockCholesky(dissect(i, j, coordinates), i, j, 3).factorize(diagonal, off)


def test_every_node_is_eliminated_once_and_before_its_border():
    i, j, coordinates = chain(500, 100)
    fronts = dissect(i, j, coordinates)
    order = np.concatenate([f.own for f in fronts])
    assert sorted(order) == list(range(500))
    turn = np.argsort(order)
    neighbours = sp.csr_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])))
    for f in fronts:
        last = turn[f.own].max()
        assert np.all(np.diff(turn[f.border]) > 0) and np.all(turn[f.border] > last)
        later = [k for k in neighbours[f.own].indices if turn[k] > last]
        assert set(later) <= set(f.border)
        for child in f.children:
            assert set(fronts[child].border) <= set(f.own) | set(f.border)


def test_laps_take_less_work_than_with_minimum_degree():
    n, lap, reach = 10_000, 400, 5
    i = np.concatenate([np.arange(n - d) for d in range(1, reach + 1)])
    j = np.concatenate([np.arange(d, n) for d in range(1, reach + 1)])
    rng = np.random.default_rng(0)
    later = rng.choice(np.arange(lap, n), 2000, replace=False)
    earlier = later - lap * rng.integers(1, later // lap + 1)
    i, j = np.concatenate([i, earlier]), np.concatenate([j, later])
    a = 2 * np.pi * np.arange(n) / lap
    counts = []  # entries of each column of the factor
    for front in dissect(i, j, np.column_stack([np.cos(a), np.sin(a), np.arange(n)])):
        counts.append(len(front.border) + np.arange(len(front.own), 0, -1))
    A = sp.csc_matrix((-np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), (n, n))
    A = (A + sp.diags(1 - np.asarray(A.sum(0)).ravel())).tocsc()
    L = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0, options={"SymmetricMode": True}).L
    assert np.sum(np.concatenate(counts) ** 2) < 0.6 * np.sum(np.diff(L.indptr).astype(np.int64) ** 2)
