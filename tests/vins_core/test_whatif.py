from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
from same import differences
from sample import INITIALISED

from vins_core import params as parameters
from vins_core.errors import RecordingError, RunError
from vins_core.params import Params
from vins_core.record.folder import HEADER
from vins_core.record.fork import fork, recorded_images
from vins_core.record.header import to_json
from vins_core.record.reader import RunReader
from vins_core.report import Status
from vins_core.whatif import WhatIf, effect, needs_frontend, recorded_tracks, resolve, without_map


@pytest.fixture(scope="module")
def run(sample_run: Path) -> RunReader:
    return RunReader(sample_run)


def with_changes(run: RunReader, **changes: object) -> Params:
    return parameters.replace(run.header.params, {k.replace("__", "."): v for k, v in changes.items()})


@pytest.mark.parametrize("rerun", [False, True], ids=["recorded tracks", "front end again"])
@pytest.mark.parametrize("k", [0, 1, 8, INITIALISED, INITIALISED + 1, 20, 35])
def test_a_frame_repeated_as_it_was_is_the_recorded_one(run: RunReader, k: int, rerun: bool) -> None:
    again = resolve(run, k, run.header.params, rerun_frontend=rerun)
    assert differences(again.before, without_map(run.report(k))) == []
    assert differences(again.after, again.before) == []
    assert again.first_difference is None and again.reran_frontend == rerun


def test_the_recorded_tracks_are_those_the_estimator_got(run: RunReader) -> None:
    for k in (3, 20):
        _, observations, _ = recorded_tracks(run, k, run.header.params)
        newest = run.state(k).window.frames[-1]
        assert newest.frame == k and differences(observations, newest.observations) == []


@pytest.mark.parametrize("rerun", [False, True])
def test_a_what_if_is_the_first_frame_of_the_fork(run: RunReader, tmp_path: Path, rerun: bool) -> None:
    changes = {"window.pixel_sigma": 2.5} | ({"frontend.F_threshold": 0.3} if rerun else {})
    fork(run, 22, tmp_path / "fork", changes, frames=1)
    again = resolve(run, 22, parameters.replace(run.header.params, changes), rerun_frontend=rerun)
    assert differences(again.after, without_map(RunReader(tmp_path / "fork").report(22))) == []


def test_only_the_front_end_shows_what_its_parameters_do(run: RunReader) -> None:
    params = with_changes(run, frontend__F_threshold=0.2)
    assert needs_frontend({"frontend.F_threshold": 0.2}) and not needs_frontend({"window.pixel_sigma": 2.0})
    assert resolve(run, 22, params).first_difference is None
    found = resolve(run, 22, params, rerun_frontend=True).first_difference
    assert found is not None and found.decision == "tracks lost: F-RANSAC"


def test_the_age_a_track_needs_is_applied_to_recorded_tracks(run: RunReader) -> None:
    assert not needs_frontend({"frontend.min_track_count": 10})
    changed = resolve(run, 22, with_changes(run, frontend__min_track_count=10))
    again = resolve(run, 22, with_changes(run, frontend__min_track_count=10), rerun_frontend=True)
    assert differences(changed.after, again.after) == []
    assert changed.after.solve is not None and changed.before.solve is not None
    assert len(changed.after.solve.visual_ids) < len(changed.before.solve.visual_ids)


def test_the_window_may_have_another_size(run: RunReader) -> None:
    for size in (6, 12):
        after = resolve(run, 22, with_changes(run, window__size=size)).after
        assert after.window is not None and len(after.window.frames) == min(size, 10) + 1


def test_images_may_be_lent_or_are_opened(run: RunReader) -> None:
    params = with_changes(run, frontend__max_cnt=60)
    with recorded_images(run) as images:
        lent = resolve(run, 22, params, images, rerun_frontend=True)
    assert differences(lent.after, resolve(run, 22, params, rerun_frontend=True).after) == []


def test_recorded_tracks_need_no_images_and_the_front_end_says_that_they_are_gone(
    run: RunReader, tmp_path: Path
) -> None:
    shutil.copytree(run.path, tmp_path / "run")
    header = dataclasses.replace(run.header, recording="/gone.bag")
    (tmp_path / "run" / HEADER).write_bytes(to_json(header))
    moved = RunReader(tmp_path / "run")
    assert resolve(moved, 22, header.params).after.solve is not None
    with pytest.raises(RecordingError, match=r"/gone\.bag"):
        resolve(moved, 22, header.params, rerun_frontend=True)


@pytest.mark.parametrize("k", [-1, 36])
def test_a_frame_that_is_not_there_is_named(run: RunReader, k: int) -> None:
    with pytest.raises(RunError, match="has no frame"):
        resolve(run, k, run.header.params)


def test_a_window_that_would_have_failed_is_shown_as_failed(run: RunReader) -> None:
    again = resolve(run, 22, with_changes(run, health__max_acc_bias=0.1))
    assert again.after.status is Status.FAILED and again.after.pose is None
    found = again.first_difference
    assert found is not None and (found.stage, found.knob) == ("health", "health.max_acc_bias")


# -- the summary -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tighter(run: RunReader) -> WhatIf:
    return resolve(run, 22, with_changes(run, window__pixel_sigma=0.5, window__max_error_px=1.0))


def test_nothing_changed_has_no_effect(run: RunReader) -> None:
    report = run.report(22)
    found = effect(report, report)
    assert found is not None and report.solve is not None and report.window is not None
    assert found.frames.tolist() == report.window.frames.tolist()
    for difference in (found.p_m, found.v_m_s, found.b_a, found.b_g):
        assert not difference.any()
    assert found.rotation_deg.max() < 1e-12
    assert found.cost[0] == found.cost[1] == report.solve.after
    assert len(found.landmarks.only_before) == len(found.landmarks.only_after) == 0
    assert len(found.residuals.ids) == len(report.solve.visual_ids)


def test_an_effect_is_after_minus_before_matched_by_frame_landmark_and_observation(tighter: WhatIf) -> None:
    a, b = tighter.before, tighter.after
    found = effect(a, b)
    assert found is not None and a.window and b.window and a.landmarks and b.landmarks and a.solve and b.solve
    np.testing.assert_array_equal(found.p_m, b.window.p_w_b - a.window.p_w_b)
    np.testing.assert_array_equal(found.b_g, b.window.b_g - a.window.b_g)
    assert found.p_m.any() and found.rotation_deg.max() < 1.0
    id = int(found.landmarks.ids[7])
    for side, report in enumerate((a.landmarks, b.landmarks)):
        row = int(np.flatnonzero(report.ids == id)[0])
        np.testing.assert_array_equal(found.landmarks.inv_depth[side, 7], report.inv_depth[row])
        assert found.landmarks.status[side, 7] == report.status[row]
    for n in (0, 11, len(found.residuals.ids) - 1):
        for side, solve in enumerate((a.solve, b.solve)):
            mine = (solve.visual_ids == found.residuals.ids[n]) & (solve.visual_slots[:, 1] == found.residuals.slots[n])
            assert solve.visual_error_px[mine].tolist() == [found.residuals.error_px[side, n]]
    assert found.residuals.imu_sigma is not None and found.residuals.imu_sigma.shape == (2, 10, 5)
    assert found.cost == (a.solve.after, b.solve.after)


def test_windows_of_different_length_are_matched_where_they_overlap(run: RunReader) -> None:
    again = resolve(run, 22, with_changes(run, window__size=6))
    found = effect(again.before, again.after)
    assert found is not None and again.after.window is not None
    assert found.frames.tolist() == again.after.window.frames.tolist()
    assert found.residuals.imu_sigma is None and len(found.landmarks.only_before) > 0


def test_a_frame_that_was_not_solved_has_no_effect(run: RunReader) -> None:
    assert effect(run.report(5), run.report(5)) is None
