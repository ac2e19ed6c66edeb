"""The prior as the record holds it: its information, block by block, and what it claims to know but cannot.

    Lambda = J'J,   J, r from marginalisation (SPEC 6.1, seed 000.3.3.4)

Camera and IMU cannot see where the whole window stands (x, y, z) nor its heading.  Moving every pose along such a
direction n must cost nothing: n' Lambda n is the information that leaked into it because parts of the prior were
linearised at different estimates (SPEC 6.2, solver/spectrum.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vins_core.solver.spectrum import GAUGE, gauge_directions
from vins_core.window.departure import Departure, oldest_leaves, second_newest_leaves
from vins_core.window.state import BlockKey, Prior, WindowState

from .context import RunView
from .optimum import solve_recorded
from .widgets.matrix import MatrixBlock

DIRECTIONS = GAUGE
FREE = 1e-2
"""Information below it, 1/m^2 or 1/rad^2, is none: a standard deviation of 10 m or 10 rad."""


@dataclass(frozen=True)
class PriorView:
    """What marginalisation left behind after a frame."""

    blocks: tuple[MatrixBlock, ...]
    information: np.ndarray  # (n, n)
    eigenvalues: np.ndarray  # (n,) ascending
    rank: int
    leaks: np.ndarray  # (4,) information along DIRECTIONS, 1/m^2 and 1/rad^2


def prior_view(window: WindowState, threshold: float) -> PriorView | None:
    """None while there is no prior; `threshold`: eigenvalues at or below count as zero."""
    prior = window.prior
    if prior is None:
        return None
    eigenvalues = np.sort(np.linalg.svd(prior.J, compute_uv=False) ** 2)
    return PriorView(
        blocks=matrix_blocks(prior, [f.frame for f in window.frames]),
        information=prior.J.T @ prior.J,
        eigenvalues=eigenvalues,
        rank=int((eigenvalues > threshold).sum()),
        leaks=leaked(prior),
    )


def matrix_blocks(prior: Prior, frames: list[int]) -> tuple[MatrixBlock, ...]:
    """Every block with its columns; slots are those of the window after sliding."""
    blocks, start = [], 0
    for key in prior.blocks:
        blocks.append(MatrixBlock(*_names(key, frames), start, key.size, -1 if key.kind == "extrinsic" else key.id))
        start += key.size
    return tuple(blocks)


def _names(key: BlockKey, frames: list[int]) -> tuple[str, str]:
    """(in words, on the edge of the matrix)."""
    if key.kind == "extrinsic":
        return f"extrinsic of camera {key.id}", "ex"
    slot = frames.index(key.id) if key.id in frames else "?"
    if key.kind == "pose":
        return f"pose {slot} (frame {key.id})", f"x{slot}"
    return f"velocity and biases {slot} (frame {key.id})", f"vb{slot}"


def leaked(prior: Prior) -> np.ndarray:
    """(4,) information along x, y, z and yaw, where the prior was linearised."""
    return np.square(prior.J @ gauge_directions(prior.blocks, prior.x0)).sum(0)


@dataclass(frozen=True)
class DepartureView:
    """The information that marginalisation started from, in its own order: dropped, then kept."""

    kind: str
    blocks: tuple[MatrixBlock, ...]  # all inverse depths are one
    information: np.ndarray  # (m + n, m + n)
    m: int
    kept: tuple[MatrixBlock, ...]  # columns counted from the first kept one
    fill_in: np.ndarray  # (n, n) what is left, only where nothing was before; else 0

    @property
    def share(self) -> float:
        """Of the entries among what is kept, how many are new."""
        return float((self.fill_in != 0).mean()) if self.fill_in.size else 0.0


def departure_view(run: RunView, frame: int) -> DepartureView | None:
    """What left after a frame, worked out from the record once more; None when nothing did."""
    report, prior = run.report(frame).marginalization, run.reader.state(frame).window.prior
    if report is None or report.kind == "none" or prior is None:
        return None
    params, turn = run.header.params_at(frame), solve_recorded(run.reader, frame)
    leave = oldest_leaves if report.kind == "MARGIN_OLD" else second_newest_leaves
    departure = leave(params, turn.judged, run.header.calibration.gravity_m_s2)
    if departure is None:
        return None
    A, m = information_before(departure)
    after = prior.J.T @ prior.J
    threshold = 1e-12 * np.sqrt(np.outer(after.diagonal(), after.diagonal()))
    new = (np.abs(A[m:, m:]) <= threshold) & (np.abs(after) > threshold)
    blocks = departure_blocks(departure)
    kept = tuple(replace(b, start=b.start - m) for b in blocks if not b.dropped)
    return DepartureView(departure.kind, blocks, A, m, kept, np.where(new, after, 0.0))


def information_before(departure: Departure) -> tuple[np.ndarray, int]:
    """(A, m): A = J'J of every factor that takes part, the m rows of what leaves first, landmarks last among them."""
    layout, M = departure.layout, len(departure.landmark_ids)
    A = np.zeros((layout.size + M, layout.size + M))
    for _, J, columns in departure.square_roots():
        A[np.ix_(columns, columns)] += J.T @ J
    seen = departure.projections()
    if seen is not None:
        D, P = layout.size, seen.W.shape[1]
        A[:D, :D] += seen.H
        A[D:, :P], A[:P, D:] = seen.W, seen.W.T
        A[D:, D:] += np.diag(seen.h)
    gone, kept = (layout.columns_of(list(b)) for b in (departure.dropped, departure.kept))
    order = np.concatenate([gone, layout.size + np.arange(M), kept]).astype(int)
    return A[np.ix_(order, order)], len(gone) + M


def departure_blocks(departure: Departure) -> tuple[MatrixBlock, ...]:
    names = [(departure.key(b), True) for b in departure.dropped] + [(departure.key(b), False) for b in departure.kept]
    blocks, start, frames, M = [], 0, list(departure.frames), len(departure.landmark_ids)
    for k, (key, gone) in enumerate(names):
        if k == len(departure.dropped) and M:
            blocks.append(MatrixBlock(f"{M} inverse depths", "depths", start, M, dropped=True))
            start += M
        frame = -1 if key.kind == "extrinsic" else key.id
        blocks.append(MatrixBlock(*_names(key, frames), start, key.size, frame, gone))
        start += key.size
    return tuple(blocks)
