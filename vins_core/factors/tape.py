"""A CasADi SX function replayed as a NumPy vector program: a batch evaluated without a compiler.

CasADi lists a function as scalar instructions over numbered registers.  Here every register is a vector with one lane
per row of the batch, and every instruction one NumPy call into preallocated memory.  Inputs are read in place,
results of the last instruction go straight to the output, and what depends only on uniform inputs (the same for
every row) stays plain Python floats.
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
    ca.OP_FMAX: "maximum({0}, {1}, {out})",
    ca.OP_FMIN: "minimum({0}, {1}, {out})",
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


@dataclass(frozen=True)
class Tape:
    """The program of one function: `source` defines run(inputs, outputs, work)."""

    source: str
    n_registers: int
    program: Callable[[Sequence[np.ndarray], Sequence[np.ndarray], np.ndarray], None]

    def bind(self, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray], lanes: int) -> Callable[[], None]:
        """A call without arguments that reads `inputs` and fills `outputs` each time."""
        work = np.empty((self.n_registers, lanes))
        program = self.program

        def run() -> None:
            program(inputs, outputs, work)

        return run


def record(f: ca.Function, uniform: tuple[int, ...] = ()) -> Tape:
    """Translate `f`; `uniform` are the inputs that have one value for all lanes."""
    instructions = [
        (f.instruction_id(k), f.instruction_input(k), f.instruction_output(k), k) for k in range(f.n_instructions())
    ]
    value: dict[int, str] = {}  # register -> the Python name that holds it
    vectors: set[str] = set()
    body: list[str] = []
    n_scalars = 0
    for op, args, result, k in instructions:
        if op == ca.OP_INPUT:
            name = f"i{args[0]}_{args[1]}"
            if args[0] not in uniform:
                vectors.add(name)
        elif op == ca.OP_CONST:
            name = repr(float(f.instruction_constant(k)))
        elif op == ca.OP_OUTPUT:
            body.append(f"o{result[0]}[{result[1]}] = {value[args[0]]}")
            continue
        else:
            operands = [value[a] for a in args]
            if any(o in vectors for o in operands):
                name = f"w{result[0]}"
                vectors.add(name)
                body.append(_VECTOR[op].format(*operands, out=name))
            else:
                name, n_scalars = f"u{n_scalars}", n_scalars + 1
                body.append(f"{name} = " + _SCALAR[op].format(*(f"({o})" for o in operands)))
        value[result[0]] = name

    registers = sorted((v for v in vectors if v[0] == "w"), key=lambda v: int(v[1:]))
    head = [
        ", ".join(f"i{k}_{j}" for j in range(f.nnz_in(k))) + f", = inputs[{k}]" + (".tolist()" if k in uniform else "")
        for k in range(f.n_in())
    ]
    head += [", ".join(f"o{k}" for k in range(f.n_out())) + ", = outputs"]
    head += [", ".join(registers) + ", = work"] if registers else []
    source = "def run(inputs, outputs, work):\n" + "\n".join(f"    {line}" for line in head + body)
    scope = {
        name: getattr(np, name)
        for name in ("add", "subtract", "multiply", "divide", "maximum", "minimum", "negative", "sqrt", "sin", "cos")
    }
    scope["math"] = math
    exec(compile(source, f"<tape of {f.name()}>", "exec"), scope)  # our own residual, never text from outside
    return Tape(source, len(registers), scope["run"])
