"""Milliseconds of the back end: `OPENBLAS_NUM_THREADS=1 pytest tests/benchmarks/test_backend.py --benchmark-enable`.

A window as in flight: 11 frames, about 190 landmarks, 1300 projections, 10 IMU factors and a prior of 75 columns.
`dpotrf` of 172 is the yardstick that makes machines comparable.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read by BLAS when numpy is first imported

from dataclasses import replace

import numpy as np
import pytest
import synthetic_window as sw
from scipy.linalg import lapack

from vins_core.errors import BackendError
from vins_core.factors.preintegration import preintegrate
from vins_core.params import Params
from vins_core.solver import backend
from vins_core.solver.levenberg_marquardt import init, solve, step
from vins_core.solver.linearize import Linearizer
from vins_core.window.assemble import assemble, solve_report, unpack
from vins_core.window.marginalize import marginalize_oldest, marginalize_second_newest

PARAMS = Params()
EIGHT = replace(PARAMS.solver, function_tolerance=0.0)  # always all eight iterations


@pytest.fixture(scope="module", autouse=True, params=["numpy", "c"])
def each_backend(request):
    try:
        chosen = backend.choose(request.param)
    except BackendError as problem:
        pytest.skip(str(problem))
    with backend.using(chosen):
        yield


@pytest.fixture(scope="module")
def window():
    flight = sw.steady(PARAMS, n_tracks=222, longest_track=30)
    problem = assemble(PARAMS, flight.window, sw.GRAVITY).problem
    assert 180 <= problem.n_landmarks <= 205 and 1200 <= len(problem.projections) <= 1400
    assert problem.prior.J.shape == (75, 75) and len(problem.imu) == 10
    return flight.window


@pytest.fixture(scope="module")
def solved(window):
    built = assemble(PARAMS, window, sw.GRAVITY)
    return unpack(window, built, solve(EIGHT, 8, built.problem).states)


def test_yardstick_dpotrf_172(benchmark):
    rng = np.random.default_rng(0)
    A = rng.normal(size=(172, 172))
    A = np.asfortranarray(A @ A.T + 172 * np.eye(172))
    _, info = benchmark(lapack.dpotrf, A, lower=1, clean=0)
    assert info == 0


def test_assemble_solve_unpack(benchmark, window):
    def whole():
        built = assemble(PARAMS, window, sw.GRAVITY)
        solution = solve(EIGHT, 8, built.problem)
        return solution, unpack(window, built, solution.states), solve_report(built, solution)

    solution, *_ = benchmark(whole)
    assert len(solution.iterations) == 8 and solution.after.total < solution.before.total


def test_assemble(benchmark, window):
    assert benchmark(assemble, PARAMS, window, sw.GRAVITY).problem.n_landmarks


def test_set_up(benchmark, window):
    assert benchmark(Linearizer, assemble(PARAMS, window, sw.GRAVITY).problem).layout.size == 165


@pytest.mark.parametrize("form", ["plane", "sphere"])
def test_linearize(benchmark, window, form):
    problem = replace(assemble(PARAMS, window, sw.GRAVITY).problem, residual=form)
    assert benchmark(Linearizer(problem).linearize, problem.initial).cost.total > 0


def test_one_iteration(benchmark, window):
    problem = assemble(PARAMS, window, sw.GRAVITY).problem
    linearizer = Linearizer(problem)
    start = init(EIGHT, linearizer, problem.initial)
    assert benchmark(step, EIGHT, linearizer, start).reports[-1].accepted


def test_marginalize_oldest(benchmark, solved):
    prior, report = benchmark(marginalize_oldest, PARAMS, solved, sw.GRAVITY)
    assert prior is not None and report.n == 75


def test_marginalize_second_newest(benchmark, solved):
    _, report = benchmark(marginalize_second_newest, PARAMS, solved, sw.GRAVITY)
    assert report.n == 69


@pytest.mark.parametrize("n", [21, 41])
def test_preintegrate(benchmark, n):
    rng = np.random.default_rng(0)
    imu = sw.ImuSamples(np.arange(n) * 5_000_000, rng.normal(0, 0.3, (n, 3)), rng.normal(0, 1, (n, 3)))
    assert benchmark(preintegrate, imu, np.zeros(3), np.zeros(3), sw.NOISE).dt_s > 0
