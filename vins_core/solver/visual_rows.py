"""What the projections of a window say at given states, row by row, and what the inverse depths see of it.

`NumpyRows` and `CompiledRows` (compiled_rows.py) do the same work behind the same interface, to the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..factors.factor import Factor
from ..factors.robust import Loss
from .problem import Projections, States


@dataclass(frozen=True)
class RowIndex:
    """N projections in the order in which they are added up, and where their numbers go."""

    table: Projections  # all projections of a landmark share its anchor
    factor: Factor
    data: np.ndarray  # (n_data, N) of the factor
    loss: Loss
    row: np.ndarray  # (N,) column of `Rows.residuals`
    place: np.ndarray  # (2, N) rows of `packed` for both rows of each projection
    start: np.ndarray  # (blocks, N) first column in W of each block but the inverse depth that is differentiated
    n_landmarks: int
    width: int  # columns of W

    @property
    def camera_blocks(self) -> int:
        """Poses and extrinsics that are differentiated."""
        return len(self.start) - has_td(self.factor)

    @property
    def camera_columns(self) -> int:
        """c: columns of J without that of the inverse depth."""
        return 6 * self.camera_blocks + has_td(self.factor)


def has_td(factor: Factor) -> int:
    """1 when the time offset is a block of `factor`; it is always differentiated then."""
    return int(factor.blocks[-2].name == "td")


def active_blocks(factor: Factor, camera_blocks: int) -> tuple[str, ...]:
    """The blocks that are differentiated: poses, extrinsics when there is room for them, td, the inverse depth."""
    always = factor.blocks[-1 - has_td(factor) :]
    return tuple(block.name for block in (*factor.blocks[:camera_blocks], *always))


def numbers_of_blocks(factor: Factor) -> tuple[int, int]:
    """How many poses and extrinsics are differentiated with the extrinsics held, and with them free."""
    poses = sum(block.name.startswith("pose") for block in factor.blocks)
    return poses, len(factor.blocks) - 1 - has_td(factor)


@dataclass(frozen=True)
class Rows:
    """With J = [J_c J_l] and r weighted for the robust loss (factors/robust.py), but for the first two."""

    residuals: np.ndarray  # (2, N) unweighted
    squared: np.ndarray  # (N,) |residual|^2
    W: np.ndarray  # (M, P) J_l' J_c
    h: np.ndarray  # (M,) J_l' J_l
    g_l: np.ndarray  # (M,) J_l' r


class RowEvaluator(Protocol):
    packed: np.ndarray
    """(2 N, c + 1) [J_c r] with weights, filled by `evaluate`."""

    def evaluate(self, states: States, curved: bool = False) -> Rows:
        """`curved`: with the curvature of the robust loss."""
        ...


class NumpyRows:
    """One NumPy call per instruction of the residual, on all projections at once."""

    def __init__(self, index: RowIndex):
        self._index = index
        n, c = len(index.table), index.camera_columns
        factor = index.factor
        self._held, self._cameras = numbers_of_blocks(factor)
        common = tuple(block.name for block in factor.blocks[self._held : -1])  # extrinsics and td
        self._batch = factor.batch(n, active_blocks(factor, index.camera_blocks), uniform=common)
        self._batch.data[:] = index.data
        self._source = np.empty(2 * n, np.int64)  # of each row of `packed`
        self._source[index.place.reshape(-1)] = np.arange(2 * n)
        self.packed = np.empty((2 * n, c + 1))
        sizes = [6] * index.camera_blocks + [1] * has_td(factor)
        within = np.concatenate([np.arange(0), *map(np.arange, sizes)])
        columns = np.repeat(index.start, sizes, axis=0) + within[:, None]
        self._in_W = (index.table.landmark * index.width + columns).reshape(-1)

    def evaluate(self, states: States, curved: bool = False) -> Rows:
        system, residuals, squared = self.system(states, curved)
        index, c, m = self._index, self._index.camera_columns, self._index.n_landmarks
        camera, depth, r = system[:c], system[c], system[c + 1]
        self.packed[:, :c] = camera.reshape(c, r.size).T[self._source]
        self.packed[:, c] = r.reshape(-1)[self._source]
        landmark, width = index.table.landmark, index.width
        coupling = camera[:, 0] * depth[0] + camera[:, 1] * depth[1]
        W = np.bincount(self._in_W, coupling.reshape(-1), m * width).reshape(m, width)
        h = np.bincount(landmark, depth[0] * depth[0] + depth[1] * depth[1], m)
        g_l = np.bincount(landmark, depth[0] * r[0] + depth[1] * r[1], m)
        in_order = np.empty_like(residuals)
        in_order[:, index.row] = residuals
        return Rows(in_order, squared, W, h, g_l)

    def system(self, states: States, curved: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """[J r] of every projection with its weight (c + 2, 2, N), a buffer; r without it (2, N); |r|^2 (N,)."""
        table, batch = self._index.table, self._batch
        if self._held:
            poses = np.ascontiguousarray(states.poses.T)
            poses.take(table.anchor, 1, batch.inputs[0], "clip")
            poses.take(table.observer, 1, batch.inputs[1], "clip")
        for extrinsic, camera in zip(batch.inputs[self._held : self._cameras], (table.camera, table.seen_by)):
            extrinsic[:] = states.extrinsics[camera]
        if self._cameras < len(batch.inputs) - 1:
            batch.inputs[self._cameras][:] = states.td_s
        states.inv_depths.take(table.landmark, 0, batch.inputs[-1][0], "clip")
        system = batch.system
        with np.errstate(all="ignore"):  # a point in the camera's plane gives no finite cost, and the step is rejected
            batch.evaluate()
            r = system[-1].copy()
            s = r[0] * r[0] + r[1] * r[1]
            system *= self._index.loss.weight(s)
            if curved:
                shrink, root = self._index.loss.bend(s)
                J = system[:-1]
                along = (J[:, 0] * r[0] + J[:, 1] * r[1]) * shrink
                J[:, 0] -= along * r[0]
                J[:, 1] -= along * r[1]
                system[-1] /= root
        return system, r, s
