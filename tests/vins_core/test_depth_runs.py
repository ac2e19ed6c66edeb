"""Runs with a depth camera from end to end: a simulated room, the record, replay, what-ifs, and what the modes say."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from depth_room import EMBEDDED, VARIANTS
from same import differences

from vins_core import params as parameters
from vins_core.errors import CalibrationError
from vins_core.evaluation.evaluate import evaluate, run_trajectory
from vins_core.frontend.depth import gates
from vins_core.io import modes
from vins_core.io.calibration import read_calibration
from vins_core.io.recording import open_recording
from vins_core.io.write import calibration_path
from vins_core.pipeline import step
from vins_core.record.fork import fork, recorded_images
from vins_core.record.reader import RunReader
from vins_core.report import DEPTH_USES, DepthUse, Status
from vins_core.whatif import recorded_tracks, resolve, without_map

USES = {use: i for i, use in enumerate(DEPTH_USES)}


@pytest.fixture(scope="module")
def runs(depth_runs: dict[str, Path]) -> dict[str, RunReader]:
    return {variant: RunReader(folder) for variant, folder in depth_runs.items()}


@pytest.mark.parametrize("variant", VARIANTS)
def test_it_follows_the_room_in_metres_from_the_first_full_window_on(runs: dict[str, RunReader], variant: str) -> None:
    run = runs[variant]
    assert run.header.mode == "rgbd_imu" and run.truth is not None
    first = next(s for s in run.summaries if s.pose is not None)
    assert first.frame <= run.header.params.window.size + 1
    assert all(s.status is Status.TRACKING for s in run.summaries[first.frame :])
    result = evaluate(run_trajectory(run.summaries), run.truth, 0.006)
    assert result.ate_rmse_m < 0.01 and abs(result.scale - 1) < 0.02


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_track_tells_why_it_has_no_depth(runs: dict[str, RunReader], variant: str) -> None:
    run = runs[variant]
    sensor = run.header.calibration.cameras[0].depth
    tracks = run.report(len(run) - 1).tracks
    assert len(tracks.depth_loss) == len(tracks.ids) and (tracks.depth_loss == 255).mean() > 0.5
    for row in range(len(tracks.ids)):
        passed = all(g.passed for g in gates(run.header.params.frontend, sensor, tracks, row))
        assert passed == (tracks.depth_loss[row] == 255)


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_report_says_how_depths_were_used(runs: dict[str, RunReader], variant: str) -> None:
    run = runs[variant]
    last = run.report(len(run) - 1)
    found, cost = last.depth, last.solve.after
    assert (cost.depth > 0) == (variant != "hold") and cost.total >= cost.depth
    used = USES[DepthUse.HELD if variant == "hold" else DepthUse.FACTOR]
    assert (found.use == used).sum() > 30
    assert np.nanmedian(np.abs(found.error_sigma[found.use == used])) < 1.5
    assert np.nanmedian(np.abs(found.seen_error_sigma)) < 1.5
    assert all(g.passed for g in found.gates)


@pytest.mark.parametrize("variant", ["confirm", "hold"])
def test_frames_repeat_from_any_state_to_the_bit(runs: dict[str, RunReader], variant: str) -> None:
    """With images of the recording, or with those that the record holds."""
    run = runs[variant]
    k = len(run) - 4
    state = run.state(k - 1)
    with recorded_images(run) as images:
        assert (images is run) == (variant == EMBEDDED)
        for frame in range(k, k + 2):
            state, report, _ = step(run.header.params, run.header.calibration, images, state, run.packet(frame))
            assert differences(report, run.report(frame)) + differences(state, run.state(frame)) == []


def test_embedded_depth_is_that_of_the_recording(runs: dict[str, RunReader], depth_recording: Path) -> None:
    run = runs[EMBEDDED]
    ref, sensor = run.packet(5).depth, run.header.calibration.cameras[0].depth
    with open_recording(depth_recording, run.header.calibration) as source:
        np.testing.assert_array_equal(run.load_depth(ref, sensor.scale_m), source.load_depth(ref, sensor.scale_m))


@pytest.mark.parametrize("rerun", [False, True])
def test_a_what_if_without_changes_is_the_frame(runs: dict[str, RunReader], rerun: bool) -> None:
    run = runs["trust"]
    k = len(run) - 2
    again = resolve(run, k, run.header.params, rerun_frontend=rerun)
    assert differences(again.after, without_map(run.report(k))) == [] and again.first_difference is None
    _, observations, _ = recorded_tracks(run, k, run.header.params)
    assert differences(observations, run.state(k).window.frames[-1].observations) == []


def test_a_fork_may_choose_another_variant_and_says_what_that_decides(
    runs: dict[str, RunReader], tmp_path: Path
) -> None:
    run = runs["trust"]
    k = len(run) - 4
    fork(run, k, tmp_path / "fork", {"depth.variant": "hold"}, frames=2)
    forked = RunReader(tmp_path / "fork").report(k).depth
    assert (forked.use == USES[DepthUse.HELD]).any() and not (forked.use == USES[DepthUse.FACTOR]).any()
    changed = parameters.replace(run.header.params, {"depth.variant": "hold"})
    difference = resolve(run, k, changed).first_difference
    assert difference.knob == "depth.variant" and difference.decision.startswith("depth")


def test_an_unused_depth_camera_is_noted_and_a_missing_one_told(depth_recording: Path) -> None:
    with open_recording(depth_recording) as source:
        calibration = read_calibration([calibration_path(depth_recording)], source).calibration
        assert modes.choose(source, calibration) == "rgbd_imu"
    mono, notes = modes.prepare(calibration, "mono_imu")
    assert mono.cameras[0].depth is None and any(n.startswith("depth of cam0: not used") for n in notes)
    with pytest.raises(CalibrationError, match="has no depth camera"):
        modes.prepare(mono, "rgbd_imu")


@pytest.mark.slow
def test_trusting_and_confirming_beat_one_camera_and_holding_comes_near(tmp_path: Path) -> None:
    """Median of five seeds over the five seconds after the first pose of mono and IMU."""
    benchmark = runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "depth.py"))
    found = np.array(list(benchmark["compare"](range(1, 6), tmp_path).values()))  # (variants, seeds, 3)
    ate_mm, scale = found[:, :, 0], found[:, :, 1]
    mono, trust, confirm, hold = np.median(ate_mm, 1)
    assert max(trust, confirm) < mono and hold < 1.2 * mono
    mono, trust, confirm, _ = np.median(np.abs(scale), 1)
    assert max(trust, confirm) < mono
