"""IPOPT, LM and dogleg are asked about the same windows and must agree."""

import os
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import synthetic_window as sw

from vins_core import examine
from vins_core.geometry import so3
from vins_core.params import Params
from vins_core.record.reader import RunReader
from vins_core.runner import run_recording
from vins_core.solver import dogleg, ipopt
from vins_core.solver import levenberg_marquardt as lm
from vins_core.solver.ipopt import compare_optimum, solve_ipopt
from vins_core.solver.layout import Layout
from vins_core.solver.linearize import Linearizer
from vins_core.window.assemble import assemble

SETTINGS = Params().solver
CONVERGED = replace(SETTINGS, function_tolerance=0.0)


def problem(seed: int = 0, free_extrinsics: bool = False, **options):
    built = assemble(Params(), sw.steady(Params(), seed, n_tracks=150, **options).window, sw.GRAVITY).problem
    return replace(built, free_extrinsics=free_extrinsics)


def evaluation(p, y: np.ndarray, hold_gauge: bool):
    """f and its derivatives in IPOPT's coordinates."""
    linearizer = Linearizer(p)
    system = linearizer.linearize(p.initial)
    coordinates = ipopt._Coordinates(system, p.initial.poses[0], linearizer.layout.size + p.n_landmarks, hold_gauge)
    d = coordinates.to_tangent(y)
    D = linearizer.layout.size
    states = linearizer.retract(p.initial, d[:D], d[D:])
    return ipopt._Evaluation(linearizer.layout, coordinates, y, linearizer.linearize(states))


@pytest.mark.parametrize("hold_gauge", [True, False])
@pytest.mark.parametrize("free_extrinsics", [True, False])
def test_gradient_is_that_of_the_cost_far_from_the_start(free_extrinsics, hold_gauge):
    p = problem(free_extrinsics=free_extrinsics)
    layout = Layout(p.n_frames, int(free_extrinsics))
    size = layout.size + p.n_landmarks
    scale = ipopt._Coordinates(Linearizer(p).linearize(p.initial), p.initial.poses[0], size, hold_gauge).scale
    rng = np.random.default_rng(0)
    away = np.zeros(size)  # rotations of 20 degrees: there the chain rule of the retraction matters
    away[: layout.visual] = 0.2 * rng.normal(size=layout.visual)
    y = away / scale
    for _ in range(4):
        direction = rng.normal(size=size)
        up, down = (evaluation(p, y + s * direction, hold_gauge).cost for s in (1e-4, -1e-4))
        slope = evaluation(p, y, hold_gauge).gradient @ direction
        assert slope == pytest.approx((up - down) / 2e-4, rel=1e-5, abs=1e-3)


def test_hessian_is_the_arrow_of_the_normal_equations():
    p = problem()
    layout, M = Layout(p.n_frames, 0), p.n_landmarks
    size = layout.size + M
    at = evaluation(p, np.zeros(size), hold_gauge=False)
    upper = np.array(ca.DM(ipopt._arrow(layout.size, layout.visual, M), at.hessian))
    system, scale = Linearizer(p).linearize(p.initial), at._coordinates.scale
    H = np.zeros((size, size))
    H[: layout.size, : layout.size] = system.H
    H[: layout.visual, layout.size :] = system.W.T
    H[range(layout.size, size), range(layout.size, size)] = system.h
    H *= scale * scale[:, None]
    np.testing.assert_allclose(upper, np.triu(H), atol=1e-12)


def test_ipopt_and_the_family_of_gauss_newton_agree():
    for seed in range(3):
        p = problem(seed, perturbation=0.3)
        for minimise in (lm.solve, dogleg.solve):
            ours = minimise(CONVERGED, 60, p)
            by_ipopt = solve_ipopt(p, gauge=ours.states.poses[0])
            assert by_ipopt.after.total == pytest.approx(ours.after.total, rel=1e-7)
            assert by_ipopt.termination.startswith("converged")
            assert by_ipopt.before.visual == pytest.approx(ours.before.visual)
            assert by_ipopt.iterations[-1].cost == pytest.approx(by_ipopt.after.total, rel=1e-9)


def test_held_gauge_stays_exactly_and_free_gauge_finds_a_lower_cost():
    p = problem(seed=1)
    held, free = solve_ipopt(p, hold_gauge=True), solve_ipopt(p, hold_gauge=False)
    before, after = p.initial.poses[0], held.states.poses[0]
    np.testing.assert_allclose(after[:3], before[:3], atol=1e-12)
    twist = so3.multiply(after[3:], so3.inverse(before[3:]))
    assert abs(twist[3]) < 1e-12 < np.linalg.norm(twist[1:3])
    assert free.after.total <= held.after.total * (1 + 1e-9)


def test_one_machine_serves_every_topology_of_a_size():
    large = problem()
    few = large.projections.landmark < large.n_landmarks - 3
    small = replace(
        large,
        projections=large.projections[few],
        initial=replace(large.initial, inv_depths=large.initial.inv_depths[:-3]),
    )
    step = ipopt.LANDMARK_STEP
    assert (small.n_landmarks - 1) // step == (large.n_landmarks - 1) // step
    ipopt._machine.cache_clear()
    first = solve_ipopt(small).after.total
    solve_ipopt(large)
    assert solve_ipopt(small).after.total == first
    assert ipopt._machine.cache_info().misses == 1


def test_the_comparison_says_where_a_solution_is_off():
    p = problem()
    optimum = lm.solve(CONVERGED, 60, p)
    at_it = compare_optimum(p, optimum)
    assert abs(at_it.excess) < 1e-7
    loose = ("theta", "b_a")  # 0.01 deg of tilt and 1.7 mm/s^2 of bias explain each other
    assert all(value < (1e-2 if name in loose else 1e-3) for name, value, _, _ in at_it.largest())

    poses, speed_biases, inv_depths = (
        a.copy() for a in (optimum.states.poses, optimum.states.speed_biases, optimum.states.inv_depths)
    )
    poses[3, 0] += 0.02
    speed_biases[4, 8] += 0.01
    inv_depths[7] += 0.3
    off = replace(optimum.states, poses=poses, speed_biases=speed_biases, inv_depths=inv_depths)
    system = Linearizer(p).linearize(off)
    found = compare_optimum(p, replace(optimum, states=off, system=system, after=system.cost))
    worst = {name: (value, slot) for name, value, _, slot in found.largest()}
    assert worst["p"] == (pytest.approx(0.02, rel=1e-2), 3)
    assert worst["b_g"] == (pytest.approx(0.01, rel=1e-2), 4)
    assert worst["inverse depth"] == (pytest.approx(0.3, rel=1e-2), 7)
    assert found.excess > 0 and found.iterations > 0 and found.ms > 0


def test_position_and_yaw_of_the_whole_window_are_no_difference():
    p = replace(problem(), prior=None)
    optimum = lm.solve(CONVERGED, 60, p)
    turn, shift = so3.exp(np.array([0, 0, 0.3])), np.array([1.0, 2.0, 3.0])
    poses = optimum.states.poses
    moved = replace(
        optimum.states,
        poses=np.hstack([so3.rotate(turn, poses[:, :3]) + shift, so3.multiply(turn, poses[:, 3:])]),
        speed_biases=np.hstack(
            [so3.rotate(turn, optimum.states.speed_biases[:, :3]), optimum.states.speed_biases[:, 3:]]
        ),
    )
    here, there = (compare_optimum(p, replace(optimum, states=states)) for states in (optimum.states, moved))
    np.testing.assert_allclose(there.p_m, here.p_m, atol=1e-4)
    np.testing.assert_allclose(there.v_m_s, here.v_m_s, atol=1e-4)


def agree_on(run: RunReader, frames: list[int]) -> None:
    """The figures of the interface's promise, on windows as they were solved in a run."""
    for k in frames:
        turn = examine.solved_window(run, k)
        assert turn is not None
        p = turn.solved.assembly.problem
        converged = lm.solve(CONVERGED, 60, p)
        optimum = solve_ipopt(p, gauge=converged.states.poses[0]).after.total
        assert converged.after.total == pytest.approx(optimum, rel=1e-6)
        assert dogleg.solve(SETTINGS, 8, p).after.total == pytest.approx(optimum, rel=1e-4)
        assert lm.solve(SETTINGS, 8, p).after.total == pytest.approx(optimum, rel=1e-4)


def test_agreement_on_windows_of_the_sample(sample_run: Path):
    agree_on(RunReader(sample_run), [12, 16, 20, 24, 28, 32, 35])


@pytest.mark.skipif("VINS_DATA" not in os.environ, reason="VINS_DATA is not set")
@pytest.mark.parametrize("name, frames", [("euroc_mh01_16s", range(14, 64, 5)), ("sim_room_60s", range(20, 70, 5))])
def test_agreement_on_windows_of_recordings(name: str, frames: range, tmp_path: Path):
    folder = Path(os.environ["VINS_DATA"]) / name
    run_recording(folder, [folder / "vins_mono.yaml"], out=tmp_path / "run", duration_s=7.0)
    agree_on(RunReader(tmp_path / "run"), list(frames))
