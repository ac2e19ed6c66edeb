"""Marginalisation: the information about the frames that stay, held by those that leave.

SPEC 6.1, seeds 003 and 000.3.3.4.  The factors that touch a leaving block, linearised at the current states, are

    | J_m d_m + J_k d_k + r |^2          m: what leaves,  k: what is kept

Rotating the rows so that the first ones triangularise J_m leaves rows |J d_k + r|^2 without d_m: their J'J is the
Schur complement A_kk - A_km A_mm^-1 A_mk of A = J'J, computed without squaring.  That matters because information
about biases reaches 1e15: in the squared form its rounding errors invent knowledge of position and yaw.  With
J = U S V', the prior is S V' and U' r; S^2 are the eigenvalues of its information, and those at or below
`marginalization.eigen_threshold` count as zero.  Landmarks are eliminated before, their part of A_mm is diagonal.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack, qr, solve_triangular

from ..params import Params
from ..report import MarginalizationReport
from ..solver import schur
from ..solver.spectrum import gauge_directions
from .departure import Departure, oldest_leaves, second_newest_leaves
from .state import Prior, WindowState

NOTHING_LEFT = MarginalizationReport("none", 0, 0, (), 0, np.zeros(0))


def marginalize_oldest(
    params: Params, window: WindowState, gravity_m_s2: float
) -> tuple[Prior | None, MarginalizationReport]:
    """The oldest frame leaves, see departure.py."""
    return marginalize(params, oldest_leaves(params, window, gravity_m_s2))


def marginalize_second_newest(
    params: Params, window: WindowState, gravity_m_s2: float
) -> tuple[Prior | None, MarginalizationReport]:
    """The second newest frame leaves, see departure.py; a prior without it stays as it is."""
    departure = second_newest_leaves(params, window, gravity_m_s2)
    return (window.prior, NOTHING_LEFT) if departure is None else marginalize(params, departure)


def marginalize(params: Params, departure: Departure) -> tuple[Prior | None, MarginalizationReport]:
    """The prior on what stays; None when nothing is known about it."""
    kept, blocks = departure.kept, departure.blocks()
    m, n = (sum(b.size for b in blocks if b.dropped is gone) for gone in (True, False))
    if not kept:
        return None, MarginalizationReport(departure.kind, m, n, blocks, 0, np.zeros(0))

    threshold, layout = params.marginalization.eigen_threshold, departure.layout
    J, r = _rows(departure, threshold)
    J, r = _eliminate(J[:, layout.columns_of(departure.dropped)], J[:, layout.columns_of(kept)], r)

    U, singular, Vt = np.linalg.svd(J)
    eigenvalues = singular**2
    informative = eigenvalues > threshold
    J = np.where(informative, singular, 0.0)[:, None] * Vt
    r = np.where(informative, U.T @ r, 0.0)

    keys, x0 = tuple(departure.key(b) for b in kept), tuple(departure.at.value(b).copy() for b in kept)
    leaked = np.square(J @ gauge_directions(kept, x0)).sum(0)
    report = MarginalizationReport(
        departure.kind, m, n, blocks, int(informative.sum()), eigenvalues[::-1], gauge_information=leaked
    )
    return Prior(keys, x0, J, r), report


def _rows(departure: Departure, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """J (rows, D) and r (rows,) of the prior, the IMU factor, and what the landmarks leave."""
    layout, P = departure.layout, departure.layout.visual
    parts = list(departure.square_roots())
    seen = departure.projections()
    if seen is not None:
        S, b = schur.eliminate(seen, np.where(seen.h > threshold, seen.h, 0.0))
        parts.append((*_square_root(S[:P, :P], b[:P]), np.arange(P)))
    J, row = np.zeros((sum(len(r) for r, _, _ in parts), layout.size)), 0
    for r, J_part, columns in parts:
        J[row : row + len(r), columns] = J_part
        row += len(r)
    return J, np.concatenate([r for r, _, _ in parts])


def _square_root(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(r, J) with J'J = A and J'r = b, for a positive semi-definite A, by Cholesky with pivoting."""
    L, pivot, rank, _ = lapack.dpstrf(A, lower=1)
    pivot = pivot - 1
    J = np.zeros((rank, len(A)))
    J[:, pivot] = np.tril(L)[:, :rank].T
    return solve_triangular(L[:rank, :rank], b[pivot[:rank]], lower=True, check_finite=False), J


def _eliminate(J_m: np.ndarray, J_k: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rows (at most as many as columns) that remain for d_k once d_m is free to be anything.

    Multiplying by Q' of J_m = Q R separates the rows that determine d_m from those without it.  Columns are scaled
    to one, so that the rank does not depend on units.
    """
    norms = np.linalg.norm(J_m, axis=0)
    Q, R, _ = qr(J_m / np.where(norms > 0, norms, 1.0), pivoting=True, check_finite=False)
    rank = int(np.sum(np.abs(R.diagonal()) > 1e-12))
    rest = Q[:, rank:].T @ np.column_stack([J_k, r])
    n = J_k.shape[1]
    square = np.zeros((n, n + 1))
    if len(rest):
        (R,) = qr(rest, mode="r", check_finite=False)
        square[: min(n, len(R))] = R[:n]
    return square[:, :n], square[:, n]
