"""What panels ask of reports."""

import dataclasses
import math

import numpy as np
import pytest
from fake_reports import FIRST_SOLVE, context

from app import views
from app.series import Event
from vins_core.geometry import so3
from vins_core.report import LandmarkStatus, LossReason


def test_a_trail_passes_where_the_track_was():
    ctx = context(20)
    paths = views.trails(ctx.run, ctx.report)
    assert paths.shape == (len(ctx.report.tracks.ids), views.TRAIL + 1, 2)
    for row, id in enumerate(ctx.report.tracks.ids.tolist()):
        for column in range(views.TRAIL + 1):
            then = ctx.run.report(20 - views.TRAIL + column).tracks
            at = views.track_row(then, id)
            if at is None:
                assert np.isnan(paths[row, column]).all()
            else:
                np.testing.assert_array_equal(paths[row, column], then.uv_px[at])


def test_the_first_frame_has_trails_of_one_point():
    ctx = context(0)
    paths = views.trails(ctx.run, ctx.report)
    assert np.isfinite(paths[:, -1]).all()
    assert np.isnan(paths[:, :-1]).all()


def test_trails_do_not_depend_on_the_order_of_tracks():
    ctx = context(20)
    tracks = ctx.report.tracks
    turn = np.random.default_rng(0).permutation(len(tracks.ids))
    shuffled = dataclasses.replace(
        tracks, ids=tracks.ids[turn], uv_px=tracks.uv_px[turn], age=tracks.age[turn], velocity=tracks.velocity[turn]
    )
    other = views.trails(ctx.run, dataclasses.replace(ctx.report, tracks=shuffled))
    np.testing.assert_array_equal(other, views.trails(ctx.run, ctx.report)[turn])


def test_losses_are_counted_by_reason():
    for frame in range(1, 30):
        tracks = context(frame).report.tracks
        counts = views.lost_counts(tracks)
        assert sum(n for _, n in counts) == len(tracks.lost_ids)
        assert all(n > 0 for _, n in counts)
        assert [r for r, _ in counts] == sorted((r for r, _ in counts), key=list(LossReason).index)


def test_a_lost_track_tells_how_it_ended():
    frame = next(k for k in range(20, 40) if len(context(k).report.tracks.lost_ids))
    tracks = context(frame).report.tracks
    end = views.track_ending(context(frame).run, frame + 3, int(tracks.lost_ids[0]))
    assert end is not None
    assert (end.frame, end.age) == (frame, int(tracks.lost_age[0]))
    alive = int(context(frame).report.tracks.ids[-1])
    assert views.track_ending(context(frame).run, frame, alive) is None


def test_landmark_depth_and_its_interval():
    mark = next(
        m for i in context(20).report.landmarks.ids.tolist()
        if (m := views.landmark(context(20).report, i)).status is LandmarkStatus.TRIANGULATED
    )  # fmt: skip
    near, far = mark.depth_interval
    assert near < mark.depth < far
    assert mark.depth == pytest.approx(1 / mark.inv_depth)
    unsure = dataclasses.replace(mark, sigma=2 * mark.inv_depth)
    assert unsure.depth_interval[1] == math.inf


def test_there_is_no_landmark_before_the_first_solve():
    assert views.landmark(context(3).report, 1) is None
    assert views.statuses(context(3).report) == {}
    assert views.observations(context(3).report, 1) == []


def test_observations_are_the_rows_of_the_track_in_slot_order():
    report = context(25).report
    id = int(np.bincount(report.solve.visual_ids).argmax())
    seen = views.observations(report, id)
    assert len(seen) == np.count_nonzero(report.solve.visual_ids == id) > 1
    assert [o.slot for o in seen] == sorted(o.slot for o in seen)
    assert [o.frame for o in seen] == [int(report.window.frames[o.slot]) for o in seen]


@pytest.mark.parametrize("angles", [(30, 10, -5), (-170, -60, 100), (0, 0, 0)])
def test_euler_angles_rebuild_the_rotation(angles):
    yaw, pitch, roll = np.radians(angles)
    parts = [so3.exp(v) for v in (np.array([0, 0, yaw]), np.array([0, pitch, 0]), np.array([roll, 0, 0]))]
    q = so3.multiply(so3.multiply(parts[0], parts[1]), parts[2])
    np.testing.assert_allclose(views.yaw_pitch_roll_deg(q), angles, atol=1e-9)


EVENTS = (Event(10, "attempt", "a"), Event(12, "initialized", ""), Event(30, "restart", "b"), Event(34, "attempt", "c"))


def test_nearest_event():
    assert views.nearest(EVENTS, 11, "attempt").frame == 10
    assert views.nearest(EVENTS, 22, "attempt").frame == 10  # of two equally near ones the earlier
    assert views.nearest(EVENTS, 23, "attempt").frame == 34
    assert views.nearest(EVENTS, 5, "anomaly") is None


def test_latest_event_never_lies_ahead():
    assert views.latest(EVENTS, 33, "attempt", "initialized").frame == 12
    assert views.latest(EVENTS, 12, "initialized").frame == 12
    assert views.latest(EVENTS, 9, "attempt") is None


def test_a_run_is_named_without_its_folders():
    assert views.run_name(context(0).run) == "fake_room.bag"


def test_cost_split_adds_up():
    cost = context(FIRST_SOLVE).report.solve.after
    assert sum(v for _, v in views.split(cost)) == pytest.approx(cost.total)
    assert [n for n, _ in views.split(cost)] == list(views.FACTORS)
