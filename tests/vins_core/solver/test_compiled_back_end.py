"""The compiled back end is optional, never waited for, and gives the bits of NumPy; what does not is never used."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import synthetic_stereo as ss
import synthetic_timing as st
import synthetic_window as sw
from same import differences
from sample import CALIBRATION, RECORDING

from vins_core import params as settings
from vins_core.errors import BackendError, RunError
from vins_core.factors.c_source import c_function
from vins_core.factors.robust import Loss
from vins_core.params import Params
from vins_core.record.fork import fork
from vins_core.record.reader import RunReader
from vins_core.runner import run_recording
from vins_core.solver import backend, compile, compiled_rows
from vins_core.solver.backend import COMPILED, NUMPY, VARIABLE, Backend, choose, recorded, using
from vins_core.solver.linearize import Linearizer, NormalEquations
from vins_core.solver.problem import Depths, States, WindowProblem
from vins_core.solver.solve import solve
from vins_core.window.assemble import assemble

needs_compiler = pytest.mark.skipif(compile.find_compiler() is None, reason="needs a C compiler: cc, gcc, clang or $CC")


@pytest.fixture(autouse=True)
def nothing_decided(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(compile, "_background", None)
    yield
    if compile._background is not None:
        compile._background.wait()


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A user's cache with the kernels in it."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        compile.build_now()
    return folder


@pytest.fixture
def compiled(cache: Path, monkeypatch: pytest.MonkeyPatch) -> Backend:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    return choose("c")


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "vinspect" / "compiled"


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.delenv("CC", raising=False)


def compiler_that(does: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """$CC becomes a script that tells its version and otherwise does this."""
    script = folder / "odd-cc"
    script.write_text(f'#!/bin/sh\n[ "$1" = --version ] && echo "odd-cc 1.0" && exit 0\n{does}\n')
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))


def problem(form: str = "plane", **options: object) -> WindowProblem:
    params = settings.replace(Params(), {"projection.residual": form, "window.size": 6})
    return replace(assemble(params, sw.steady(params, n_tracks=60).window, sw.GRAVITY).problem, **options)


def linearize(with_backend: Backend, p: WindowProblem, states: States | None = None) -> NormalEquations:
    with using(with_backend):
        return Linearizer(p).linearize(states or p.initial)


# -- the same bits ---------------------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("loss", [Loss("none"), Loss("cauchy", 1.0), Loss("huber", 0.7)], ids=str)
@pytest.mark.parametrize("free_extrinsics", [False, True])
@pytest.mark.parametrize("form", ["plane", "sphere"])
def test_normal_equations_have_the_bits_of_numpy(
    compiled: Backend, form: str, free_extrinsics: bool, loss: Loss
) -> None:
    p = problem(form, free_extrinsics=free_extrinsics, loss=loss)
    assert differences(linearize(compiled, p), linearize(choose("numpy"), p)) == []


@needs_compiler
@pytest.mark.parametrize("n", [1, 2, 63, 64, 65, 128])
def test_any_number_of_projections_is_evaluated(compiled: Backend, n: int) -> None:
    p = problem()
    p = replace(p, projections=p.projections[:n])
    assert differences(linearize(compiled, p), linearize(choose("numpy"), p)) == []


@needs_compiler
@pytest.mark.parametrize("inertial", [True, False])
@pytest.mark.parametrize("free_extrinsics", [False, True])
@pytest.mark.parametrize("form", ["plane", "sphere"])
def test_two_cameras_have_the_bits_of_numpy(
    compiled: Backend, form: str, free_extrinsics: bool, inertial: bool
) -> None:
    params = settings.replace(Params(), {"projection.residual": form})
    window = ss.make(n_frames=7, n_tracks=60).window
    p = assemble(params, window if inertial else ss.without_imu(window), sw.GRAVITY).problem
    p = replace(p, free_extrinsics=free_extrinsics)
    assert [table.kind for table in p.tables] == ["mono", "cross", "same"]
    assert differences(linearize(compiled, p), linearize(choose("numpy"), p)) == []


@needs_compiler
@pytest.mark.parametrize("free_extrinsics", [False, True])
@pytest.mark.parametrize("form", ["plane", "sphere"])
def test_a_free_time_offset_has_the_bits_of_numpy(compiled: Backend, form: str, free_extrinsics: bool) -> None:
    params = settings.replace(Params(), {"projection.residual": form})
    window = st.make(0.01, stereo=True, n_frames=7, n_tracks=60).window
    p = replace(assemble(params, window, sw.GRAVITY).problem, free_td=True, free_extrinsics=free_extrinsics)
    p = replace(p, initial=replace(p.initial, td_s=np.array([0.007])))
    assert differences(linearize(compiled, p), linearize(choose("numpy"), p)) == []


@needs_compiler
def test_depths_that_pull_and_are_held_have_the_bits_of_numpy(compiled: Backend) -> None:
    p = problem()
    rows = np.arange(p.n_landmarks)
    depths = Depths(rows[5:], 1.01 / p.initial.inv_depths[5:], 0.02, rows[:5])
    p = replace(p, depths=depths)
    assert linearize(compiled, p).cost.depth > 0
    assert differences(linearize(compiled, p), linearize(choose("numpy"), p)) == []


@needs_compiler
def test_a_place_seen_again_has_the_bits_of_numpy(compiled: Backend) -> None:
    """One more pose after those of the frames, which sees what the newest frame sees."""
    p = problem()
    table, newest = p.projections, p.n_frames - 1
    rows = np.concatenate([np.arange(len(table)), np.flatnonzero(table.observer == newest)])
    observer = np.append(table.observer, np.full(len(rows) - len(table), p.n_frames))
    initial = replace(p.initial, poses=np.concatenate([p.initial.poses, p.initial.poses[-1:]]))
    p = replace(p, initial=initial, projections=replace(table[rows], observer=observer))
    assert (p.n_frames, p.n_places) == (newest + 1, 1)
    assert differences(linearize(compiled, p), linearize(choose("numpy"), p)) == []
    with using(compiled):
        ours = solve(Params(), p)
    assert len(ours.iterations) > 2 and differences(ours, solve(Params(), p)) == []


@needs_compiler
def test_a_point_in_the_cameras_plane_has_no_finite_cost_in_either(compiled: Backend) -> None:
    p = problem(prior=None, imu=())
    identity = np.array([0.0, 0, 0, 1, 0, 0, 0])
    poses, inv_depths = p.initial.poses.copy(), p.initial.inv_depths.copy()
    table = p.projections
    poses[table.anchor[0]], inv_depths[table.landmark[0]] = identity, 0.5
    poses[table.observer[0]] = [0, 0, 2, 1, 0, 0, 0]
    states = replace(p.initial, poses=poses, extrinsics=identity[None], inv_depths=inv_depths)
    ours, theirs = linearize(compiled, p, states), linearize(choose("numpy"), p, states)
    assert ours.cost.total == theirs.cost.total == np.inf
    for a, b in ((ours.H, theirs.H), (ours.W, theirs.W), (ours.residuals.visual, theirs.residuals.visual)):
        np.testing.assert_array_equal(a, b)  # which also holds for two NaN, whatever their bits


@needs_compiler
@pytest.mark.parametrize("method", ["lm", "dogleg"])
def test_a_solve_has_the_bits_of_numpy(compiled: Backend, method: str) -> None:
    p, params = problem(), settings.replace(Params(), {"solver.method": method})
    with using(compiled):
        ours = solve(params, p)
    assert len(ours.iterations) > 2 and differences(ours, solve(params, p)) == []


@needs_compiler
def test_runs_of_both_have_the_same_bits(compiled: Backend, tmp_path: Path) -> None:
    runs = []
    for wish in ("numpy", "c"):
        run_recording(RECORDING, [CALIBRATION], out=tmp_path / wish, duration_s=2.5, backend=wish)
        runs.append(RunReader(tmp_path / wish))
    first, second = runs
    assert (first.header.backend, second.header.backend) == (NUMPY, compiled.name)
    assert sum(s.pose is not None for s in second.summaries) > 10
    for k in range(len(first)):
        assert differences(first.report(k), second.report(k)) + differences(first.state(k), second.state(k)) == []


@needs_compiler
def test_earlier_results_are_not_overwritten_by_later_ones(compiled: Backend) -> None:
    p = problem()
    with using(compiled):
        linearizer = Linearizer(p)
        first = linearizer.linearize(p.initial)
        linearizer.linearize(linearizer.retract(p.initial, np.full(linearizer.layout.size, 0.01), 0.01 + 0 * first.h))
    assert differences(first, linearize(choose("numpy"), p)) == []


@needs_compiler
def test_states_of_another_window_are_refused(compiled: Backend) -> None:
    p = problem()
    for states in (
        replace(p.initial, poses=p.initial.poses[:-1]),
        replace(p.initial, poses=p.initial.poses[:, :6]),
        replace(p.initial, inv_depths=p.initial.inv_depths[:-1]),
    ):
        with pytest.raises(ValueError, match="indexed"), using(compiled):
            Linearizer(p).visual[0]._rows.evaluate(states)


# -- what is not used ------------------------------------------------------------------------------------------------


@needs_compiler
def test_a_library_that_differs_in_the_last_bit_is_not_used(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = compiled_rows.source().replace("y[k][l] *= w[l];", "y[k][l] *= w[l] * 1.0000000000000002;")
    assert wrong != compiled_rows.source()
    monkeypatch.setattr(compile, "source", lambda: wrong)
    with pytest.raises(BackendError, match=r"differs from NumPy's by .*; use `--backend numpy`"):
        choose("c")
    assert choose().name == NUMPY


def test_operations_that_may_round_differently_are_not_compiled() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(NotImplementedError, match="strange: CasADi operation"):
        c_function(ca.Function("strange", [x], [ca.sin(x)]), "strange")


def test_a_compiler_that_fails_is_quoted_and_not_asked_again(
    empty_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler_that(f"echo asked >> {tmp_path}/asked; echo 'disk on fire' >&2; exit 1", tmp_path, monkeypatch)
    with pytest.raises(BackendError, match=r"odd-cc .* failed: disk on fire"):
        choose("c")
    assert [choose().name for _ in range(2)] == [NUMPY, NUMPY] and compile._background is None
    assert (tmp_path / "asked").read_text() == "asked\n"
    assert "disk on fire" in backend.describe()[1]


@needs_compiler
@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"source_sha256": "0"}, "another version of vinspect"),
        ({"cpu": "Z80"}, "another processor"),
        ({"source_sha256": 3}, "cannot be read"),
    ],
)
def test_a_library_made_for_something_else_is_not_loaded(
    cache: Path, empty_cache: Path, change: dict[str, object], why: str
) -> None:
    import json

    shutil.copytree(cache / "vinspect" / "compiled", empty_cache)
    (about,) = empty_cache.glob("*/about.json")
    about.write_text(json.dumps(json.loads(about.read_text()) | change))
    found = compile.lookup(about.parent.name)
    assert found is not None and found.library is None and why in found.problem


# -- auto: never waited for ------------------------------------------------------------------------------------------


@needs_compiler
def test_the_first_run_takes_numpy_and_the_next_what_was_compiled_meanwhile(empty_cache: Path) -> None:
    assert choose().name == NUMPY
    assert compile._background is not None
    assert compile._background.wait(120) == 0
    second = choose()
    assert second.name == f"{COMPILED} {next(empty_cache.iterdir()).name}"
    assert backend.describe()[0] == second.name


@needs_compiler
def test_two_processes_may_build_at_once(empty_cache: Path) -> None:
    command = [sys.executable, "-c", "from vins_core.solver import compile; compile.build(compile.find_compiler())"]
    both = [subprocess.Popen(command) for _ in range(2)]
    assert [process.wait(120) for process in both] == [0, 0]
    (folder,) = empty_cache.iterdir()
    assert sorted(p.name for p in folder.iterdir()) == ["about.json", "kernels.c", "kernels.so"]


def test_without_a_compiler_everything_goes_on_with_numpy(no_compiler: None, empty_cache: Path, tmp_path: Path) -> None:
    assert (choose().name, compile._background) == (NUMPY, None)
    assert backend.describe() == (NUMPY, "no C compiler for a faster one")
    with pytest.raises(BackendError, match=r"neither .* gcc or clang is one; install one"):
        choose("c")
    run_recording(RECORDING, [CALIBRATION], out=tmp_path / "run", duration_s=0.5)
    assert RunReader(tmp_path / "run").header.backend == NUMPY


def test_the_environment_decides_what_auto_leaves_open(
    no_compiler: None, empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, "c")
    with pytest.raises(BackendError):
        choose()
    assert choose("numpy").name == NUMPY
    monkeypatch.setenv(VARIABLE, "fortran")
    with pytest.raises(BackendError, match="VINSPECT_BACKEND is 'fortran'; expected one of auto, numpy, c"):
        choose()


def test_outside_of_using_it_is_numpy() -> None:
    mine = Backend("mine")
    with pytest.raises(KeyError), using(mine):
        assert backend.current() is mine
        raise KeyError
    assert backend.current().name == NUMPY


# -- replays take what the run took ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def compiled_run(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("compiled") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(cache))
        run_recording(RECORDING, [CALIBRATION], out=out, duration_s=2.0, backend="c")
    return out


@needs_compiler
def test_a_fork_takes_the_back_end_of_its_run(
    compiled_run: Path, compiled: Backend, no_compiler: None, tmp_path: Path
) -> None:
    run = RunReader(compiled_run)
    fork(run, 15, tmp_path / "fork", {}, frames=2)
    forked = RunReader(tmp_path / "fork")
    assert forked.header.backend == run.header.backend == compiled.name
    assert all(differences(forked.report(k), run.report(k)) == [] for k in (15, 16))


@needs_compiler
def test_a_fork_whose_back_end_is_gone_says_so_and_may_take_another(
    compiled_run: Path, no_compiler: None, empty_cache: Path, tmp_path: Path
) -> None:
    run = RunReader(compiled_run)
    with pytest.raises(RunError, match=r"which is not available here: there is no .* `--backend numpy`"):
        fork(run, 15, tmp_path / "fork", {}, frames=2)
    assert not (tmp_path / "fork").exists()
    fork(run, 15, tmp_path / "fork", {}, frames=2, backend="numpy")
    forked = RunReader(tmp_path / "fork")
    assert forked.header.backend == NUMPY
    assert all(differences(forked.report(k), run.report(k)) == [] for k in (15, 16))


@needs_compiler
def test_a_back_end_that_this_machine_can_make_again_is_made_again(compiled: Backend, empty_cache: Path) -> None:
    assert recorded(compiled.name).name == compiled.name
    assert (empty_cache / compiled.name.split()[1] / "kernels.so").exists()


@pytest.mark.parametrize("key", ["../../../evil", "/tmp/evil", "", "0123456789abcdef/../evil", "0123456789ABCDEF"])
def test_a_record_cannot_name_a_library_to_load(empty_cache: Path, monkeypatch: pytest.MonkeyPatch, key: str) -> None:
    opened: list[object] = []
    monkeypatch.setattr(compiled_rows.ctypes, "CDLL", opened.append)
    monkeypatch.setattr(Path, "read_bytes", lambda path: opened.append(path))
    with pytest.raises(RunError, match="not available here"):
        recorded(f"{COMPILED} {key}")
    assert not opened
