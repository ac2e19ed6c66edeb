"""A CasADi SX function as C, for a block of lanes: the compiled counterpart of `tape`.

Every instruction becomes one statement inside a loop over lanes, which compilers turn into vector instructions:

    static void NAME(const double (*restrict x)[LANES], double (*restrict y)[LANES])

x holds the numbers of all inputs, one after the other, y those of the result.  Only operations that IEEE 754 rounds
correctly are translated: without contraction of a * b + c every compiler must give them the bits that NumPy gives.
"""

from __future__ import annotations

import casadi as ca

_EXACT = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_NEG: "-{}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {}",
    ca.OP_SQRT: "sqrt({})",
}


def c_function(f: ca.Function, name: str) -> str:
    """C99 source of `f`, a function with one result.  NotImplementedError names what cannot be translated."""
    first = [sum(f.nnz_in(j) for j in range(k)) for k in range(f.n_in())]  # row of x where each input begins
    held: dict[int, str] = {}  # register -> the C expression of its value
    body = []
    for k in range(f.n_instructions()):
        op, args, result = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if op == ca.OP_OUTPUT:
            body.append(f"y[{result[1]}][l] = {held[args[0]]};")
        elif op == ca.OP_INPUT:
            held[result[0]] = f"x[{first[args[0]] + args[1]}][l]"
        elif op == ca.OP_CONST:
            held[result[0]] = f"({float(f.instruction_constant(k)).hex()})"
        elif op in _EXACT:
            body.append(f"const double v{k} = {_EXACT[op].format(*(held[a] for a in args))};")
            held[result[0]] = f"v{k}"
        else:
            raise NotImplementedError(f"{f.name()}: CasADi operation {op} may round differently in C and in NumPy")
    return "\n".join(
        [
            f"static void {name}(const double (*restrict x)[LANES], double (*restrict y)[LANES]) {{",
            "  for (int l = 0; l < LANES; l++) {",
            *(f"    {line}" for line in body),
            "  }",
            "}",
        ]
    )
