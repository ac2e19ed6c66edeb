"""Time offset and extrinsics as variables of the window: what is found, what is held, what the prior keeps."""

from __future__ import annotations

from dataclasses import replace

import dense
import numpy as np
import pytest
import synthetic_stereo as ss
import synthetic_timing as st
import synthetic_window as sw

from vins_core.geometry import se3, so3
from vins_core.params import Params
from vins_core.params import replace as with_params
from vins_core.sensors import Calibration
from vins_core.solver.covariance import calibration_sigmas
from vins_core.solver.ipopt import compare_optimum
from vins_core.solver.layout import Variable
from vins_core.solver.linearize import Linearizer
from vins_core.solver.solve import solve
from vins_core.window import online
from vins_core.window.assemble import assemble, unpack
from vins_core.window.marginalize import marginalize_oldest
from vins_core.window.slide import drop_oldest
from vins_core.window.state import BlockKey, Calibrates, WindowState
from vins_core.window.timing import referred_to, seen_at

PARAMS = with_params(Params(), {"window.max_iterations": 30})
TD_S = 0.015
FORMS = ("plane", "sphere")


def freed(window: WindowState, params: Params = PARAMS):
    """Problem and assembly with what the gates release."""
    assembly = assemble(params, window, sw.GRAVITY)
    released = online.release(params, window)
    return replace(assembly, problem=released.free(assembly.problem)), released


def solved(window: WindowState, params: Params = PARAMS) -> WindowState:
    assembly, _ = freed(window, params)
    return unpack(window, assembly, solve(params, assembly.problem).states)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("stereo", [False, True])
def test_a_window_finds_how_much_later_its_images_were_taken(stereo: bool, form: str) -> None:
    params = with_params(PARAMS, {"projection.residual": form})
    window = online.believe(params.online, st.make(TD_S, stereo=stereo, n_tracks=150).window)
    assert solved(window, params).td_s == pytest.approx(TD_S, abs=1e-3)
    held = with_params(params, {"online.min_speed": 10.0})
    assert solved(window, held).td_s == 0.0


def test_its_error_is_within_what_it_claims() -> None:
    errors = []
    for seed in range(6):
        window = online.believe(PARAMS.online, st.make(TD_S, seed, n_tracks=100).window)
        assembly, released = freed(window)
        solution = solve(PARAMS, assembly.problem)
        report = online.report(unpack(window, assembly, solution.states), released, assembly.problem, solution)
        assert report is not None and np.isnan(report.extrinsic_sigma).all()
        errors.append((report.td_s - TD_S) / report.td_sigma_s)
    assert np.abs(errors).max() < 3


def test_rays_referred_to_the_true_offset_are_those_of_the_poses() -> None:
    flight = st.make(TD_S, n_tracks=80, noise_px=0.0)
    exact = st.make(0.0, n_tracks=80, noise_px=0.0)
    for late, true in zip(flight.truth.frames, exact.truth.frames):
        error = np.linalg.norm(seen_at(late, TD_S).rays - true.observations.rays, axis=1)
        moved = np.linalg.norm(late.observations.rays - true.observations.rays, axis=1)
        assert error.mean() < 0.1 * moved.mean()
        assert seen_at(late, 0.0) is late.observations
        there = referred_to(late, TD_S)
        np.testing.assert_allclose(seen_at(there, 0.0).rays, late.observations.rays, atol=1e-12)


@pytest.mark.parametrize("free_extrinsics", [False, True])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("stereo", [False, True])
def test_normal_equations_are_those_of_the_stacked_jacobian(stereo: bool, form: str, free_extrinsics: bool) -> None:
    params = with_params(PARAMS, {"projection.residual": form})
    window = online.believe(params.online, st.make(TD_S, stereo=stereo, n_frames=7, n_tracks=50).window)
    problem = replace(freed(window, params)[0].problem, free_extrinsics=free_extrinsics)
    assert problem.free_td
    problem = replace(problem, initial=replace(problem.initial, td_s=np.array([0.006])))
    J, r, linearizer = dense.jacobian(problem)
    system, D = Linearizer(problem).linearize(problem.initial), linearizer.layout.size
    scale = np.sqrt(np.maximum(np.diag(J.T @ J), 1e-12))
    H = (J.T @ J / np.outer(scale, scale))[:D, :D]
    np.testing.assert_allclose(system.H / np.outer(scale[:D], scale[:D]), H, atol=1e-10)
    np.testing.assert_allclose(np.append(system.g, system.g_l) / scale, J.T @ r / scale, atol=1e-7)
    column = linearizer.layout.columns("td", [0])[0, 0]
    assert np.abs(J[:, column]).max() > 0


@pytest.mark.parametrize("first_estimates", [False, True])
@pytest.mark.parametrize("form", FORMS)
def test_marginalising_then_solving_equals_solving_everything(form: str, first_estimates: bool) -> None:
    params = with_params(PARAMS, {"projection.residual": form, "marginalization.first_estimates": first_estimates})
    window = online.believe(params.online, st.make(TD_S, n_tracks=120).window)
    window = replace(window, calibrates=Calibrates(td=True, extrinsics=True))
    whole = replace(assemble(params, window, sw.GRAVITY).problem, free_td=True, free_extrinsics=True)
    prior, _ = marginalize_oldest(params, window, sw.GRAVITY)
    assert prior is not None and BlockKey("td", 0) in prior.blocks
    _, second, *others = window.frames
    leaving = assemble(params, window, sw.GRAVITY)
    gone = np.isin(window.landmarks.ids, leaving.ids[leaving.anchor == 0])
    status = np.where(gone, 2, window.landmarks.status).astype(np.uint8)
    rest = replace(
        window,
        frames=(replace(second, imu=None), *others),
        landmarks=replace(window.landmarks, status=status),
        prior=prior,
    )
    left = replace(assemble(params, rest, sw.GRAVITY).problem, free_td=True, free_extrinsics=True)
    full, reduced = dense.step(whole, held_slot=1), dense.step(left, held_slot=0)
    worst = max(np.abs(d).max() for d in full.values())
    assert Variable("td", 0) in reduced
    for block, d in reduced.items():
        same = block if block.kind in ("extrinsic", "td") else Variable(block.kind, block.slot + 1)
        np.testing.assert_allclose(d, full[same], atol=1e-7 * worst)


def test_ipopt_finds_no_better_optimum() -> None:
    params = with_params(PARAMS, {"window.size": 7})
    window = replace(st.make(TD_S, n_frames=8, n_tracks=80).window, calibrates=Calibrates(td=True, extrinsics=True))
    problem = freed(solved(online.believe(params.online, window), params), params)[0].problem
    assert problem.free_td and problem.free_extrinsics
    assert abs(compare_optimum(problem, solve(params, problem)).excess) < 1e-4


def test_rough_extrinsics_come_back_and_the_prior_remembers_them() -> None:
    flight = ss.make(2, n_tracks=250)
    turn = se3.from_quaternion_translation(so3.exp(np.radians([1.0, -1.0, 0.5])), np.array([0.01, -0.01, 0.01]))
    rough = replace(flight.window, T_b_c=flight.window.T_b_c @ turn, calibrates=Calibrates(extrinsics=True))
    rough = online.believe(PARAMS.online, rough)
    problem = freed(rough)[0].problem
    solution = solve(PARAMS, problem)
    window = unpack(rough, freed(rough)[0], solution.states)
    for found, given, true in zip(window.T_b_c, rough.T_b_c, sw.T_B_C @ np.stack([np.eye(4), ss.T_C0_C1])):
        before, after = (np.linalg.norm(online.moved(T, true)[1]) for T in (given, found))
        assert after < 0.2 * before
    prior, _ = marginalize_oldest(PARAMS, window, sw.GRAVITY)
    assert prior is not None and {BlockKey("extrinsic", 0), BlockKey("extrinsic", 1)} <= set(prior.blocks)
    slid = freed(drop_oldest(replace(window, prior=prior)), with_params(PARAMS, {"window.size": 9}))[0].problem
    _, known = calibration_sigmas(problem, solution.states)
    _, remembered = calibration_sigmas(slid, slid.initial)
    _, forgotten = calibration_sigmas(replace(slid, prior=None), slid.initial)
    assert (remembered < 1.1 * known).all()
    assert (forgotten[:, :3] > 5 * known[:, :3]).all()


def test_what_holds_the_calibration_is_told() -> None:
    both = Calibrates(td=True, extrinsics=True)
    window = replace(st.make(TD_S, n_tracks=60).window, calibrates=both)
    free = online.release(PARAMS, window)
    assert free.td and free.extrinsics
    short = online.release(PARAMS, replace(window, frames=window.frames[:6]))
    assert short.td and not short.extrinsics
    first = replace(window.frames[0], v_w_b=np.zeros(3))
    still = online.release(PARAMS, replace(window, frames=(first, *window.frames[1:])))
    assert not still.td and not still.extrinsics
    assert [g.knob for g in still.td_gates if not g.passed] == ["online.min_speed"]
    nothing = online.release(PARAMS, replace(window, calibrates=Calibrates()))
    assert not nothing.td_gates and not nothing.extrinsic_gates


def test_the_first_prior_believes_what_is_given_and_a_later_one_stays() -> None:
    window = replace(st.make(TD_S, n_tracks=60).window, calibrates=Calibrates(td=True, extrinsics=True))
    believed = online.believe(PARAMS.online, window)
    assert believed.prior is not None
    assert believed.prior.blocks == (BlockKey("td", 0), BlockKey("extrinsic", 0))
    sigma = 1 / np.diag(believed.prior.J)
    asked = PARAMS.online
    np.testing.assert_allclose(
        sigma, [asked.td_sigma_s, *[asked.translation_sigma_m] * 3, *[np.radians(asked.rotation_sigma_deg)] * 3]
    )
    assert online.believe(PARAMS.online, believed) is believed
    nowhere = window.T_b_c.copy()
    nowhere[:, :3, 3] = 0.0
    lost = online.believe(PARAMS.online, replace(window, T_b_c=nowhere)).prior
    assert lost is not None and lost.J[1, 1] == 1 / asked.unknown_sigma_m


def test_parameters_win_over_what_the_calibration_asks_for() -> None:
    given = Calibration((), sw.NOISE, 9.81, estimate_td=True, extrinsics="fixed")
    assert online.wanted(PARAMS.online, given) == Calibrates(td=True)
    other = with_params(PARAMS, {"online.td": "off", "online.extrinsics": "on"})
    assert online.wanted(other.online, given) == Calibrates(extrinsics=True)
    assert online.wanted(other.online, replace(given, has_imu=False)) == Calibrates()


def test_an_offset_that_is_no_longer_estimated_stays_and_its_prior_too() -> None:
    window = online.believe(PARAMS.online, st.make(TD_S, n_tracks=120).window)
    found = solved(window)
    held = replace(found, calibrates=Calibrates())
    assert held.knows_td and solved(held).td_s == found.td_s
    prior, _ = marginalize_oldest(PARAMS, held, sw.GRAVITY)
    assert prior is not None and BlockKey("td", 0) in prior.blocks
