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

from dataclasses import replace

import numpy as np
from scipy.linalg import lapack, qr, solve_triangular

from ..params import Params
from ..report import BlockReport, MarginalizationReport
from ..solver import schur
from ..solver.inertial_term import InertialTerm
from ..solver.layout import Layout, Variable
from ..solver.linearize import Linearizer
from ..solver.prior_term import PriorTerm
from ..solver.problem import WindowProblem
from .assemble import assemble
from .state import BlockKey, Prior, WindowState

NOTHING_LEFT = MarginalizationReport("none", 0, 0, (), 0, np.zeros(0))


def marginalize_oldest(
    params: Params, window: WindowState, gravity_m_s2: float
) -> tuple[Prior | None, MarginalizationReport]:
    """MARGIN_OLD (REFERENCE G1): drops pose and speed-bias of slot 0 and the landmarks anchored there.

    Factors: the prior, IMU (0, 1), projections of landmarks anchored in slot 0, at the window's current states.
    """
    assembly = assemble(params, window, gravity_m_s2)
    problem = assembly.problem
    leaving = assembly.anchor == 0
    table = problem.projections[leaving[problem.projections.landmark]]
    table = replace(table, landmark=(np.cumsum(leaving) - 1)[table.landmark])
    part = replace(
        problem,
        initial=replace(problem.initial, inv_depths=problem.initial.inv_depths[leaving]),
        projections=table,
        imu=tuple((k, m) for k, m in problem.imu if k == 0),
        free_extrinsics=True,
    )
    dropped = [Variable("pose", 0), Variable("speed_bias", 0)]
    return _marginalize(params, window, part, dropped, assembly.ids[leaving], "MARGIN_OLD")


def marginalize_second_newest(
    params: Params, window: WindowState, gravity_m_s2: float
) -> tuple[Prior | None, MarginalizationReport]:
    """MARGIN_SECOND_NEW (REFERENCE G2): drops the pose of the second newest frame from the prior, if it is there.

    No other factor takes part: its projections are forgotten and its IMU samples go to the next interval.
    """
    slot = len(window.frames) - 2
    key = BlockKey("pose", window.frames[slot].frame)
    if window.prior is None or key not in window.prior.blocks:
        return window.prior, NOTHING_LEFT
    problem = assemble(params, window, gravity_m_s2).problem
    part = replace(
        problem,
        initial=replace(problem.initial, inv_depths=np.zeros(0)),
        projections=problem.projections[:0],
        imu=(),
        free_extrinsics=True,
    )
    return _marginalize(params, window, part, [Variable("pose", slot)], np.zeros(0, np.int64), "MARGIN_SECOND_NEW")


def _marginalize(
    params: Params,
    window: WindowState,
    problem: WindowProblem,
    dropped: list[Variable],
    landmark_ids: np.ndarray,
    kind: str,
) -> tuple[Prior | None, MarginalizationReport]:
    touched = _touched(problem)
    dropped = [b for b in dropped if b in touched]
    kept = [b for b in touched if b not in dropped]
    frames = [f.frame for f in window.frames]
    blocks = _reports(frames, dropped, landmark_ids, kept)
    m, n = (sum(b.size for b in blocks if b.dropped is gone) for gone in (True, False))
    if not kept:
        return None, MarginalizationReport(kind, m, n, blocks, 0, np.zeros(0))

    layout = Layout(problem.n_frames, len(problem.initial.extrinsics))
    J, r = _rows(problem, layout, params.marginalization.eigen_threshold)
    J, r = _eliminate(J[:, layout.columns_of(dropped)], J[:, layout.columns_of(kept)], r)

    U, singular, Vt = np.linalg.svd(J)
    eigenvalues = singular**2
    informative = eigenvalues > params.marginalization.eigen_threshold
    J = np.where(informative, singular, 0.0)[:, None] * Vt
    r = np.where(informative, U.T @ r, 0.0)

    keys = tuple(BlockKey(b.kind, b.slot if b.kind == "extrinsic" else frames[b.slot]) for b in kept)
    prior = Prior(keys, tuple(problem.initial.value(b).copy() for b in kept), J, r)
    return prior, MarginalizationReport(kind, m, n, blocks, int(informative.sum()), eigenvalues[::-1])


def _rows(problem: WindowProblem, layout: Layout, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """J (rows, D) and r (rows,) of the prior, the IMU factor, and what the landmarks leave."""
    states, P = problem.initial, layout.visual
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    if problem.prior:
        prior = PriorTerm(problem.prior, layout)
        parts.append((*prior.rows(states), prior.columns[0]))
    if problem.imu:
        inertial = InertialTerm(problem, layout)
        r, J = inertial.rows(states)
        parts.append((r[0], J[0], inertial.columns[0]))
    if len(problem.projections):
        seen = Linearizer(replace(problem, imu=(), prior=None)).linearize(states)
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


def _touched(problem: WindowProblem) -> list[Variable]:
    """The blocks that some factor of the problem touches: poses, speed-biases, extrinsics."""
    touched = set(problem.prior.blocks) if problem.prior else set()
    for k, _ in problem.imu:
        touched |= {Variable(kind, slot) for kind in ("pose", "speed_bias") for slot in (k, k + 1)}
    table = problem.projections
    if len(table):
        touched |= {Variable("pose", int(slot)) for slot in np.union1d(table.anchor, table.observer)}
        touched.add(Variable("extrinsic", table.camera))
    order = ("pose", "speed_bias", "extrinsic")
    return sorted(touched, key=lambda block: (order.index(block.kind), block.slot))


def _reports(
    frames: list[int], dropped: list[Variable], landmark_ids: np.ndarray, kept: list[Variable]
) -> tuple[BlockReport, ...]:
    """Every block in the order of the marginalisation's H: dropped cameras, landmarks, then what is kept."""

    def name(block: Variable) -> str:
        if block.kind == "extrinsic":
            return f"extrinsic cam{block.slot}"
        return f"{block.kind} {block.slot} (frame {frames[block.slot]})"

    rows = [(name(block), block.size, True) for block in dropped]
    rows += [(f"inv_depth of {i}", 1, True) for i in landmark_ids]
    rows += [(name(block), block.size, False) for block in kept]
    index = np.cumsum([0] + [size for _, size, _ in rows]).tolist()
    return tuple(BlockReport(label, size, start, gone) for (label, size, gone), start in zip(rows, index))
