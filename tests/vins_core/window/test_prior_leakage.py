"""What a prior claims to know of the heading: with VINS' settings, with exact linearisation, and by moving the window.

Everything here about turning a window is NumPy on its own: quaternions (w, x, y, z) multiplied out, no derivative.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic_window as sw
from sample import CALIBRATION, RECORDING

from vins_core import examine
from vins_core import params as settings
from vins_core.params import Params
from vins_core.record.reader import RunReader
from vins_core.runner import run_recording
from vins_core.solver.levenberg_marquardt import solve
from vins_core.window.assemble import assemble, unpack
from vins_core.window.marginalize import marginalize_oldest
from vins_core.window.slide import drop_oldest
from vins_core.window.state import Prior, WindowState

PARITY = Path(__file__).parents[3] / "docs" / "parity.yaml"
FIRST_ESTIMATES = settings.replace(Params(), {"marginalization.first_estimates": True})
YAW = 3
NONE = 1e-9  # 1/rad^2: a standard deviation of 30,000 rad


def estimated(folder: Path, **how) -> RunReader:
    run_recording(RECORDING, [CALIBRATION], out=folder / "run", duration_s=4.5, **how)
    return RunReader(folder / "run")


@pytest.fixture(scope="module")
def parity_run(tmp_path_factory: pytest.TempPathFactory) -> RunReader:
    return estimated(tmp_path_factory.mktemp("parity"), params_file=PARITY)


def turned(angle: float, block, x: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """A block after the world was turned by `angle` about the vertical through `centre`."""
    c, s = np.cos(angle), np.sin(angle)
    Rz = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    if block.kind == "pose":
        return np.append(centre + Rz @ (x[:3] - centre), product([np.cos(angle / 2), 0, 0, np.sin(angle / 2)], x[3:]))
    return np.append(Rz @ x[:3], x[3:]) if block.kind == "speed_bias" else x


def product(a, b) -> np.ndarray:
    w, x, y, z = a
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]) @ b


def difference(block, x: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """x [-] x0."""
    if block.kind == "speed_bias":
        return x - x0
    w, *v = product([x0[3], *-x0[4:]], x[3:])
    half = np.arctan2(np.linalg.norm(v), w)
    return np.append(x[:3] - x0[:3], 2 * half * np.array(v) / np.linalg.norm(v) if half else np.zeros(3))


def residual(prior: Prior, values: list[np.ndarray], angle: float) -> np.ndarray:
    """r of the prior once everything was turned."""
    centre = np.mean([x[:3] for block, x in zip(prior.blocks, values) if block.kind == "pose"], axis=0)
    moved = [turned(angle, block, x, centre) for block, x in zip(prior.blocks, values)]
    d = [difference(block, x, x0) for block, x, x0 in zip(prior.blocks, moved, prior.x0)]
    return prior.r + prior.J @ np.concatenate(d)


def current(prior: Prior, window: WindowState) -> list[np.ndarray]:
    frames, T = {f.frame: f for f in window.frames}, window.T_b_c[0]
    values = []
    for block, x0 in zip(prior.blocks, prior.x0):
        f = frames.get(block.id)
        if block.kind == "pose":
            values.append(np.concatenate([f.p_w_b, f.q_w_b]))
        elif block.kind == "speed_bias":
            values.append(np.concatenate([f.v_w_b, f.b_a, f.b_g]))
        else:
            np.testing.assert_allclose(x0[:3], T[:3, 3])  # held: where it was
            values.append(x0)
    return values


def test_with_the_settings_of_vins_yaw_leaks_into_the_prior_and_grows(parity_run: RunReader) -> None:
    leaks = examine.yaw_leakage(parity_run)
    first, *later = leaks[np.isfinite(leaks)]
    assert first < NONE
    assert later[0] < later[1] < later[2] < later[3] < later[4]
    assert min(later[5:]) > 100.0  # from here on it claims to know the heading to 6 degrees


def test_what_leaked_is_what_turning_the_window_costs(parity_run: RunReader) -> None:
    angle = 1e-3
    for k in (14, 20, 30, 44):
        window = parity_run.state(k).window
        prior, seen = window.prior, examine.prior(parity_run, k)
        for leak, values in ((seen.first, list(prior.x0)), (seen.now, current(prior, window))):
            there, back = residual(prior, values, angle), residual(prior, values, -angle)
            slope = (there - back) / (2 * angle)
            assert leak.information[YAW] == pytest.approx(slope @ slope, rel=1e-4)
            pulls = (there @ there - back @ back) / (4 * angle)
            assert leak.wish[YAW] == pytest.approx(-pulls / (slope @ slope), rel=1e-3, abs=1e-6)
        report = parity_run.report(k).marginalization
        if report.kind != "none":
            assert report.gauge_information[YAW] == pytest.approx(seen.first.information[YAW], rel=1e-6)


def test_shifting_the_window_costs_nothing_even_then(parity_run: RunReader) -> None:
    for k in (14, 30, 44):
        prior, seen = parity_run.state(k).window.prior, examine.prior(parity_run, k)
        shift = np.concatenate([np.eye(b.size, 3) if b.kind == "pose" else np.zeros((b.size, 3)) for b in prior.blocks])
        assert np.square(prior.J @ shift).sum(0).max() < NONE
        assert seen.first.information[:YAW].max() < NONE


def test_the_turn_is_free_when_the_prior_was_made_at_first_estimates(tmp_path: Path) -> None:
    run = estimated(tmp_path, settings=["marginalization.first_estimates=true"])
    leaks = examine.yaw_leakage(run)
    assert np.isfinite(leaks).sum() > 25 and np.nanmax(leaks) < NONE
    prior = run.state(44).window.prior
    there, back = (residual(prior, list(prior.x0), angle) for angle in (1e-5, -1e-5))
    assert np.linalg.norm(there - back) / 2e-5 < 1e-4  # 1/rad; without first estimates it is 3


def departures(params: Params, window: WindowState, moves: bool, n: int = 5) -> list[np.ndarray]:
    """What leaked into each of the priors that `n` frames leave behind, with or without a solve in between."""
    leaks = []
    for _ in range(n):
        if moves:
            built = assemble(params, window, sw.GRAVITY)
            window = unpack(window, built, solve(params.solver, 8, built.problem).states)
        prior, report = marginalize_oldest(params, window, sw.GRAVITY)
        leaks.append(report.gauge_information)
        window = drop_oldest(replace(window, prior=prior))
    return leaks


def test_with_exact_linearisation_nothing_leaks() -> None:
    """All Jacobians at the same states, however wrong those are: the sum is as blind as each part."""
    window = sw.make(n_tracks=150, perturbation=1.0).window
    assert np.max(departures(Params(), window, moves=False)) < NONE


def test_estimates_that_move_between_two_marginalisations_leak_yaw_and_nothing_else() -> None:
    window = sw.make(n_tracks=150, perturbation=1.0).window
    first, *later = np.array(departures(Params(), window, moves=True))
    assert first.max() < NONE
    assert all(leak[:YAW].max() < NONE < 1e-2 < leak[YAW] for leak in later)
    assert np.max(departures(FIRST_ESTIMATES, window, moves=True)) < NONE
