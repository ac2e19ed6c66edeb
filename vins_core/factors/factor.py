"""A factor: a residual written once in SX, its Jacobian by AD through the retraction, evaluated in batches.

    r(x_1, ..., x_k; data),      J_b = d r(x_b [+] d) / d d  at d = 0

Only *active* blocks are differentiated; a block held fixed costs nothing.  A batch is evaluated by one of two back
ends with the same interface: `tape` replays the SX instructions as NumPy vector operations (many rows), `vm` runs
CasADi's virtual machine over preallocated buffers (few rows).  Neither needs a compiler.
"""

from __future__ import annotations

from collections.abc import Callable
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

    def function(self, active: tuple[str, ...]) -> ca.Function:
        """(x_1, ..., x_k, data) -> [J r] as a CasADi function; J has the columns of the active blocks, in order."""
        return _differentiate(self, active)

    def batch(self, n: int, active: tuple[str, ...], uniform: tuple[str, ...] = (), backend: str = "tape") -> Batch:
        """Arrays for n rows.  A uniform block has the same value in every row."""
        if backend == "vm":
            return VmBatch(self, active, n)
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
    return ca.Function(factor.name, [*x, data], [ca.densify(ca.horzcat(J, r))], {"cse": True})


@lru_cache(maxsize=64)
def _tape(factor: Factor, active: tuple[str, ...], uniform: tuple[int, ...]) -> Tape:
    return record(_differentiate(factor, active), uniform)


@lru_cache(maxsize=64)
def _mapped(factor: Factor, active: tuple[str, ...], n: int) -> ca.Function:
    return _differentiate(factor, active).map(n)


class Batch:
    """n rows of one factor.  Write `inputs` and `data`, call `evaluate`, read `system`.

    inputs: per block (size, n), or (size,) for a uniform block;  data: (n_data, n);
    system: (columns + 1, n_r, n), the columns of J with the residual as the last one.
    """

    inputs: list[np.ndarray]
    data: np.ndarray
    system: np.ndarray

    def evaluate(self) -> None:
        raise NotImplementedError


class TapeBatch(Batch):
    """Rows as vector lanes of a NumPy program: one NumPy call per SX instruction."""

    def __init__(self, factor: Factor, active: tuple[str, ...], n: int, uniform: tuple[int, ...]):
        rows, columns = factor.function(active).size_out(0)
        self.inputs = [np.empty(b.size if k in uniform else (b.size, n)) for k, b in enumerate(factor.blocks)]
        self.data = np.empty((factor.n_data, n))
        self.system = np.empty((columns, rows, n))
        output = self.system.reshape(columns * rows, n)
        self._run = _tape(factor, active, uniform).bind([*self.inputs, self.data], output)

    def evaluate(self) -> None:
        self._run()


class VmBatch(Batch):
    """Rows through CasADi's virtual machine; the arrays are views of the buffers it reads and writes."""

    def __init__(self, factor: Factor, active: tuple[str, ...], n: int):
        f = factor.function(active)
        rows, columns = f.size_out(0)
        arrays = [np.zeros((n, f.nnz_in(k))) for k in range(f.n_in())]
        output = np.zeros((n, columns, rows))
        *self.inputs, self.data = (a.T for a in arrays)
        self.system = output.transpose(1, 2, 0)
        buffer: Any  # holds raw pointers into the arrays, which live as long as their views here
        buffer, self._trigger = _mapped(factor, active, n).buffer()
        for k, a in enumerate(arrays):
            buffer.set_arg(k, a.data)
        buffer.set_res(0, output.data)
        self._buffer = buffer

    def evaluate(self) -> None:
        self._trigger()
