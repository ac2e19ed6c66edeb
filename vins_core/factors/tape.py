"""A CasADi SX function replayed as a NumPy vector program: a batch evaluated without a compiler.

CasADi lists a function as scalar instructions over numbered registers.  Here every register is a vector with one lane
per row of the batch, and every instruction one NumPy call into preallocated memory.  Inputs are read in place,
results are written straight to the output, and what depends only on uniform inputs (the same for every row) stays
plain Python floats.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

_VECTOR = {
    ca.OP_ADD: "add({0}, {1}, {out})",
    ca.OP_SUB: "subtract({0}, {1}, {out})",
    ca.OP_MUL: "multiply({0}, {1}, {out})",
    ca.OP_DIV: "divide({0}, {1}, {out})",
    ca.OP_FMAX: "maximum({0}, {1}, out={out})",
    ca.OP_FMIN: "minimum({0}, {1}, out={out})",
    ca.OP_NEG: "negative({0}, {out})",
    ca.OP_SQ: "multiply({0}, {0}, {out})",
    ca.OP_TWICE: "add({0}, {0}, {out})",
    ca.OP_INV: "divide(1.0, {0}, {out})",
    ca.OP_SQRT: "sqrt({0}, {out})",
    ca.OP_SIN: "sin({0}, {out})",
    ca.OP_COS: "cos({0}, {out})",
}
_SCALAR = {
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_FMAX: "max({0}, {1})",
    ca.OP_FMIN: "min({0}, {1})",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SQRT: "math.sqrt({0})",
    ca.OP_SIN: "math.sin({0})",
    ca.OP_COS: "math.cos({0})",
}
_NAMES = ("add", "subtract", "multiply", "divide", "maximum", "minimum", "negative", "sqrt", "sin", "cos")


@dataclass(frozen=True)
class Tape:
    """The program of a function with one output: `source` defines run(inputs, output, work)."""

    source: str
    n_registers: int
    program: Callable[[Sequence[np.ndarray], np.ndarray, np.ndarray], None]

    def bind(self, inputs: Sequence[np.ndarray], output: np.ndarray) -> Callable[[], None]:
        """A call without arguments that reads `inputs` (size, lanes) and fills `output` (size, lanes) each time."""
        work = np.empty((self.n_registers, output.shape[1]))
        program = self.program

        def run() -> None:
            program(inputs, output, work)

        return run


def record(f: ca.Function, uniform: tuple[int, ...] = ()) -> Tape:
    """Translate `f`; `uniform` are the inputs that have one value for all lanes."""
    count = range(f.n_instructions())
    instructions = [(f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)) for k in count]
    destination = _destinations(instructions)
    held: dict[int, str] = {}  # register -> the Python expression of its value
    vectors = {f"i{k}_{j}" for k in range(f.n_in()) if k not in uniform for j in range(f.nnz_in(k))}
    body: list[str] = []
    for k, (op, args, result) in enumerate(instructions):
        if op == ca.OP_INPUT:
            name = f"i{args[0]}_{args[1]}"
        elif op == ca.OP_CONST:
            name = repr(float(f.instruction_constant(k)))
        elif op == ca.OP_OUTPUT:
            if held[args[0]] != f"o{result[1]}":
                body.append(f"o{result[1]}[:] = {held[args[0]]}")
            continue
        elif op not in _VECTOR:
            raise NotImplementedError(f"{f.name()}: CasADi operation {op} has no NumPy form on the tape")
        else:
            operands = [held[a] for a in args]
            if vectors.isdisjoint(operands):
                name = f"u{k}"
                body.append(f"{name} = " + _SCALAR[op].format(*(f"({o})" for o in operands)))
            else:
                name = destination.get(k, f"w{result[0]}")
                vectors.add(name)
                body.append(_VECTOR[op].format(*operands, out=name))
        held[result[0]] = name

    registers = sorted(v for v in vectors if v[0] == "w")
    unpack = [
        "".join(f"i{k}_{j}, " for j in range(f.nnz_in(k))) + f"= inputs[{k}]" + (".tolist()" if k in uniform else "")
        for k in range(f.n_in())
    ]
    unpack.append("".join(f"o{j}, " for j in range(f.nnz_out(0))) + "= output")
    if registers:
        unpack.append("".join(f"{w}, " for w in registers) + "= work")
    source = "def run(inputs, output, work):\n" + "\n".join(f"    {line}" for line in unpack + body)
    scope = {"math": math} | {name: getattr(np, name) for name in _NAMES}
    exec(compile(source, f"<tape of {f.name()}>", "exec"), scope)  # our own residual, never text from outside
    return Tape(source, len(registers), scope["run"])


def _destinations(instructions: list[tuple[int, list[int], list[int]]]) -> dict[int, str]:
    """Instruction -> the output row that its result is for, so that it can be computed there."""
    defined: dict[int, int] = {}  # register -> instruction that filled it last
    rows: dict[int, str] = {}
    for k, (op, args, result) in enumerate(instructions):
        if op == ca.OP_OUTPUT:
            rows.setdefault(defined[args[0]], f"o{result[1]}")
        else:
            defined[result[0]] = k
    return rows
