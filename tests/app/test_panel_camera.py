"""The camera panel shows every track once, by age, and every loss by reason."""

import dataclasses
import re

import numpy as np
from fake_reports import context, parse

from app import views
from app.palette import BAD, SELECTION, age_colour
from app.panels import camera
from app.widgets.marks import LOSS_MARKS
from vins_core.report import LOSS_REASONS, LandmarkStatus, LossReason

FRAME = 30


def page(frame=FRAME, **changes):
    return parse(camera.render(context(frame, **changes)))


def tracks_on(markup):
    return {int(e.attributes["data-track"]): e for e in markup.all() if "data-track" in e.attributes}


def test_every_track_is_drawn_once_where_it_is():
    tracks, marks = context(FRAME).report.tracks, tracks_on(page())
    assert sorted(marks) == sorted(tracks.ids.tolist())
    for id, uv in zip(tracks.ids.tolist(), tracks.uv_px):
        if marks[id].name == "circle":
            at = [float(marks[id].attributes[k]) for k in ("cx", "cy")]
            np.testing.assert_allclose(at, uv, atol=0.051)


def test_colour_is_age():
    report = context(FRAME).report
    marks = tracks_on(page())
    state = views.statuses(report)
    for id, age in zip(report.tracks.ids.tolist(), report.tracks.age.tolist()):
        if state.get(id) is not LandmarkStatus.OUTLIER:
            assert marks[id].attributes["stroke"] == age_colour(age)


def test_outliers_differ_in_shape():
    stars = set()
    for frame in range(20, 45):
        state, marks = views.statuses(context(frame).report), tracks_on(page(frame))
        outliers = {i for i in marks if state.get(i) is LandmarkStatus.OUTLIER}
        assert all(marks[i].name == "path" and marks[i].attributes["fill"] == BAD for i in outliers)
        assert all(marks[i].name == "circle" for i in marks.keys() - outliers)
        stars |= outliers
    assert stars


def test_a_click_selects_the_track():
    for id, mark in tracks_on(page()).items():
        assert mark.attributes["onclick"] == f"vi.send({{k:'pick',t:'track',i:{id}}})"


def test_the_selected_track_is_yellow_and_on_top():
    id = int(context(FRAME).report.tracks.ids[4])
    markup = page(track=id)
    marks = tracks_on(markup)
    assert marks[id].attributes["class"] == "p"
    assert list(marks)[-1] == id
    trails = [e for e in markup.all("polyline") if e.attributes["stroke"] == SELECTION]
    assert len(trails) == 1


def test_trails_have_a_point_for_every_frame_the_track_was_in():
    ctx = context(FRAME)
    lengths = sorted(len(e.attributes["points"].split()) for e in page().all("polyline"))
    seen = np.isfinite(views.trails(ctx.run, ctx.report)[:, :, 0]).sum(1)
    assert lengths == sorted(n for n in seen.tolist() if n > 1)


def test_titles_say_id_age_and_status():
    report = context(FRAME).report
    id, age = int(report.tracks.ids[0]), int(report.tracks.age[0])
    assert tracks_on(page())[id].text == f"track {id} · age {age} · {views.statuses(report)[id]}"
    early = context(3).report.tracks
    assert tracks_on(page(3))[int(early.ids[0])].text == f"track {early.ids[0]} · age {early.age[0]}"


def test_losses_are_crosses_by_reason_and_counted():
    frame = next(k for k in range(20, 40) if len(context(k).report.tracks.lost_ids) > 2)
    tracks, markup = context(frame).report.tracks, page(frame)
    crosses = [e for e in markup.all("g") if "data-lost" in e.attributes]
    assert [int(e.attributes["data-lost"]) for e in crosses] == tracks.lost_ids.tolist()
    for cross, index in zip(crosses, tracks.lost_reason.tolist()):
        colour, shape = LOSS_MARKS[LOSS_REASONS[index]]
        assert cross.children[1].attributes == {"d": shape, "stroke": colour}
        assert str(LOSS_REASONS[index]) in cross.text
    for reason, n in views.lost_counts(tracks):
        assert markup.one("span", data_loss=str(reason)).text.split() == [*str(reason).split(), str(n)]


def test_no_two_reasons_share_a_mark():
    assert set(LOSS_MARKS) == set(LossReason)
    assert len(set(LOSS_MARKS.values())) == len(LossReason)


def test_the_picture_has_the_size_of_the_camera():
    markup = page(width=1920, height=1200)
    assert markup.one(cls="vi-img").attributes["style"] == "aspect-ratio:1920/1200"
    svg = markup.all("svg")[0]
    assert svg.attributes["viewbox"] == "0 0 1920 1200"
    marks = float(re.search(r"--u:([\d.]+)", svg.attributes["style"])[1])
    assert marks > 3  # in pixels of the image, so that marks stay visible in a large one


def test_zoom_and_pan_are_left_to_the_page():
    image = page().one(cls="vi-img").attributes
    assert (image["onwheel"], image["onpointermove"], image["ondblclick"]) == (
        "vi.wheel(event,this)",
        "vi.pan(event)",
        "vi.reset()",
    )


def test_a_missing_image_is_a_sentence_and_tracks_stay():
    markup = page(image_uri="", image_note="The recording /data/x.bag is gone.")
    assert "The recording /data/x.bag is gone." in markup.text
    assert not markup.all("img")
    assert tracks_on(markup)


def test_no_track_is_a_sentence():
    report = context(5).report
    none = dataclasses.replace(
        report.tracks,
        ids=np.zeros(0, np.int64),
        uv_px=np.zeros((0, 2), np.float32),
        age=np.zeros(0, np.int32),
        velocity=np.zeros((0, 2), np.float32),
    )
    assert "No track is alive" in page(5, report=dataclasses.replace(report, tracks=none)).text


def test_depth_is_explained_only_once_there_are_landmarks():
    assert "has a depth" in page().text
    assert "has a depth" not in page(3).text
