from dataclasses import replace

import numpy as np
import pytest
import synthetic_flight as flight

from vins_core.geometry import se3
from vins_core.initialization.motion import references
from vins_core.initialization.structure import place_between, reconstruct
from vins_core.initialization.tracks import TrackTable
from vins_core.params import Init

SIGMA, MAX_ERROR = 1.5 / 460.0, 3.0 / 460.0


def true_cameras(f, frames):
    times = [w.t_ns * 1e-9 for w in frames]
    return (
        np.array([se3.from_quaternion_translation(f.motion.q(t), f.motion.position(t)) for t in times]) @ flight.T_B_C
    )


def build(f, tracks=None):
    tracks = TrackTable.of(f.window.frames) if tracks is None else tracks
    reference, _ = next(references(Init(), tracks))
    return tracks, reference, *reconstruct(Init(), tracks, reference, SIGMA, MAX_ERROR)


def assert_equal_up_to_scale(Ts_l_c, truth, l, atol):
    in_l = se3.inverse(truth[l]) @ truth
    scale = np.linalg.norm(in_l[-1, :3, 3]) / np.linalg.norm(Ts_l_c[-1, :3, 3])
    assert np.allclose(Ts_l_c[:, :3, :3], in_l[:, :3, :3], atol=atol)
    assert np.allclose(scale * Ts_l_c[:, :3, 3], in_l[:, :3, 3], atol=atol)


@pytest.mark.parametrize("seed", range(3))
def test_exact_tracks_give_the_exact_window_up_to_scale(seed):
    f = flight.fly(flight.lively(seed), seed)
    _, reference, built, stage = build(f)
    assert stage.passed and built.rms_rad < 1e-6
    assert_equal_up_to_scale(built.Ts_l_c, true_cameras(f, f.window.frames), reference.slot, 1e-4)


def test_frames_before_the_reference_are_placed_too():
    f = flight.fly(flight.lively(1), 1)
    tracks = TrackTable.of(f.window.frames)
    later = list(references(Init(), tracks))[3][0]
    assert later.slot >= 3
    built, stage = reconstruct(Init(), tracks, later, SIGMA, MAX_ERROR)
    assert stage.passed
    assert_equal_up_to_scale(built.Ts_l_c, true_cameras(f, f.window.frames), later.slot, 1e-4)


def test_frames_between_are_placed_by_the_points():
    f = flight.fly(flight.lively(2), 2, skip=(2, 3, 7))
    tracks, reference, built, _ = build(f)
    Ts, stage = place_between(Init(), tracks, built, f.window.frames, f.history, SIGMA)
    assert stage.passed and stage.values["frames"] == 3
    truth = true_cameras(f, f.history)
    slot_in_time = [w.frame for w in f.history].index(f.window.frames[reference.slot].frame)
    assert_equal_up_to_scale(Ts, truth, slot_in_time, 1e-4)


def test_points_that_move_are_dropped_and_the_rest_is_kept():
    f = flight.fly(flight.lively(3), 3)
    tracks = TrackTable.of(f.window.frames)
    moving = np.arange(0, len(tracks.ids), 12)
    rays = tracks.rays.copy()
    drift = np.linspace(0, 0.4, tracks.n_frames)[:, None] * np.array([0.3, 1.0, 0.0])
    rays[moving] += drift * np.sin(np.arange(tracks.n_frames) * 2.0)[:, None]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    tracks, reference, built, stage = build(f, TrackTable(tracks.ids, rays))
    share = next(g for g in stage.gates if g.name == "consistent_points")
    assert stage.passed and share.value < 1.0
    assert np.isin(moving, built.rows).mean() < 0.3
    assert_equal_up_to_scale(built.Ts_l_c, true_cameras(f, f.window.frames), reference.slot, 1e-2)


def test_a_frame_that_sees_too_little_is_named():
    f = flight.fly(flight.lively(0), 0)
    blind = f.window.frames[5]
    few = {n: getattr(blind.observations, n)[:6] for n in ("ids", "rays", "uv_px", "velocity")}
    frames = list(f.window.frames)
    frames[5] = replace(blind, observations=replace(blind.observations, **few))
    _, _, built, stage = build(f, TrackTable.of(frames))
    assert built is None and "slot 5" in stage.outcome
    assert {g.name: g.passed for g in stage.gates}["known_points"] is False


def test_the_oldest_frame_with_enough_parallax_is_the_reference():
    f = flight.fly(flight.lively(0), 0)
    tracks = TrackTable.of(f.window.frames)
    slots = [r.slot for r, _ in references(Init(), tracks)]
    assert slots == sorted(slots) and slots[0] == 0
    near = replace(Init(), min_parallax_px=1e3)
    (none, stage), *rest = references(near, tracks)
    assert none is None and not rest and "parallax" in stage.outcome
