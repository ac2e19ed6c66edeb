"""A factor: a residual written once in SX, its Jacobian by AD through the retraction, evaluated in batches.

    r(x_1, ..., x_k; data),      J_b = d r(x_b [+] d) / d d  at d = 0

Only *active* blocks are differentiated; a block held fixed costs nothing.  A batch is evaluated by one of two back
ends with the same interface: `tape` replays the SX instructions as NumPy vector operations (many rows), `vm` runs
CasADi's virtual machine over preallocated buffers (few rows).  Neither needs a compiler.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from .symbolic import Pose
from .tape import Tape, record

Residual = Callable[[list[Any], ca.SX], ca.SX]


@dataclass(frozen=True)
class Block:
    """One variable of a factor: a pose (p, q wxyz) with a 6-dimensional tangent, or a vector."""

    name: str
    size: int  # numbers stored
    is_pose: bool = False

    @property
    def tangent(self) -> int:
        return 6 if self.is_pose else self.size

    def at(self, x: ca.SX, d: ca.SX | None) -> Pose | ca.SX:
        """What the residual sees: x, or x [+] d."""
        if self.is_pose:
            return Pose(x, d)
        return x if d is None else x + d


def pose(name: str) -> Block:
    return Block(name, 7, is_pose=True)


def vector(name: str, size: int) -> Block:
    return Block(name, size)


@dataclass(frozen=True)
class Factor:
    """`residual(values, data)` takes one value per block (a `Pose` or an SX column) and the measurement."""

    name: str
    blocks: tuple[Block, ...]
    n_data: int
    residual: Residual

    def columns(self, active: Sequence[str]) -> dict[str, slice]:
        """The columns of J that belong to each active block, in the order of `blocks`."""
        columns, start = {}, 0
        for b in self.blocks:
            if b.name in active:
                columns[b.name] = slice(start, start + b.tangent)
                start += b.tangent
        return columns

    def function(self, active: tuple[str, ...]) -> ca.Function:
        """(x_1, ..., x_k, data) -> (r, J) as a CasADi function; J has the columns of the active blocks."""
        return _differentiate(self, active)

    def batch(self, n: int, active: tuple[str, ...], uniform: tuple[str, ...] = (), backend: str = "tape") -> Batch:
        """Arrays for n rows.  A uniform block has the same value in every row."""
        if backend == "vm":
            return VmBatch(self, self.function(active), n)
        return TapeBatch(self, active, n, tuple(k for k, b in enumerate(self.blocks) if b.name in uniform))


@lru_cache(maxsize=64)
def _differentiate(factor: Factor, active: tuple[str, ...]) -> ca.Function:
    x = [ca.SX.sym(b.name, b.size) for b in factor.blocks]
    d = [ca.SX.sym("d_" + b.name, b.tangent) if b.name in active else None for b in factor.blocks]
    data = ca.SX.sym("data", factor.n_data)
    r = factor.residual([b.at(xb, None) for b, xb in zip(factor.blocks, x)], data)
    moved = factor.residual([b.at(xb, db) for b, xb, db in zip(factor.blocks, x, d)], data)
    delta = ca.vertcat(*(db for db in d if db is not None))
    J = ca.substitute(ca.jacobian(moved, delta), delta, ca.DM.zeros(delta.numel(), 1))
    # J' stored by columns is J stored by rows, NumPy's own order
    return ca.Function(factor.name, [*x, data], [ca.densify(r), ca.densify(J.T)], {"cse": True})


@lru_cache(maxsize=64)
def _tape(factor: Factor, active: tuple[str, ...], uniform: tuple[int, ...]) -> Tape:
    return record(_differentiate(factor, active), uniform)


class Batch:
    """n rows of one factor.  Write `inputs`, call `evaluate`, read `r` and `J`.

    inputs: per block (size, n), or (size,) for a uniform block; `data` (n_data, n); r (n_r, n); J (n_r, n_tangent, n).
    """

    inputs: list[np.ndarray]
    data: np.ndarray
    r: np.ndarray
    J: np.ndarray

    def evaluate(self) -> None:
        raise NotImplementedError


class TapeBatch(Batch):
    """Rows as vector lanes of a NumPy program: one NumPy call per SX instruction."""

    def __init__(self, factor: Factor, active: tuple[str, ...], n: int, uniform: tuple[int, ...]):
        f = factor.function(active)
        tape = _tape(factor, active, uniform)
        self.inputs = [np.empty(b.size if k in uniform else (b.size, n)) for k, b in enumerate(factor.blocks)]
        self.data = np.empty((factor.n_data, n))
        n_r = f.size1_out(0)
        out_r, out_J = np.zeros((n_r, n)), np.zeros((f.nnz_out(1), n))
        self.r, self.J = out_r, out_J.reshape(n_r, -1, n)
        self._run = tape.bind([*self.inputs, self.data], [out_r, out_J], n)

    def evaluate(self) -> None:
        self._run()


class VmBatch(Batch):
    """Rows through CasADi's virtual machine; the arrays are views of the buffers it reads and writes."""

    def __init__(self, factor: Factor, f: ca.Function, n: int):
        buffer: Any  # keeps raw pointers into the arrays below
        buffer, self._trigger = f.map(n).buffer()
        self._buffer = buffer
        self._arrays = [np.zeros((n, f.nnz_in(k))) for k in range(f.n_in())]
        self._outputs = [np.zeros((n, f.nnz_out(k))) for k in range(f.n_out())]
        for k, a in enumerate(self._arrays):
            buffer.set_arg(k, memoryview(a))
        for k, a in enumerate(self._outputs):
            buffer.set_res(k, memoryview(a))
        *self.inputs, self.data = (a.T for a in self._arrays)
        n_r = f.size1_out(0)
        self.r = self._outputs[0].T
        self.J = self._outputs[1].reshape(n, n_r, -1).transpose(1, 2, 0)

    def evaluate(self) -> None:
        self._trigger()
