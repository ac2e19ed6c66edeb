"""What two cameras see of the same tracks: the picture's arrays, and the panel's marks and counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fake_reports import Markup, context, parse, shared_view
from stereo_run import stereo_run

from app.context import PanelContext, RunView, Selection
from app.panels import inspect, stereo
from app.scene.frame import SceneFrame
from app.stereo import MATCHED, StereoPicture, stereo_picture
from vins_core.record.reader import RunReader
from vins_core.report import RIGHT_LOSSES, FrameReport, RightLoss


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunView:
    return RunView(RunReader(stereo_run(tmp_path_factory.mktemp("stereo"))))


@pytest.fixture
def report(run: RunView) -> FrameReport:
    return run.report(len(run) - 1)


def picture_of(run: RunView, report: FrameReport) -> StereoPicture:
    picture = stereo_picture(report, run.header.calibration.cameras)
    assert picture is not None
    return picture


def page(run: RunView, report: FrameReport, **changes: object) -> Markup:
    return parse(stereo.render(context_of(run, report, **changes)))


def context_of(run: RunView, report: FrameReport, **changes: object) -> PanelContext:
    model = run.header.calibration.cameras[0].model
    plain = {
        "run": run,
        "frame": report.frame,
        "report": report,
        "ms": {},
        "selection": Selection(),
        "image_uri": "data:image/jpeg;base64,LEFT",
        "image_note": "",
        "second_uri": "data:image/jpeg;base64,RIGHT",
        "width": model.width,
        "height": model.height,
    }
    return PanelContext(**{**plain, **changes})


def groups(markup: Markup) -> dict[int, object]:
    return {int(e.attributes["data-pair"]): e for e in markup.all() if "data-pair" in e.attributes}


def test_a_match_lies_on_its_epipolar_line_and_on_its_landmark(run: RunView, report: FrameReport) -> None:
    picture = picture_of(run, report)
    matched = picture.matched
    assert matched.sum() > 30
    assert (picture.epipolar_px[matched] <= run.header.params.frontend.stereo_epipolar_px).all()
    np.testing.assert_allclose(np.abs(picture.offset_px[matched]), picture.epipolar_px[matched])
    known = matched & np.isfinite(picture.landmark_px).all(1)
    assert known.sum() > 20
    assert np.median(np.linalg.norm(picture.landmark_px[known] - picture.right_px[known], axis=1)) < 1.0
    for line, uv in zip(picture.lines_px[known], picture.right_px[known]):
        ends = line[np.isfinite(line[:, 0])][[0, -1]]  # straight, without distortion and nearly so with it
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        across = (uv - ends[0]) @ [-along[1], along[0]]
        assert abs(across) < 4.0


def test_where_the_extrinsics_are_wrong_matches_lie_to_one_side(run: RunView, report: FrameReport) -> None:
    left, right = run.header.calibration.cameras
    tilt = np.eye(4)
    tilt[1:3, 1:3] = [[np.cos(0.01), -np.sin(0.01)], [np.sin(0.01), np.cos(0.01)]]
    wrong = stereo_picture(report, (left, replace(right, T_b_c=right.T_b_c @ tilt)))
    assert wrong is not None
    right_one, tilted = (np.median(p.offset_px[p.matched]) for p in (picture_of(run, report), wrong))
    assert abs(right_one) < 0.3 and abs(tilted) == pytest.approx(4.6, rel=0.1)


def test_one_camera_has_no_picture_and_no_panel(run: RunView) -> None:
    assert not stereo.exists(shared_view()) and stereo.exists(run)
    ctx = context(30)
    assert stereo_picture(ctx.report, ctx.run.header.calibration.cameras) is None


def test_every_track_is_drawn_once_and_a_match_in_both_images(run: RunView, report: FrameReport) -> None:
    picture, drawn = picture_of(run, report), groups(page(run, report))
    assert sorted(drawn) == sorted(report.tracks.ids.tolist())
    for id, loss in zip(picture.ids.tolist(), picture.loss.tolist()):
        lines = [e for e in drawn[id].walk() if e.attributes.get("class") == "l"]
        dots = [e for e in drawn[id].walk() if e.name == "circle" and e.attributes.get("class") != "r"]
        assert (len(lines), len(dots)) == ((1, 2) if loss == MATCHED else (len(lines), 0))


def test_steps_lose_what_each_test_refuses(run: RunView, report: FrameReport) -> None:
    loss = report.tracks.right_loss.copy()
    loss[:9] = [RIGHT_LOSSES.index(r) for r in (RightLoss.FLOW, RightLoss.FLOW_BACK, RightLoss.EPIPOLAR) for _ in "abc"]
    changed = replace(report, tracks=replace(report.tracks, right_loss=loss))
    markup, picture = page(run, changed), picture_of(run, changed)
    left = {
        e.attributes["data-step"]: int(e.attributes["data-left"]) for e in markup.all() if "data-step" in e.attributes
    }
    before = len(loss)
    for _, reason, _, _ in stereo.STEPS:
        assert left[reason] == before - picture.count(reason)
        before = left[reason]
    assert before == picture.matched.sum()
    told = {e.attributes["data-right"] for e in markup.all() if "data-right" in e.attributes}
    assert told == {reason for reason in RIGHT_LOSSES if picture.count(reason)}


def test_the_selected_track_comes_last_and_has_its_gate(run: RunView, report: FrameReport) -> None:
    id = int(report.tracks.ids[np.flatnonzero(report.tracks.right_loss == MATCHED)[0]])
    markup = page(run, report, selection=Selection("track", id))
    drawn = [e for e in markup.all() if "data-pair" in e.attributes]
    assert int(drawn[-1].attributes["data-pair"]) == id and "vi-picked" in drawn[-1].attributes["class"]
    gates = [e.attributes["data-gate"] for e in markup.all() if "data-gate" in e.attributes]
    assert gates == ["stereo matches", "epipolar distance"]


def test_inspect_says_where_the_second_camera_sees_the_selected_track_or_why_not(
    run: RunView, report: FrameReport
) -> None:
    loss = report.tracks.right_loss.copy()
    loss[0] = RIGHT_LOSSES.index(RightLoss.FLOW_BACK)
    changed, matched = replace(report, tracks=replace(report.tracks, right_loss=loss)), np.flatnonzero(loss == MATCHED)
    for row, expected in ((0, "flow-back"), (matched[0], f"{report.tracks.right_uv_px[matched[0]][0]:.1f}")):
        id = int(report.tracks.ids[row])
        assert expected in str(inspect.render(context_of(run, changed, selection=Selection("track", id))))


def test_a_missing_right_image_is_told(run: RunView, report: FrameReport) -> None:
    tracks = report.tracks
    nothing = np.full_like(tracks.right_loss, RIGHT_LOSSES.index(RightLoss.NO_IMAGE))
    without = replace(tracks, right_loss=nothing, right_uv_px=np.full_like(tracks.right_uv_px, np.nan))
    changed = replace(report, tracks=without, images=report.images[:-1])
    assert changed.second_image is None and changed.image == report.image
    markup = page(run, changed, second_uri="", second_note="The second camera took no image with this one.")
    assert any("took no image" in e.text for e in markup.all())
    assert not any("data-step" in e.attributes for e in markup.all())


def test_the_3d_view_has_the_second_camera_a_baseline_away(run: RunView, report: FrameReport) -> None:
    frame = SceneFrame(run, report.frame, report, Selection(), None, np.zeros((0, 3)), 1.0)
    second, (left, right) = frame.second_camera_pose(), run.header.calibration.cameras
    assert second is not None
    apart = np.linalg.norm(second[:3, 3] - frame.camera_poses()[-1, :3, 3])
    assert apart == pytest.approx(np.linalg.norm(left.T_b_c[:3, 3] - right.T_b_c[:3, 3]))
