"""Marginalisation: the information about the frames that stay, held by those that leave.

SPEC 6.1, seeds 003 and 000.3.3.4.  With the factors that touch a leaving block linearised at the current states,

    [ A_mm  A_mk ] [ d_m ]     [ b_m ]             A = A_kk - A_km A_mm^-1 A_mk
    [ A_km  A_kk ] [ d_k ] = - [ b_k ]             b = b_k  - A_km A_mm^-1 b_m

and A = V diag(s) V', the prior is J = diag(sqrt(s)) V', r = diag(1/sqrt(s)) V' b, so that J'J = A and J'r = b.
Eigenvalues at or below `marginalization.eigen_threshold` carry no information and give zero rows.  Landmarks are
eliminated first: their part of A_mm is diagonal.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..params import Params
from ..report import BlockReport, MarginalizationReport
from ..solver import schur
from ..solver.linearize import Layout, Linearizer
from ..solver.problem import Block, WindowProblem
from .assemble import assemble
from .state import BlockKey, Prior, WindowState


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
    dropped = [Block("pose", 0), Block("speed_bias", 0)]
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
        return window.prior, MarginalizationReport("none", 0, 0, (), 0, np.zeros(0))
    problem = assemble(params, window, gravity_m_s2).problem
    part = replace(
        problem,
        initial=replace(problem.initial, inv_depths=np.zeros(0)),
        projections=problem.projections[:0],
        imu=(),
        free_extrinsics=True,
    )
    return _marginalize(params, window, part, [Block("pose", slot)], np.zeros(0, np.int64), "MARGIN_SECOND_NEW")


def _marginalize(
    params: Params,
    window: WindowState,
    problem: WindowProblem,
    dropped: list[Block],
    landmark_ids: np.ndarray,
    kind: str,
) -> tuple[Prior | None, MarginalizationReport]:
    linearizer = Linearizer(problem)
    system = linearizer.linearize(problem.initial)
    touched = _touched(problem)
    kept = [b for b in touched if b not in dropped]
    threshold = params.marginalization.eigen_threshold

    S, b = schur.eliminate(system, np.where(system.h > threshold, system.h, 0.0))
    m = _columns(linearizer.layout, [block for block in dropped if block in touched])
    k = _columns(linearizer.layout, kept)
    S_mk = S[np.ix_(m, k)]
    gain = _solve_information(S[np.ix_(m, m)], np.column_stack([S_mk, b[m]]), threshold)
    A = S[np.ix_(k, k)] - S_mk.T @ gain[:, :-1]
    rhs = b[k] - S_mk.T @ gain[:, -1]

    eigenvalues, V = np.linalg.eigh(0.5 * (A + A.T))
    informative = eigenvalues > threshold
    root = np.sqrt(np.where(informative, eigenvalues, 0.0))
    J = root[:, None] * V.T
    r = np.divide(V.T @ rhs, root, out=np.zeros(len(k)), where=informative)

    frames = [f.frame for f in window.frames]
    keys = tuple(
        BlockKey(block.kind, block.slot if block.kind == "extrinsic" else frames[block.slot]) for block in kept
    )
    prior = Prior(keys, tuple(block.value(problem.initial).copy() for block in kept), J, r)
    reports = _reports(frames, dropped, landmark_ids, kept)
    size_m = sum(report.size for report in reports if report.dropped)
    return prior, MarginalizationReport(kind, size_m, len(k), reports, int(informative.sum()), eigenvalues)


def _touched(problem: WindowProblem) -> list[Block]:
    """The blocks that some factor of the problem touches: poses, speed-biases, extrinsics."""
    touched = set(problem.prior.blocks) if problem.prior else set()
    for k, _ in problem.imu:
        touched |= {Block(kind, slot) for kind in ("pose", "speed_bias") for slot in (k, k + 1)}
    table = problem.projections
    if len(table):
        touched |= {Block("pose", int(slot)) for slot in np.union1d(table.anchor, table.observer)}
        touched.add(Block("extrinsic", table.camera))
    order = ("pose", "speed_bias", "extrinsic")
    return sorted(touched, key=lambda block: (order.index(block.kind), block.slot))


def _columns(layout: Layout, blocks: list[Block]) -> np.ndarray:
    return np.concatenate([np.zeros(0, np.int64), *(layout.columns(block) for block in blocks)])


def _solve_information(A: np.ndarray, B: np.ndarray, threshold: float) -> np.ndarray:
    """A^-1 B for an information matrix whose units differ by many orders: scaled to a unit diagonal first.

    Directions without information are left out, as by a pseudo-inverse.
    """
    scale = 1.0 / np.sqrt(np.maximum(A.diagonal(), 1e-300))
    scaled, B = A * scale[:, None] * scale, B * scale[:, None]
    try:
        solved = cho_solve(cho_factor(scaled, check_finite=False), B, check_finite=False)
    except np.linalg.LinAlgError:
        s, V = np.linalg.eigh(scaled)
        inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > max(threshold, 1e-14))
        solved = V @ (inverse[:, None] * (V.T @ B))
    return solved * scale[:, None]


def _reports(
    frames: list[int], dropped: list[Block], landmark_ids: np.ndarray, kept: list[Block]
) -> tuple[BlockReport, ...]:
    """Every block in the order of the marginalisation's H: dropped cameras, landmarks, then what is kept."""

    def name(block: Block) -> str:
        if block.kind == "extrinsic":
            return f"extrinsic cam{block.slot}"
        return f"{block.kind} {block.slot} (frame {frames[block.slot]})"

    rows = [(name(block), block.size, True) for block in dropped]
    rows += [(f"inv_depth of {i}", 1, True) for i in landmark_ids]
    rows += [(name(block), block.size, False) for block in kept]
    index = np.cumsum([0] + [size for _, size, _ in rows]).tolist()
    return tuple(BlockReport(label, size, start, gone) for (label, size, gone), start in zip(rows, index))
