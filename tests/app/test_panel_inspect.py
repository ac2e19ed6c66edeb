"""Inspect: the selection, the cost, the window, the solver, the prior."""

import dataclasses
import re

import numpy as np
import pytest
from fake_reports import FIRST_SOLVE, context, parse

from app import views
from app.context import Selection
from app.html import number
from app.panels import inspect
from vins_core.report import IterationReport, LandmarkStatus

FRAME = 30


def page(frame=FRAME, **changes):
    return parse(inspect.render(context(frame, **changes)))


def landmark_of(status):
    report = context(FRAME).report
    alive = set(report.tracks.ids.tolist())
    return next(i for i, s in views.statuses(report).items() if s is status and i in alive)


def test_nothing_selected_says_what_to_do():
    assert "click a track" in page().text


def test_a_selected_track_shows_its_observations():
    report = context(FRAME).report
    id = landmark_of(LandmarkStatus.TRIANGULATED)
    markup = page(track=id)
    seen = views.observations(report, id)
    bars = [e for e in markup.one(cls="vi-obs").children if e.name == "i"]
    assert len(bars) == len(seen)
    for bar, o in zip(bars, seen):
        assert bar.attributes["title"].startswith(f"frame {o.frame} ")
        assert bar.attributes["onclick"] == f'vi.send({{"k":"frame","i":{o.frame}}})'
    mark = views.landmark(report, id)
    for words in (
        f"track {id}",
        "triangulated",
        number(mark.inv_depth),
        number(mark.depth),
        f"frame {mark.anchor_frame}",
    ):
        assert words in markup.text


def test_a_candidate_has_no_depth():
    markup = page(track=landmark_of(LandmarkStatus.CANDIDATE))
    assert "candidate" in markup.text
    assert "inverse depth" not in markup.text and "nan" not in markup.text.lower()


def test_a_track_without_landmark_shows_where_it_is():
    track = context(3).report.tracks
    markup = page(3, track=int(track.ids[0]))
    assert "pixel" in markup.text and f"{track.uv_px[0, 0]:.1f}" in markup.text


def test_a_lost_track_says_when_and_why():
    frame = next(k for k in range(20, 40) if len(context(k).report.tracks.lost_ids))
    id = int(context(frame).report.tracks.lost_ids[0])
    text = page(frame + 2, track=id).text
    assert f"Lost at frame {frame}" in text


def test_an_unknown_track_is_a_sentence():
    assert "not alive in this frame" in page(track=987654).text


def test_a_selected_frame_shows_its_state():
    frame = int(context(FRAME).report.window.frames[2])
    markup = page(selection=Selection("frame", frame))
    assert f"frame {frame}" in markup.text and "slot 2" in markup.text
    assert "not in the window" in page(selection=Selection("frame", 0)).text


def test_costs_before_and_after_share_a_scale():
    solve = context(FRAME).report.solve
    before, after = page().all(cls="vi-stack")

    def width(stack):
        return sum(float(re.search(r"width:([\d.]+)%", i.attributes["style"])[1]) for i in stack.children)

    assert width(before) == pytest.approx(100, abs=0.05)
    assert width(after) == pytest.approx(100 * solve.after.total / solve.before.total, abs=0.05)


def test_the_window_lists_every_slot_and_leads_to_its_frame():
    window = context(FRAME).report.window
    rows = page().all("tr", cls="vi-click")
    assert [r.attributes["onclick"] for r in rows] == [f'vi.send({{"k":"frame","i":{f}}})' for f in window.frames]
    assert [c.text for c in rows[3].children][:2] == ["3", str(window.frames[3])]
    assert rows[-1].attributes["class"].split() == ["vi-click", "vi-now"]
    assert ["KF" in r.children[2].text for r in rows] == window.keyframe.tolist()


def test_imu_residuals_stand_at_the_frame_they_end_in():
    sigma = context(FRAME).report.solve.imu_sigma
    rows = page().all("tr", cls="vi-click")
    assert rows[0].children[-1].text == "–"
    for row, parts in zip(rows[1:], sigma):
        assert row.children[-1].text == f"{parts.max():.1f}"
        bars = [e for e in row.walk() if e.attributes.get("class") == "vi-bar"]
        assert [b.attributes["title"].split()[0] for b in bars] == [name for _, name in inspect.IMU_PARTS]


def test_a_rejected_step_is_said():
    report = context(FRAME).report
    solve = dataclasses.replace(
        report.solve,
        iterations=(IterationReport(90.0, False, 3.0, -0.4, 1e4), IterationReport(80.0, True, 1.0, 0.9, 5e3)),
    )
    markup = page(report=dataclasses.replace(report, solve=solve))
    assert "rejected" in markup.text and "2 iterations" in markup.text
    assert "rejected" not in page().text


def test_marginalisation_names_what_left():
    frame = next(k for k in range(20, 40) if context(k).report.marginalization.kind == "MARGIN_OLD")
    prior = context(frame).report.marginalization
    text = page(frame).text
    for words in ("MARGIN_OLD", f"m {prior.m}", f"n {prior.n}", f"rank {prior.rank}/ {prior.n}", prior.blocks[0].name):
        assert words in text


def test_zero_eigenvalues_are_those_below_the_threshold():
    prior = context(FRAME).report.marginalization
    spectrum = [e for e in page().all("rect") if e.children and " of " in e.children[0].text]
    assert len(spectrum) == len(prior.eigenvalues)
    red = [e for e in spectrum if e.attributes["fill"] == "#F0603A"]
    assert len(red) == np.count_nonzero(prior.eigenvalues <= 1e-8) > 0


def test_before_the_first_solve_it_says_where_to_look():
    text = page(FIRST_SOLVE - 1).text
    assert "No solve at this frame" in text and "Gates" in text


def test_times_add_up():
    ms = context(FRAME).ms
    assert f"{sum(ms.values()):.1f} ms" in page().text
    assert all(stage in page().text for stage in ms)
