"""GPS fusion in runs: from a rendered drive to the record, forks and the final trajectory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from same import differences
from street import SETTINGS, on_earth, short_drive, verdicts

from vins_core import params
from vins_core.errors import RunError
from vins_core.fusion.conclusion import final_track, global_trajectory, smooth_run
from vins_core.io.write import calibration_path
from vins_core.pipeline import step
from vins_core.record.compare import compare
from vins_core.record.fork import fork, recorded_images
from vins_core.record.reader import RunReader
from vins_core.record.reevaluate import GateHistory
from vins_core.report import FixVerdict, GpsStatus, Status
from vins_core.runner import run_recording
from vins_core.simulation.simulate import Simulation
from vins_core.whatif import resolve


@pytest.fixture(scope="module")
def drive() -> Simulation:
    return short_drive()


@pytest.fixture(scope="module")
def run(street_run: Path) -> RunReader:
    return RunReader(street_run)


@pytest.fixture(scope="module")
def without(street_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> RunReader:
    """The calibration does not say where the antenna is."""
    folder = tmp_path_factory.mktemp("runs")
    calibration = folder / "calibration.yaml"
    lines = calibration_path(street_recording).read_text().splitlines()
    calibration.write_text("\n".join(line for line in lines if "p_b_gps" not in line))
    run_recording(street_recording, [calibration], out=folder / "run", settings=SETTINGS)
    return RunReader(folder / "run")


def test_poses_are_where_the_body_is_on_the_earth(run: RunReader) -> None:
    final, live = final_track(run), global_trajectory(run, live=True)
    assert run.truth is not None and final.origin is not None
    assert len(final.t_ns) == sum(s.pose is not None for s in run.summaries)
    error = final.T_e_b[:, :3] - on_earth(run.truth, final.t_ns, final.origin)
    assert np.linalg.norm(error, axis=1).max() < 0.15
    assert len(live) > 12
    error = live.p_w_b - on_earth(run.truth, live.t_ns, final.origin)
    assert np.linalg.norm(error, axis=1).max() < 0.25


def test_every_fix_is_judged_once_and_outliers_do_not_count(run: RunReader, drive: Simulation) -> None:
    reports = [report for k in range(len(run)) if (report := run.report(k).gps)]
    judged = [fix for report in reports for fix in report.fixes]
    arrived = [fix.t_ns for report in reports for fix in report.arrived]
    assert [fix.t_ns for fix in judged] == arrived and len(arrived) > 20
    assert all(fix.gates for fix in judged)
    outliers = {fix.t_ns for fix, outlier in zip(drive.fixes, drive.outlier) if outlier} & set(arrived)
    kept = {t for t, verdict in verdicts(run).items() if verdict is FixVerdict.USED}
    assert len(outliers) > 1 and not outliers & kept
    assert len(kept) > 0.9 * (len(arrived) - len(outliers)) - 1


def test_verdicts_that_change_later_are_told_when_they_do(run: RunReader) -> None:
    reports = [report for k in range(len(run)) if (report := run.report(k).gps)]
    assert {report.status for report in reports} >= {GpsStatus.ALIGNING, GpsStatus.FUSING}
    first = next(report for report in reports if report.status is GpsStatus.FUSING)
    assert first.revised and first.T_e_b is not None and first.yaw_sigma_deg is not None
    for k, report in enumerate(reports):
        told = {t for t, _ in ((r.t_ns, r.verdict) for r in report.revised)}
        assert not told & {fix.t_ns for fix in report.fixes}, k


def test_an_outage_is_told_and_its_length_grows(run: RunReader) -> None:
    silent = [s.gps.outage_s for s in run.summaries if s.gps and s.gps.status is GpsStatus.FUSING]
    assert max(o for o in silent if o is not None) > 0.4


def test_frames_repeat_from_any_state_to_the_bit(run: RunReader) -> None:
    middle = next(s.frame for s in run.summaries if s.gps and s.gps.T_e_b is not None) - 1
    state = run.state(middle - 1)
    assert state.gps is not None and state.gps.nodes
    with recorded_images(run) as images:
        for k in range(middle, middle + 3):
            state, report, _ = step(run.header.params, run.header.calibration, images, state, run.packet(k))
            assert report.gps is not None
            assert differences(report, run.report(k)) + differences(state, run.state(k)) == []


def test_the_final_trajectory_is_kept_as_the_frames_give_it(run: RunReader) -> None:
    assert run.final_track is not None
    assert differences(run.final_track, smooth_run(run.header, run.summaries)) == []


def test_a_reader_that_watched_the_run_grow_gets_the_final_trajectory(run: RunReader, tmp_path: Path) -> None:
    watched: list[RunReader] = []

    def look() -> bool:
        watched.append(watched[0] if watched else RunReader(tmp_path / "fork"))
        assert watched[0].final_track is None
        return False

    fork(run, len(run) - 4, tmp_path / "fork", {}, cancelled=look)
    watched[0].refresh()
    assert watched[0].complete and watched[0].final_track is not None
    assert differences(watched[0].final_track, run.final_track) == []


def test_fixes_leave_the_odometry_alone_and_a_missing_antenna_is_a_note(run: RunReader, without: RunReader) -> None:
    notes = [note for note in without.header.notes if note.startswith("GPS")]
    assert len(notes) == 1 and "does not say where the antenna is" in notes[0] and "gps.lever_arm=off" in notes[0]
    assert all(without.report(k).gps is None for k in range(len(without)))
    for a, b in zip(run.summaries, without.summaries, strict=True):
        assert differences(a.pose, b.pose) == []
    with pytest.raises(RunError, match="does not say where the antenna is"):
        final_track(without)


def test_a_fork_may_say_where_the_antenna_is(without: RunReader, tmp_path: Path) -> None:
    at = len(without) - 8
    fork(without, at, tmp_path / "fork", {"gps.lever_arm": False})
    forked = RunReader(tmp_path / "fork")
    assert [s.gps is not None for s in forked.summaries] == [k >= at for k in range(len(forked))]
    assert any(forked.report(k).gps.fixes for k in range(at, len(forked)))


def test_a_fork_with_other_limits_differs_at_a_gate_of_a_fix(run: RunReader, tmp_path: Path) -> None:
    used = next(s.frame for s in run.summaries if s.gps and any(f.verdict is FixVerdict.USED for f in s.gps.fixes))
    fork(run, used, tmp_path / "fork", {"gps.min_sigma_m": 0.1}, frames=4)
    forked = RunReader(tmp_path / "fork")
    found = compare(run, forked).first_difference
    assert found is not None and (found.stage, found.knob, found.frame) == ("gps", "gps.min_sigma_m", used)
    assert forked.final_track is not None


def test_switched_off_nothing_is_fused(run: RunReader, tmp_path: Path) -> None:
    at = len(run) - 3
    fork(run, at, tmp_path / "fork", {"gps.enabled": False})
    forked = RunReader(tmp_path / "fork")
    assert all(forked.report(k).gps is None for k in range(at, len(forked)))
    assert len(final_track(forked).t_ns) == len(final_track(run).t_ns) - 3


def test_a_frame_again_judges_its_fixes_again(run: RunReader) -> None:
    used = [s.frame for s in run.summaries if s.gps and any(f.verdict is FixVerdict.USED for f in s.gps.fixes)][-1]
    same = resolve(run, used, run.header.params)
    assert differences(same.after, same.before) == [] and same.after.gps is not None
    stricter = params.replace(run.header.params, {"gps.min_sigma_m": 0.1})
    found = resolve(run, used, stricter).first_difference
    assert found is not None and (found.stage, found.knob) == ("gps", "gps.min_sigma_m")


def test_a_restart_of_the_odometry_keeps_nothing_but_the_earth(run: RunReader, tmp_path: Path) -> None:
    at = len(run) - 3
    fork(run, at, tmp_path / "fork", {"health.max_jump_m": 0.1}, frames=1)
    failed = RunReader(tmp_path / "fork")
    assert failed.report(at).status is Status.FAILED and failed.report(at).gps is None
    before, after = run.state(at - 1).gps, failed.state(at).gps
    assert before is not None and after is not None and before.nodes
    assert after.origin == before.origin
    assert (after.nodes, after.recent, after.prior, after.aligned) == ((), (), None, False)


def test_gates_of_fixes_are_judged_again_at_once(run: RunReader) -> None:
    history = GateHistory()
    history.follow(run)
    found = history.reevaluate({"gps.min_sigma_m": 0.2})
    flips = next(f for f in found.gates if f.key.knob == "gps.min_sigma_m")
    assert flips.passed_before == flips.evaluated and flips.passed_after == 0
    assert any(d.name == "GPS fix passes" and d.after == 0 for d in found.derived)


def test_between_two_stretches_of_odometry_nothing_is_carried_over(run: RunReader) -> None:
    """Each is smoothed by itself, in one frame of the earth."""
    rows = run.summaries
    cut = len(rows) - 16
    broken = [replace(s, pose=None) if s.frame == cut else s for s in rows]
    whole, parts = smooth_run(run.header, rows), smooth_run(run.header, broken)
    assert len(parts.t_ns) in (cut - np.flatnonzero([s.pose is not None for s in rows])[0], len(whole.t_ns) - 1)
    assert len(set(parts.stretch.tolist())) + len(parts.notes) == 2
    np.testing.assert_array_equal(parts.origin, whole.origin)
    jumped = [  # the second stretch begins elsewhere
        replace(s, pose=replace(s.pose, p_w_b=s.pose.p_w_b + 7.0)) if s.frame > cut and s.pose else s for s in broken
    ]
    again = smooth_run(run.header, jumped)
    np.testing.assert_allclose(again.T_e_b[:, :2], parts.T_e_b[:, :2], atol=1e-6)
