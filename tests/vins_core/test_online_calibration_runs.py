"""Whole runs that find their time offset, undo a rolling shutter, and bring rough extrinsics back."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrating import TD_S
from same import differences

from vins_core.evaluation.evaluate import evaluate, run_trajectory
from vins_core.io.own_yaml import write
from vins_core.io.write import write_recording
from vins_core.record.fork import fork
from vins_core.record.reader import RunReader
from vins_core.record.reevaluate import GateHistory
from vins_core.runner import run_recording
from vins_core.simulation.scenarios import SCENARIOS
from vins_core.simulation.simulate import Simulation, build
from vins_core.window.online import moved

DATA = Path(os.environ.get("VINS_DATA", ""))
recorded = pytest.mark.skipif(not (DATA / "euroc_mh01_16s").is_dir(), reason="VINS_DATA has no euroc_mh01_16s")


def run(folder: Path, scenario: str, seed: int, duration_s: float, **changes) -> tuple[Simulation, RunReader]:
    simulation = build(scenario, replace(SCENARIOS[scenario], **changes), seed, duration_s)
    write_recording(simulation.messages(), folder / "recording", "asl", settings=simulation.settings)
    write(folder / "calibration.yaml", simulation.calibration, simulation.settings.overrides)
    return simulation, again(folder, "run")


def again(folder: Path, name: str, *settings: str) -> RunReader:
    settings = ("loop.enabled=off", *settings)
    run_recording(folder / "recording", [folder / "calibration.yaml"], out=folder / name, settings=settings)
    return RunReader(folder / name)


def ate_m(simulation: Simulation, reader: RunReader) -> float:
    found = evaluate(run_trajectory(reader.summaries), simulation.truth, 0.006)
    assert found.ate_rmse_m is not None
    return found.ate_rmse_m


@pytest.fixture(scope="module")
def found(calibrating_run: Path) -> RunReader:
    return RunReader(calibrating_run)


def test_an_offset_of_20_ms_is_found_within_a_millisecond(found: RunReader) -> None:
    known = [s.calibration for s in found.summaries if s.calibration]
    assert known and known[0].td_gates and known[0].extrinsic_gates
    assert known[-1].td_s == pytest.approx(TD_S, abs=1e-3)
    assert known[-1].td_sigma_s < 1e-3


def test_the_imu_follows_the_estimate_and_poses_tell_their_time(found: RunReader) -> None:
    poses = [k for k, s in enumerate(found.summaries) if s.pose]
    for k in poses[3:]:
        estimate_before, pose = found.summaries[k - 2].calibration, found.summaries[k].pose
        assert estimate_before is not None and pose is not None
        assert found.packet(k).late_ns == round(estimate_before.td_s * 1e9)
        assert pose.late_s == found.packet(k).late_ns * 1e-9


def test_a_run_that_calibrates_itself_is_repeated_bit_for_bit_from_the_record(found: RunReader, tmp_path: Path) -> None:
    at = next(k for k, s in enumerate(found.summaries) if s.calibration) - 1
    fork(found, at, tmp_path / "fork", {}, frames=8)
    forked = RunReader(tmp_path / "fork")
    assert [
        difference
        for k in range(at, at + 8)
        for part in ("report", "state", "packet")
        for difference in differences(getattr(found, part)(k), getattr(forked, part)(k))
    ] == []


def test_a_fork_may_stop_calibrating_and_a_fork_of_that_begin_again(found: RunReader, tmp_path: Path) -> None:
    at = len(found) - 8
    fork(found, at, tmp_path / "off", {"online.td": "off", "online.extrinsics": "off"})
    held, before = RunReader(tmp_path / "off"), found.state(at - 1).window
    assert all(s.calibration is None and s.pose for s in held.summaries[at:])
    after = held.state(len(held) - 1).window
    assert after.td_s == before.td_s
    np.testing.assert_array_equal(after.T_b_c, before.T_b_c)
    fork(held, at + 4, tmp_path / "on", {"online.extrinsics": "on"})
    last = RunReader(tmp_path / "on").summaries[-1].calibration
    assert last is not None and not last.td_gates and np.isfinite(last.extrinsic_sigma).all()
    assert not np.array_equal(last.T_b_c, before.T_b_c)


def test_a_higher_speed_would_have_held_it_longer_and_that_is_told_from_the_record(found: RunReader) -> None:
    history = GateHistory()
    history.follow(found)
    answer = history.reevaluate({"online.min_speed": 0.6})
    assert answer.unanswered == ()
    held_longer = {d.name: d.lost for d in answer.derived}
    assert set(held_longer) == {"td passes", "extrinsics passes"}
    speeds = {
        s.frame: gate.value
        for s in found.summaries
        if s.calibration
        for gate in s.calibration.td_gates
        if gate.knob == "online.min_speed"
    }
    assert held_longer["td passes"].tolist() == [k for k, v in speeds.items() if 0.2 <= v < 0.6]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_offset_stays_within_a_millisecond_over_a_whole_scenario(seed: int, tmp_path: Path) -> None:
    simulation, reader = run(tmp_path, "td_20ms", seed, 15.0)
    known = [s.calibration for s in reader.summaries if s.calibration]
    assert known[-1].td_s == pytest.approx(0.020, abs=1e-3)
    assert ate_m(simulation, reader) < 0.04


@pytest.mark.slow
def test_a_rolling_shutter_costs_at_most_a_third_of_the_accuracy_of_a_global_one(tmp_path: Path) -> None:
    errors = {"rolling_shutter_20ms": [], "room_loop": []}
    for scenario, found in errors.items():
        for seed in (1, 2, 3):
            found.append(ate_m(*run(tmp_path / f"{scenario}{seed}", scenario, seed, 15.0)))
    assert np.median(errors["rolling_shutter_20ms"]) < 1.3 * np.median(errors["room_loop"])


@pytest.mark.slow
def test_rough_extrinsics_come_back(tmp_path: Path) -> None:
    simulation, reader = run(tmp_path, "rough_extrinsics", 1, 28.0)
    last = reader.summaries[-1].calibration
    assert last is not None
    shift, turn = moved(last.T_b_c[0], simulation.true_calibration.cameras[0].T_b_c)
    assert np.degrees(np.linalg.norm(turn)) < 0.15
    assert np.linalg.norm(shift) < 0.01
    held = again(tmp_path, "held", "online.extrinsics=off")
    assert ate_m(simulation, reader) < 0.5 * ate_m(simulation, held)


@recorded
@pytest.mark.slow
def test_on_a_real_recording_calibration_stays_near_what_is_given(tmp_path: Path) -> None:
    """EuRoC's cameras are synchronised in hardware and calibrated with care."""
    folder, errors = DATA / "euroc_mh01_16s", []
    for name, settings in (("given", ()), ("found", ("online.td=on", "online.extrinsics=on"))):
        settings = ("loop.enabled=off", *settings)
        run_recording(folder, [folder / "vins_mono.yaml"], out=tmp_path / name, settings=settings)
        reader = RunReader(tmp_path / name)
        assert reader.truth is not None
        errors.append(evaluate(run_trajectory(reader.summaries), reader.truth, 0.006).ate_rmse_m)
    last = reader.summaries[-1].calibration
    assert last is not None and abs(last.td_s) < 3e-3
    shift, turn = moved(last.T_b_c[0], reader.header.calibration.cameras[0].T_b_c)
    assert np.linalg.norm(shift) < 0.03 and np.degrees(np.linalg.norm(turn)) < 1.5
    assert errors[1] < 1.2 * errors[0]
