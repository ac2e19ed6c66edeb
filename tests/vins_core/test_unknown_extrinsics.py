"""Whole runs that are not told how the camera is mounted: the rotation is found, or the run says what is missing."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from same import differences

from vins_core.geometry import se3, so3
from vins_core.io.calibration import read_calibration
from vins_core.io.own_yaml import write
from vins_core.io.recording import open_recording
from vins_core.io.write import write_recording
from vins_core.pipeline import step
from vins_core.record.fork import recorded_images, state_before
from vins_core.record.reader import RunReader
from vins_core.report import Status
from vins_core.runner import run_recording
from vins_core.simulation.scenarios import SCENARIOS
from vins_core.simulation.simulate import build

DATA = Path(os.environ.get("VINS_DATA", ""))


def run(folder: Path, scenario: str, seed: int, duration_s: float, *, loops: bool = False, **changes) -> RunReader:
    changes = {"believed_extrinsics": "unknown", **changes}
    simulation = build(scenario, replace(SCENARIOS[scenario], **changes), seed, duration_s)
    write_recording(simulation.messages(), folder / "recording", "asl", settings=simulation.settings)
    calibration = simulation.calibration
    if len(calibration.cameras) > 1:  # how they are mounted to each other is known
        T_c0_c1 = (
            se3.inverse(simulation.true_calibration.cameras[0].T_b_c) @ simulation.true_calibration.cameras[1].T_b_c
        )
        cameras = (calibration.cameras[0], replace(calibration.cameras[1], T_b_c=T_c0_c1))
        calibration = replace(calibration, cameras=cameras)
    write(folder / "calibration.yaml", calibration, simulation.settings.overrides)
    settings = () if loops else ("loop.enabled=false",)
    run_recording(folder / "recording", [folder / "calibration.yaml"], out=folder / "run", settings=settings)
    return RunReader(folder / "run")


def error_deg(q_b_c: np.ndarray, R_b_c: np.ndarray) -> float:
    return float(np.rad2deg(np.linalg.norm(so3.log(so3.multiply(so3.inverse(so3.from_matrix(R_b_c)), q_b_c)))))


def accepted(run: RunReader) -> list[np.ndarray]:
    reports = [run.report(k).hand_eye for k in range(len(run))]
    return [r.q_b_c for r in reports if r is not None and r.accepted]


def repeats(run: RunReader, at: int, frames: int) -> list[str]:
    state, found = state_before(run, at), []
    with recorded_images(run) as images:
        for k in range(at, at + frames):
            state, report, _ = step(run.header.params, run.header.calibration, images, state, run.packet(k))
            found += differences(report, run.report(k)) + differences(state, run.state(k))
    return found


def test_attempts_are_recorded_and_repeat_to_the_last_bit(tmp_path: Path) -> None:
    found = run(tmp_path, "unknown_extrinsics", 1, 2.4)
    summaries = [found.summary(k).hand_eye for k in range(len(found))]
    assert [s.n_pairs for s in summaries if s] == sorted(s.n_pairs for s in summaries if s)
    last = found.report(len(found) - 1)
    assert last.initialization is not None and last.initialization.stages[0].name == "extrinsic rotation"
    assert "rotate the device about two axes" in last.initialization.stages[0].outcome
    assert all(found.summary(k).pose is None for k in range(len(found)))
    assert repeats(found, 15, 4) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 5))
def test_the_rotation_is_found_and_the_run_goes_on(tmp_path: Path, seed: int) -> None:
    found = run(tmp_path, "unknown_extrinsics", seed, 9.5)
    R = SCENARIOS["unknown_extrinsics"].rig.T_b_c[:3, :3]
    assert accepted(found) and max(error_deg(q, R) for q in accepted(found)) < 0.5
    first = next(k for k in range(len(found)) if found.summary(k).pose is not None)
    assert found.report(first).hand_eye.found and found.summary(len(found) - 1).status is Status.TRACKING
    assert found.state(first).hand_eye is None
    refined = found.report(len(found) - 1).calibration
    assert refined is not None
    assert error_deg(so3.from_matrix(refined.T_b_c[0][:3, :3]), R) < 0.3
    assert np.linalg.norm(refined.T_b_c[0][:3, 3] - SCENARIOS["unknown_extrinsics"].rig.T_b_c[:3, 3]) < 0.03
    assert repeats(found, first - 1, 3) == []


@pytest.mark.slow
def test_two_cameras_keep_their_place_beside_each_other(tmp_path: Path) -> None:
    found = run(tmp_path, "stereo", 1, 9.5)
    assert found.header.mode == "stereo_imu"
    rig = SCENARIOS["stereo"].rig
    assert accepted(found) and max(error_deg(q, rig.T_b_c[:3, :3]) for q in accepted(found)) < 0.5
    first = next(k for k in range(len(found)) if found.summary(k).pose is not None)
    T_b_c = found.state(first).window.T_b_c
    assert np.allclose(se3.inverse(T_b_c[0]) @ T_b_c[1], rig.T_c0_c1, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["standstill", "pure_rotation", "td_offset", "motion_blur", "low_texture"])
def test_no_scenario_gets_a_wrong_rotation_accepted(tmp_path: Path, scenario: str) -> None:
    found = run(tmp_path, scenario, 2, 9.0)
    R = SCENARIOS[scenario].rig.T_b_c[:3, :3]
    assert all(error_deg(q, R) < 1.0 for q in accepted(found))
    assert not (scenario == "standstill" and accepted(found))


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "euroc_mh01_16s").is_dir(), reason="VINS_DATA names no folder with euroc_mh01_16s")
@pytest.mark.parametrize("start_s", [0.0, 2.0, 4.0, 6.0, 8.0])
def test_a_real_flight_gets_its_rotation_or_is_refused(tmp_path: Path, start_s: float) -> None:
    """VINS-Mono accepts one there that is ten degrees off."""
    recording = DATA / "euroc_mh01_16s"
    text = (recording / "vins_mono.yaml").read_text()
    (tmp_path / "unknown.yaml").write_text(text.replace("estimate_extrinsic: 0", "estimate_extrinsic: 2"))
    with open_recording(recording) as source:
        R = read_calibration([tmp_path / "unknown.yaml"], source).calibration.cameras[0].T_b_c[:3, :3]
    run_recording(
        recording,
        [tmp_path / "unknown.yaml"],
        out=tmp_path / "run",
        settings=("loop.enabled=false",),
        start_s=start_s,
        duration_s=8.0,
    )
    found = RunReader(tmp_path / "run")
    assert found.header.calibration.extrinsics == "unknown"
    assert all(error_deg(q, R) < 2.0 for q in accepted(found))
    if not accepted(found):
        attempts = [found.report(k).initialization for k in range(len(found))]
        assert [a.stages[0].outcome for a in attempts if a is not None]
