import casadi as ca
import numpy as np
import pytest

from vins_core.factors.tape import record


def everything() -> ca.Function:
    """Every operation the tape knows, on values of a row, on uniform ones, and on both."""
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 3)

    def operations(a, b, c):
        return [a + b, a - b, a * b, a / b, ca.fmax(a, b), ca.fmin(b, c), -a, a * a, 2 * b, 1 / c, ca.sqrt(b * b + 1),
                ca.sin(a), ca.cos(c)]  # fmt: skip

    rows = [*operations(*ca.vertsplit(x)), *operations(*ca.vertsplit(u)), *operations(x[0], u[1], x[2])]
    twice = x[0] * u[0] + 1
    return ca.Function("everything", [x, u], [ca.vertcat(*rows, x[1], u[2], 3.5, twice, twice, twice * x[1])])


@pytest.mark.parametrize("uniform", [(), (1,)])
def test_replay_equals_casadi(uniform):
    f, lanes = everything(), 5
    rng = np.random.default_rng(0)
    x, u = rng.uniform(0.5, 2, (3, lanes)), rng.uniform(0.5, 2, 3)
    inputs = [x, u if uniform else np.repeat(u[:, None], lanes, 1)]
    output = np.full((f.nnz_out(0), lanes), np.nan)
    run = record(f, uniform).bind(inputs, output)
    run()
    expected = np.column_stack([np.array(f(column, u)).ravel() for column in x.T])
    np.testing.assert_allclose(output, expected, rtol=1e-14)
    x[:] = rng.uniform(0.5, 2, x.shape)  # the next call reads the inputs again
    run()
    np.testing.assert_allclose(output[:, 0], np.array(f(x[:, 0], u)).ravel(), rtol=1e-14)


def test_results_are_the_same_bits_whatever_the_number_of_lanes():
    f = everything()
    rng = np.random.default_rng(1)
    x, u = rng.uniform(0.5, 2, (3, 37)), rng.uniform(0.5, 2, 3)
    outputs = []
    for lanes in (37, 1):
        output = np.empty((f.nnz_out(0), lanes))
        record(f, (1,)).bind([np.ascontiguousarray(x[:, :lanes]), u], output)()
        outputs.append(output[:, 0].tobytes())
    assert outputs[0] == outputs[1]


def test_an_operation_without_numpy_form_is_named():
    x = ca.SX.sym("x")
    with pytest.raises(NotImplementedError, match="strange: CasADi operation"):
        record(ca.Function("strange", [x], [ca.erf(x)]))
