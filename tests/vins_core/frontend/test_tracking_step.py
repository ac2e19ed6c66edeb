import dataclasses

import cv2
import numpy as np
import pytest
from plane_world import (
    CAMERA,
    FOCAL,
    HEIGHT,
    PARAMS,
    STEP_NS,
    WIDTH,
    Film,
    film,
    homography,
    move,
    packet,
    packets,
    ref,
    render,
    start,
    texture,
)

from vins_core.errors import CalibrationError
from vins_core.frontend.step import track
from vins_core.geometry.kannala_brandt import KannalaBrandt
from vins_core.params import DECLARATIONS, Params
from vins_core.report import LOSS_REASONS, LossReason


def run(images, stream, params=PARAMS, camera=CAMERA, state=None, rejected=None):
    """Every (state, observations, report) of a stream of packets."""
    state, out = state or start(), []
    for p in stream:
        state, observations, report = track(params, camera, images, state, p, rejected if p.frame else None)
        out.append((state, observations, report))
    return out


def reasons(report):
    return {LOSS_REASONS[r] for r in report.lost_reason}


def same(a, b):
    """Equal bit for bit, through dataclasses and tuples."""
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.tobytes() == b.tobytes()
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return a == b


def spacing(uv):
    d = np.linalg.norm(uv[:, None] - uv[None], axis=-1)
    return d[~np.eye(len(uv), dtype=bool)].min()


def test_tracks_follow_the_motion_of_the_scene():
    images, Hs = film(9)
    born = {}
    for state, _, report in run(images, packets(9)):
        H = Hs[state.image.index]
        for i, uv in zip(state.ids, state.uv_px):
            born.setdefault(i, move(np.linalg.inv(H), [uv])[0])
        error = np.linalg.norm(move(H, [born[i] for i in state.ids]) - state.uv_px, axis=1)
        assert np.median(error) < 0.4 and error.max() < 2.0
        assert len(report.ids) > 40
    assert report.age.max() == 9


@pytest.mark.parametrize("per_frame", [1, 2, 3])
def test_every_image_makes_a_track_older_and_only_frames_make_new_ones(per_frame):
    images, _ = film(7)
    ages = {}
    for state, _, report in run(images, packets(7, per_frame)):
        for i, age in zip(report.ids, report.age):
            assert age == (ages[i] + per_frame if i in ages else 1)
            ages[i] = age
        assert (report.age[len(report.ids) - report.n_new :] == 1).all()
        assert state.image.index % per_frame == 0


def test_no_track_appears_or_disappears_without_notice():
    """Tracks before + new = tracks now + lost, each id once, over motion, gaps and rejected tracks."""
    images, _ = film(12, velocity=(0.05, 0.0, -0.06))
    alive, known = set(), set()
    stream = list(packets(12))
    stream[3] = packet(3, ref(5), ref(6, 6 * STEP_NS + 3_000_000_000))
    for state, _, report in run(images, stream, rejected={LossReason.OUTLIER: [0, 1, 999]}):
        new = report.ids[len(report.ids) - report.n_new :].tolist()
        assert not known & set(new)
        assert alive | set(new) == set(report.ids) | set(report.lost_ids)
        assert not set(report.ids) & set(report.lost_ids)
        assert len(set(report.lost_ids)) == len(report.lost_ids)
        assert (np.diff(report.ids) > 0).all()
        alive, known = set(report.ids), known | set(new)
        assert state.next_id > max(known)


def test_the_estimator_gets_tracks_seen_often_enough_as_unit_rays_in_order_of_id():
    images, _ = film(7)
    for min_count in (1, 2, 4):
        params = dataclasses.replace(PARAMS, min_track_count=min_count)
        for state, seen, report in run(images, packets(7), params):
            np.testing.assert_array_equal(seen.ids, state.ids[state.age >= min_count])
            assert (np.diff(seen.ids) > 0).all()
            np.testing.assert_allclose(np.linalg.norm(seen.rays, axis=1), 1.0, atol=1e-15)
            np.testing.assert_allclose(CAMERA.model.project(seen.rays), seen.uv_px, atol=1e-4)
            np.testing.assert_array_equal(seen.uv_px, report.uv_px[report.age >= min_count])


def test_velocity_is_the_motion_since_the_previous_image_on_the_normalised_plane():
    images, Hs = film(5)
    (_, _, _), (_, _, _), (state, seen, report) = run(images, packets(5))
    was = move(Hs[3] @ np.linalg.inv(Hs[4]), seen.uv_px)
    expected = (seen.uv_px - was) / FOCAL / (STEP_NS * 1e-9)
    assert np.median(np.abs(seen.velocity - expected)) < 0.02 * np.median(np.linalg.norm(expected, axis=1))
    assert (report.velocity[report.age == 1] == 0).all()
    assert report.velocity.dtype == np.float32 and len(report.velocity) == len(state.ids)


def test_tracks_keep_their_distance_while_the_scene_shrinks():
    images, _ = film(9, velocity=(0.0, 0.0, -0.12), turn=(0, 0, 0))
    lost = set()
    for state, _, report in run(images, packets(9, 1)):
        assert spacing(state.uv_px) > PARAMS.min_dist - 1  # new corners keep clear of rounded positions
        lost |= reasons(report)
    assert LossReason.MASK in lost


def test_the_older_of_two_tracks_that_meet_survives():
    images, _ = film(9, velocity=(0.0, 0.0, -0.12), turn=(0, 0, 0))
    masked = LOSS_REASONS.index(LossReason.MASK)
    meetings = 0
    for state, _, report in run(images, packets(9, 1)):
        old = report.age > 1
        for uv, age in zip(
            report.lost_uv_px[report.lost_reason == masked], report.lost_age[report.lost_reason == masked]
        ):
            near = np.linalg.norm(state.uv_px[old] - uv, axis=1) <= PARAMS.min_dist
            assert near.any() and report.age[old][near].max() >= age
            meetings += 1
    assert meetings > 0


def test_what_moves_against_the_scene_is_rejected_by_epipolar_geometry():
    canvas = texture()
    Hs = [homography((0.02 * k, 0.0, 0.0)) for k in range(4)]
    patch = texture(7)[:90, :90]
    images = []
    for k, H in enumerate(Hs):
        image = render(H, canvas)
        image[60 + 4 * k : 150 + 4 * k, 100:190] = patch  # sinks while the scene goes sideways
        images.append(image)
    params = dataclasses.replace(PARAMS, min_dist=10, max_cnt=150, klt_window=21)
    (first, _, _), (_, _, report) = run(Film(images), [packet(0, ref(0)), packet(1, ref(1))], params)

    def on_patch(uv, margin):
        return ((uv >= [100 + margin, 60 + margin]) & (uv < [190 - margin, 150 - margin])).all(1)

    planted = first.ids[on_patch(first.uv_px, 12)]
    gone = set(report.lost_ids[report.lost_reason == LOSS_REASONS.index(LossReason.RANSAC)])
    assert len(planted) >= 8
    assert gone >= set(planted) & (set(report.ids) | gone)
    outside = first.ids[~on_patch(first.uv_px, -12)]
    assert len(gone & set(outside)) <= 0.03 * len(outside)
    kept = dataclasses.replace(params, f_ransac=False)
    (_, _, _), (_, _, report) = run(Film(images), [packet(0, ref(0)), packet(1, ref(1))], kept)
    assert LossReason.RANSAC not in reasons(report) and "F-RANSAC inliers" not in {g.name for g in report.gates}


def test_tracks_that_do_not_come_back_to_where_they_were_are_lost():
    images = Film([render(np.eye(3), texture(1)), render(np.eye(3), texture(2))])
    _, (_, _, report) = run(images, [packet(0, ref(0)), packet(1, ref(1))])
    n_back = (report.lost_reason == LOSS_REASONS.index(LossReason.FLOW_BACK)).sum()
    assert n_back > 30 and len(report.ids) - report.n_new < 10
    params = dataclasses.replace(PARAMS, flow_back=False, f_ransac=False)
    _, (_, _, report) = run(images, [packet(0, ref(0)), packet(1, ref(1))], params)
    assert LossReason.FLOW_BACK not in reasons(report) and len(report.ids) - report.n_new > 30


def test_tracks_that_leave_the_image_are_lost_there():
    images, _ = film(9, velocity=(0.06, 0.0, 0.0), turn=(0, 0, 0))
    params = dataclasses.replace(PARAMS, border_px=8)
    at_border = far = 0
    for state, _, report in run(images, packets(9, 1), params):
        uv = np.rint(state.uv_px[state.age > 1])
        assert (uv >= 8).all() and (uv[:, 0] < WIDTH - 8).all() and (uv[:, 1] < HEIGHT - 8).all()
        gone = report.lost_uv_px[np.isin(report.lost_reason, [LOSS_REASONS.index(LossReason.BORDER)])]
        at_border += len(gone)
        far += (gone[:, 0] > 8 + 8).sum()  # a step is 6.6 px
    assert at_border > 8 and far <= 0.2 * at_border


def test_a_track_that_flow_cannot_find_is_lost():
    images, _ = film(2, velocity=(0.6, 0.0, 0.0), turn=(0, 0, 0))  # 66 px to the left: the leftmost leave the image
    params = dataclasses.replace(PARAMS, f_ransac=False)
    _, (_, _, report) = run(images, packets(2, 1), params)
    assert reasons(report) & {LossReason.FLOW, LossReason.BORDER}
    assert LossReason.FLOW in reasons(report)


def test_outliers_of_the_estimator_are_dropped_before_the_next_frame():
    images, _ = film(5)
    (_, seen, _), *_ = run(images, packets(5, 1), dataclasses.replace(PARAMS, min_track_count=1))
    bad = seen.ids[:3]
    out = run(images, packets(5, 1), rejected={LossReason.OUTLIER: bad[:2], LossReason.DEPTH: bad[2:]})
    report = out[1][2]
    assert set(report.lost_ids[report.lost_reason == LOSS_REASONS.index(LossReason.OUTLIER)]) == set(bad[:2])
    assert set(report.lost_ids[report.lost_reason == LOSS_REASONS.index(LossReason.DEPTH)]) == set(bad[2:])
    assert not set(bad) & set(out[1][0].ids)


@pytest.mark.parametrize("t_ns", [2 * STEP_NS + 1_500_000_000, STEP_NS, 0], ids=["gap", "standing", "backwards"])
def test_a_gap_or_time_that_does_not_advance_starts_over_with_new_ids(t_ns):
    images, _ = film(4)
    stream = [packet(0, ref(0)), packet(1, ref(1)), packet(2, ref(2, t_ns)), packet(3, ref(3, t_ns + STEP_NS))]
    _, (before, _, ok), (after, seen, report), (_, _, later) = run(images, stream)
    assert reasons(report) == {LossReason.RESET} and set(report.lost_ids) == set(before.ids)
    assert (after.ids >= before.next_id).all() and len(after.ids) > 40 and len(seen) == 0
    (gate,) = (g for g in report.gates if g.name == "image interval")
    assert gate.decides and not gate.passed
    assert all(g.passed for r in (ok, later) for g in r.gates if g.name == "image interval")
    assert later.age.max() == 2


def test_steps_are_functions_of_values():
    """Two runs agree bit for bit, and a restored state goes on exactly where it was, without any cache."""
    images, _ = film(9, velocity=(0.04, 0.0, -0.04))
    stream = list(packets(9))
    once, twice = run(images, stream), run(images, stream)
    assert all(map(same, once, twice))
    for k in range(1, len(stream)):
        fresh = Film([i.copy() for i in images.images])
        assert same(track(PARAMS, CAMERA, fresh, once[k - 1][0], stream[k]), once[k])


def test_the_number_of_threads_changes_nothing():
    images, _ = film(7, velocity=(0.04, 0.0, -0.04))
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        once = run(Film(images.images), packets(7))
        cv2.setNumThreads(4)
        assert all(map(same, once, run(Film(images.images), packets(7))))
    finally:
        cv2.setNumThreads(before)


def test_a_step_leaves_its_input_alone():
    images, _ = film(3)
    (state, _, _), *_ = run(images, [packet(0, ref(0))])
    copies = {f.name: np.copy(getattr(state, f.name)) for f in dataclasses.fields(state) if f.name != "image"}
    track(PARAMS, CAMERA, images, state, packet(1, ref(1), ref(2)), {LossReason.OUTLIER: state.ids[:5]})
    for name, copy in copies.items():
        np.testing.assert_array_equal(getattr(state, name), copy)


@pytest.mark.parametrize("level", [0, 128])
def test_images_without_texture_are_no_accident(level):
    blank = np.full((HEIGHT, WIDTH), level, np.uint8)
    images = Film([blank, blank, render(np.eye(3)), render(np.eye(3)), blank, render(np.eye(3))])
    out = run(images, packets(6, 1))
    assert [len(r.ids) for _, _, r in out[:2]] == [0, 0]
    assert len(out[2][2].ids) > 40 and len(out[3][1]) > 40
    assert len(out[4][1]) == 0 and len(out[4][2].lost_ids) > 40
    assert len(out[5][2].ids) > 40


@pytest.mark.parametrize("n", [1, 5, 7])
def test_a_handful_of_tracks_is_followed_without_a_model(n):
    images, _ = film(3, velocity=(0, 0, 0), turn=(0, 0, 0))
    params = dataclasses.replace(PARAMS, max_cnt=n)
    for _, seen, report in run(images, packets(3, 1), params)[1:]:
        assert len(seen) == n
        (gate,) = (g for g in report.gates if g.name == "F-RANSAC inliers")
        assert gate.value is None and not gate.passed and not gate.decides


def test_tracks_live_only_where_the_mask_is_white(tmp_path):
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.circle(mask, (WIDTH // 2, HEIGHT // 2), 90, 255, cv2.FILLED)
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    camera = dataclasses.replace(CAMERA, mask=str(tmp_path / "mask.png"))
    images, _ = film(7, velocity=(0.05, 0.0, 0.0))
    lost = set()
    for state, _, report in run(images, packets(7), camera=camera):
        assert len(state.ids) > 15
        assert (mask[tuple(np.rint(state.uv_px).astype(int).T[::-1])] == 255).all()
        lost |= reasons(report)
    assert LossReason.MASK in lost


def test_tracks_live_only_where_the_lens_shows_something():
    """A fisheye whose image is a disc of 70 pixels radius: beyond, pixels have no ray."""
    lens = KannalaBrandt(WIDTH, HEIGHT, 100.0, 100.0, WIDTH / 2, HEIGHT / 2, -0.3, 0.0, 0.0, 0.0)
    camera = dataclasses.replace(CAMERA, model=lens)
    images, _ = film(7, velocity=(0.05, 0.0, 0.0))
    params = dataclasses.replace(PARAMS, min_dist=8, f_ransac=False)
    left = 0
    for state, seen, report in run(images, packets(7), params, camera):
        assert len(state.ids) > 40
        assert np.linalg.norm(state.uv_px - [WIDTH / 2, HEIGHT / 2], axis=1).max() < 70.3
        assert np.isfinite(seen.rays).all() and np.isfinite(seen.velocity).all()
        left += (report.lost_reason == LOSS_REASONS.index(LossReason.BORDER)).sum()
    assert left > 3


def test_an_image_or_mask_of_another_camera_is_refused(tmp_path):
    with pytest.raises(
        CalibrationError, match=r"/cam0: image 0 at 0 ns is 160x120, but the calibration of cam0 says 320x2"
    ):
        track(PARAMS, CAMERA, Film([np.zeros((120, 160), np.uint8)]), start(), packet(0, ref(0)))
    images, _ = film(1)
    small, text = tmp_path / "small.png", tmp_path / "text.png"
    cv2.imwrite(str(small), np.full((10, 10), 255, np.uint8))
    text.write_text("not an image")
    for path, sentence in [
        (small, "is 10x10, but cam0 gives 320x240 images"),
        (text, "is not an image; expected PNG or JPEG"),
        (tmp_path / "absent.png", "cannot be read: No such file"),
    ]:
        camera = dataclasses.replace(CAMERA, mask=str(path))
        with pytest.raises(CalibrationError, match=sentence):
            track(PARAMS, camera, images, start(), packet(0, ref(0)))


def test_every_gate_names_the_parameter_that_sets_its_limit():
    images, _ = film(3)
    for _, _, report in run(images, packets(3, 1)):
        for gate in report.gates:
            assert gate.knob in DECLARATIONS and gate.knob.startswith("frontend.")
            assert gate.limit == getattr(Params().frontend, gate.knob.removeprefix("frontend."))
    assert [g.name for g in report.gates] == [
        "image interval",
        "flow found",
        "flow-back agrees",
        "F-RANSAC inliers",
        "tracks",
    ]
    assert all(g.passed for g in report.gates)
