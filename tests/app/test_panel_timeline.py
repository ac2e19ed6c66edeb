"""Timeline: the run in lanes, the frame in chips."""

import dataclasses
import itertools

from fake_reports import FIRST_SOLVE, context, lost_again, parse, run_with

from app.panels import timeline
from vins_core.geometry.poses import IDENTITY
from vins_core.report import ClosureReport, LoopOutcome, LoopReport, Status


def lanes(run=None, frame=30):
    return parse(timeline.backdrop(context(frame, run=run)))


def chips(frame, **changes):
    return parse(timeline.render(context(frame, **changes)))


def test_lanes_are_those_in_which_something_happened():
    assert lanes().one(cls="vi-lane").attributes["data-lanes"] == "cost keyframes init anomalies status"
    calm = run_with(dataclasses.replace(context(25).report, anomalies=()))
    assert lanes(calm).one(cls="vi-lane").attributes["data-lanes"] == "cost keyframes init status"


def test_loops_have_a_lane_where_candidates_were_looked_at():
    said = ClosureReport(None, LoopReport(4, 29, 0, 9, 9, None, (), (), LoopOutcome.PNP), (), None, IDENTITY, IDENTITY)
    run = run_with(dataclasses.replace(context(30).report, closure=said))
    assert "loops" in lanes(run).one(cls="vi-lane").attributes["data-lanes"]
    assert "N loop" in parse(timeline.render(context(30, run=run))).text


def test_events_say_what_happened():
    titles = [e.text for e in lanes().all("title")]
    failed = [t for t in titles if t.startswith(("frame 10:", "frame 11:"))]
    assert len(failed) == 2 and all("excited" in t for t in failed)
    assert any(t.startswith(f"frame {FIRST_SOLVE}: initialised") for t in titles)
    assert any(t.startswith("frame 25: ") and "anomal" in t for t in titles)


def test_a_restart_is_marked():
    run = run_with(lost_again(context(30).report))
    assert any("the bias is too large" in e.text for e in lanes(run).all("title"))


def test_status_bands_cover_the_run():
    bands = lanes().all("rect")
    assert [b.text.split(":")[0] for b in bands] == [Status.FILLING, Status.INITIALIZING, Status.TRACKING]
    edges = [(float(b.attributes["x"]), float(b.attributes["width"])) for b in bands]
    assert edges[0][0] == 0
    assert abs(sum(edges[-1]) - 1000) < 0.11
    for (x, width), (following, _) in itertools.pairwise(edges):
        assert abs(x + width - following) < 0.21


def test_lanes_depend_on_the_run_alone():
    assert timeline.backdrop(context(3)) == timeline.backdrop(context(40))


def test_the_clock_starts_at_zero():
    clock = lanes().one(cls="vi-clock").children
    assert clock[0].text == "0 s"
    assert 3 <= len(clock) <= 11


def test_chips_of_a_frame():
    ctx = context(30)
    page = parse(timeline.render(ctx))
    assert page.one("b", data_frame="30")
    tracks, solve = ctx.report.tracks, ctx.report.solve
    for words in (
        "fake_room.bag",
        "frame 30/ 44",
        "t 3.00 s",
        f"tracks {len(tracks.ids)}+{tracks.n_new}−{len(tracks.lost_ids)}",
        f"{len(solve.iterations)} it · {ctx.ms['solve']:.0f} ms",
        "ATE ",
        "paused",
    ):
        assert words in page.text
    kept = ctx.report.keyframe.is_keyframe
    assert f"{'KEYFRAME' if kept else 'no keyframe'} 29 → {ctx.report.marginalization.kind}" in page.text


def test_before_initialisation_the_status_is_said_and_no_cost():
    page = chips(5)
    assert Status.FILLING in page.text
    assert "cost " not in page.text.replace("worst cost", "")


def test_without_truth_there_is_no_ate():
    assert "ATE" not in chips(30, run=run_with(truth=False)).text


def test_an_anomaly_is_said_where_it_is():
    assert "/imu0: gap" in chips(25).text
    assert "/imu0: gap" not in chips(26).text


def test_playing_and_progress_are_said():
    page = chips(30, playing=True, progress="frame 31, 3.1 of 6.0 s")
    assert "playing" in page.text and "frame 31, 3.1 of 6.0 s" in page.text


def test_keys_are_shown():
    assert {e.text for e in chips(30).all("kbd")} >= {"←", "→", "space", "Ctrl K"}
