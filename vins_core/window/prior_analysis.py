"""Looking into a marginalisation and into the prior it left (SPEC 6.2): computed when asked for, stored nowhere.

A marginalisation takes the information H of all factors that touch what leaves,

    H = | H_mm  H_mk |        ->        H_kk - H_km H_mm^-1 H_mk
        | H_km  H_kk |

and what was zero in H_kk is filled in: every pair of kept blocks that saw the same leaving one now knows the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..factors.prior import difference_poses
from ..geometry import so3
from ..params import Params
from ..report import BlockReport
from ..solver.spectrum import UP, Leakage, Pull, Spectrum, jacobian_at, leakage, pull, spectrum
from .departure import Departure, oldest_leaves, second_newest_leaves
from .marginalize import marginalize
from .online import calibrated_value
from .state import BlockKey, Prior, WindowState


@dataclass(frozen=True)
class PriorAnalysis:
    """A prior as seen from the current states of a window."""

    blocks: tuple[BlockReport, ...]
    information: np.ndarray  # (n, n) J'J at the current states
    spectrum: Spectrum  # of it
    first: Leakage  # where the prior was linearised: what has leaked for good
    now: Leakage  # at the current states: with what they have moved since
    cost: float  # 1/2 |r|^2 at the current states
    extrinsics: Pull | None  # what the prior wants of the extrinsics, (dp in m, dtheta in rad) each; None without them
    held_cost: float
    """What of `cost` no solve can lower, because `held` and position and yaw of the oldest pose are: the
    disagreement of past measurements with the calibration, and what leaked."""
    held: tuple[str, ...] = ()  # of the calibration: what is not estimated


@dataclass(frozen=True)
class MarginalizationAnalysis:
    """H before and after, in the order of `blocks`: dropped variables, dropped landmarks, then what is kept."""

    kind: str
    blocks: tuple[BlockReport, ...]
    m: int  # columns dropped
    n: int  # columns kept
    before: np.ndarray  # (m + n, m + n)
    after: np.ndarray  # (n, n)
    fill_in: np.ndarray  # (n, n) bool: entries of kept blocks that knew nothing of each other before
    spectrum: Spectrum  # of `after`
    kept_before: Spectrum  # of the kept part of `before`, as if what leaves had been known exactly
    leak_before: Leakage | None  # of the prior that went in, at the states where Jacobians are taken
    leak_after: Leakage


def analyse_prior(prior: Prior, window: WindowState, threshold: float) -> PriorAnalysis:
    """`window` holds the states of every block of `prior`; eigenvalues at or below `threshold` count as zero."""
    x = [_value(window, key) for key in prior.blocks]
    J = jacobian_at(prior.J, prior.blocks, prior.x0, x)
    r = prior.r + prior.J @ _difference(prior, x)
    slots = {f.frame: k for k, f in enumerate(window.frames)}
    blocks = tuple(_report(key, slots, start) for key, start in zip(prior.blocks, _starts(prior.blocks)))
    extrinsics = _columns(blocks, "extrinsic")
    estimated = {"td": window.calibrates.td, "extrinsic": window.calibrates.extrinsics}
    held = [kind for kind in ("td", "extrinsic") if not estimated[kind] and any(b.kind == kind for b in prior.blocks)]
    oldest = next((b for b, key in zip(blocks, prior.blocks) if key.kind == "pose"), None)
    gauge = np.zeros((len(J[0]), 0)) if oldest is None else _gauge_of(oldest, window, prior)
    return PriorAnalysis(
        blocks=blocks,
        information=J.T @ J,
        spectrum=spectrum(J, threshold),
        first=leakage(prior.J, prior.r, prior.blocks, prior.x0),
        now=leakage(J, r, prior.blocks, x),
        cost=0.5 * float(r @ r),
        extrinsics=pull(J, r, extrinsics) if extrinsics.shape[1] else None,
        held_cost=pull(J, r, np.hstack([*(_columns(blocks, kind) for kind in held), gauge])).floor,
        held=tuple("extrinsics" if kind == "extrinsic" else kind for kind in held),
    )


def analyse_marginalization(
    params: Params, window: WindowState, gravity_m_s2: float, oldest: bool
) -> MarginalizationAnalysis | None:
    """What marginalising the oldest frame of `window`, or else the second newest, does.

    `window` as it is after the solve and before anything leaves (`Solved.judged`).  None when nothing takes part.
    """
    leave = oldest_leaves if oldest else second_newest_leaves
    departure = leave(params, window, gravity_m_s2)
    if departure is None:
        return None
    threshold = params.marginalization.eigen_threshold
    prior, report = marginalize(params, departure)
    if prior is None:
        return None
    before = information(departure)
    kept = before[report.m :, report.m :]
    after = prior.J.T @ prior.J
    old = departure.problem.prior
    leak = None
    if old is not None:
        x = [departure.at.value(b) for b in old.blocks]
        leak = leakage(jacobian_at(old.J, old.blocks, old.x0, x), old.r, old.blocks, x)
    eigenvalues, vectors = np.linalg.eigh(kept)
    return MarginalizationAnalysis(
        kind=report.kind,
        blocks=report.blocks,
        m=report.m,
        n=report.n,
        before=before,
        after=after,
        fill_in=_filled([b for b in report.blocks if not b.dropped], report.m, kept, after),
        spectrum=spectrum(prior.J, threshold),
        kept_before=Spectrum(eigenvalues, vectors, int((eigenvalues > threshold).sum())),
        leak_before=leak,
        leak_after=leakage(prior.J, prior.r, prior.blocks, prior.x0),
    )


def information(departure: Departure) -> np.ndarray:
    """H of all factors that take part, in the order of `departure.blocks()`."""
    layout, M = departure.layout, departure.problem.n_landmarks
    D, P = layout.size, layout.visual
    H = np.zeros((D + M, D + M))
    for _, J, columns in departure.square_roots():
        H[np.ix_(columns, columns)] += J.T @ J
    seen = departure.projections()
    if seen is not None:
        H[:D, :D] += seen.H
        H[D:, :P] = seen.W
        H[:P, D:] = seen.W.T
        H[range(D, D + M), range(D, D + M)] = seen.h
    order = np.concatenate(
        [layout.columns_of(departure.dropped), np.arange(D, D + M), layout.columns_of(departure.kept)]
    )
    return H[np.ix_(order, order)]


def _filled(kept: list[BlockReport], m: int, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Blocks that were apart before; entries count as zero beside the geometric mean of their diagonals."""
    filled = np.zeros(before.shape, bool)
    slices = [slice(b.index - m, b.index - m + b.size) for b in kept]
    coupled_before, coupled_after = (_correlation(H) > 1e-12 for H in (before, after))
    for a in slices:
        for b in slices:
            filled[a, b] = not coupled_before[a, b].any() and coupled_after[a, b].any()
    return filled


def _correlation(H: np.ndarray) -> np.ndarray:
    scale = 1.0 / np.sqrt(np.where(H.diagonal() > 0, H.diagonal(), np.inf))
    return np.abs(H) * scale * scale[:, None]


def _starts(keys: tuple[BlockKey, ...]) -> list[int]:
    return np.cumsum([0] + [key.size for key in keys])[:-1].tolist()


def _report(key: BlockKey, slots: dict[int, int], start: int) -> BlockReport:
    if key.kind == "extrinsic":
        name = f"extrinsic cam{key.id}"
    elif key.kind == "td":
        name = "td"
    else:
        name = f"{key.kind} {slots.get(key.id, '?')} (frame {key.id})"
    return BlockReport(name, key.size, start, False)


def _columns(blocks: tuple[BlockReport, ...], kind: str) -> np.ndarray:
    """(n, k) unit vectors of all columns of a kind of block."""
    n = sum(b.size for b in blocks)
    return np.eye(n)[:, [c for b in blocks if b.name.startswith(kind) for c in range(b.index, b.index + b.size)]]


def _gauge_of(block: BlockReport, window: WindowState, prior: Prior) -> np.ndarray:
    """(n, 4) position of a pose and its rotation about gravity, unit vectors."""
    key = next(k for k in prior.blocks if k.kind == "pose")
    columns = np.zeros((sum(k.size for k in prior.blocks), 4))
    columns[block.index : block.index + 3, :3] = np.eye(3)
    columns[block.index + 3 : block.index + 6, 3] = so3.rotate(so3.inverse(_value(window, key)[3:]), UP)
    return columns


def _value(window: WindowState, key: BlockKey) -> np.ndarray:
    if not key.of_frame:
        return calibrated_value(window, key)
    frame = next(f for f in window.frames if f.frame == key.id)
    if key.kind == "pose":
        return np.append(frame.p_w_b, frame.q_w_b)
    return np.concatenate([frame.v_w_b, frame.b_a, frame.b_g])


def _difference(prior: Prior, x: list[np.ndarray]) -> np.ndarray:
    """x [-] x0 of all blocks."""
    parts = [
        difference_poses(b[None], a[None])[0] if key.kind in ("pose", "extrinsic") else b - a
        for key, a, b in zip(prior.blocks, prior.x0, x)
    ]
    return np.concatenate(parts)
