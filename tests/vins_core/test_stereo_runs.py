"""Runs with two cameras from end to end: simulated rooms, the record, and replay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from same import differences

from vins_core.errors import CalibrationError
from vins_core.evaluation.evaluate import evaluate
from vins_core.io.modes import Mode
from vins_core.io.write import calibration_path, write_recording
from vins_core.pipeline import step
from vins_core.record.fork import recorded_images
from vins_core.record.reader import RunReader
from vins_core.report import Status
from vins_core.runner import run_recording
from vins_core.sensors import Trajectory
from vins_core.simulation.simulate import simulate

MODES: tuple[Mode, ...] = ("stereo_imu", "stereo")
DURATION_S = 3.0


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    simulation = simulate("stereo", duration_s=DURATION_S)
    out = tmp_path_factory.mktemp("recording") / "room.bag"
    return write_recording(simulation.messages(), out, "ros1", settings=simulation.settings)


@pytest.fixture(scope="module")
def runs(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunReader]:
    folder = tmp_path_factory.mktemp("runs")
    for mode in MODES:
        run_recording(recording, [calibration_path(recording)], out=folder / mode, mode=mode)
    return {mode: RunReader(folder / mode) for mode in MODES}


@pytest.mark.parametrize(("mode", "first_pose_s"), [("stereo_imu", 1.4), ("stereo", 0.3)])
def test_it_follows_the_room_in_metres(runs: dict[str, RunReader], mode: str, first_pose_s: float) -> None:
    run = runs[mode]
    assert run.header.mode == mode and run.truth is not None
    posed = [s for s in run.summaries if s.pose is not None]
    first_ns = run.report(0).images[0].t_ns
    assert (posed[0].t_ns - first_ns) * 1e-9 <= first_pose_s
    assert all(s.status is Status.TRACKING for s in run.summaries if s.t_ns >= posed[0].t_ns)
    estimate = Trajectory(
        np.array([s.t_ns for s in posed]),
        np.array([s.pose.p_w_b for s in posed]),
        np.array([s.pose.q_w_b for s in posed]),
    )
    result = evaluate(estimate, run.truth, max_dt_s=0.006, first_image_ns=first_ns)
    assert result.ate_rmse_m < 0.02
    assert abs(result.scale - 1) < 0.02


@pytest.mark.parametrize("mode", MODES)
def test_every_frame_says_what_the_second_camera_saw(runs: dict[str, RunReader], mode: str) -> None:
    run = runs[mode]
    for k in (0, len(run) - 1):
        report = run.report(k)
        tracks = report.tracks
        assert len(tracks.right_loss) == len(tracks.right_uv_px) == len(tracks.ids)
        assert np.isfinite(tracks.right_uv_px[tracks.right_loss == 255]).all()
        left, right = report.image, report.second_image
        assert right is not None and (left.camera, right.camera) == (0, 1) and left.t_ns == right.t_ns == report.t_ns
        assert (tracks.right_loss == 255).mean() > 0.4
    solve = run.report(len(run) - 1).solve
    assert solve is not None and set(solve.visual_camera) == {0, 1}
    assert (len(solve.imu_sigma) > 0 and np.isfinite(solve.imu_sigma).any()) == (mode == "stereo_imu")


def test_loops_are_looked_for_with_imu_and_not_without(runs: dict[str, RunReader]) -> None:
    """Without gravity nothing tells a turn about it from any other."""
    described = {mode: [k for k in range(len(run)) if run.report(k).closure] for mode, run in runs.items()}
    assert len(described["stereo_imu"]) > 2 and not described["stereo"]
    motions = [w.motion for k in range(len(runs["stereo_imu"])) if (w := runs["stereo_imu"].report(k).window)]
    assert any(m is not None and np.isfinite(m).all() for m in motions)
    assert any(note.startswith("loops: not closed") for note in runs["stereo"].header.notes)


@pytest.mark.parametrize("mode", MODES)
def test_frames_repeat_from_any_state_to_the_bit(runs: dict[str, RunReader], recording: Path, mode: str) -> None:
    run = runs[mode]
    middle = len(run) // 2
    state = run.state(middle - 1)
    with recorded_images(run) as images:
        for k in range(middle, middle + 3):
            state, report, _ = step(run.header.params, run.header.calibration, images, state, run.packet(k), run.places)
            assert differences(report, run.report(k)) + differences(state, run.state(k)) == []


def test_the_default_is_all_that_is_there(recording: Path, tmp_path: Path) -> None:
    calibration = [calibration_path(recording)]
    run_recording(recording, calibration, out=tmp_path / "all", duration_s=0.3, settings=["loop.enabled=0"])
    header = RunReader(tmp_path / "all").header
    assert header.mode == "stereo_imu" and len(header.calibration.cameras) == 2
    result = run_recording(
        recording, calibration, out=tmp_path / "mono", duration_s=0.3, mode="mono_imu", settings=["loop.enabled=0"]
    )
    assert len(RunReader(tmp_path / "mono").header.calibration.cameras) == 1
    assert any(note.startswith("cam1: not used, mode mono_imu") for note in result.notes)


def test_a_mode_that_is_not_possible_is_refused_with_what_it_lacks(tmp_path: Path) -> None:
    simulation = simulate("room_loop", duration_s=0.5)
    mono = write_recording(simulation.messages(), tmp_path / "mono.bag", "ros1", settings=simulation.settings)
    with pytest.raises(CalibrationError, match=r"mode stereo needs images of a second camera; possible is mono_imu"):
        run_recording(mono, [calibration_path(mono)], out=tmp_path / "run", mode="stereo")
    assert not (tmp_path / "run").exists()
