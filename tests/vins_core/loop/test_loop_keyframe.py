from dataclasses import replace

import numpy as np
import pytest
import synthetic_window as sw
from plane_world import CAMERA, FOCAL, HEIGHT, WIDTH, homography, render

from vins_core.errors import VocabularyError
from vins_core.geometry import se3
from vins_core.loop.describe import Brief, UprightOrb
from vins_core.loop.keyframe import describe_keyframe, landmarks_seen
from vins_core.loop.train import train
from vins_core.window.landmarks import camera_poses
from vins_core.window.state import OUTLIER, Observations, WindowState

SLOT = 9
IMAGE = render(homography())
VOCABULARY = train([UprightOrb()(IMAGE, np.zeros((0, 2)), 300).descriptors], UprightOrb.name)


def window() -> WindowState:
    """The truth of a synthetic flight, with tracks that lie in the image."""
    truth = sw.make(seed=2, pixel_sigma=0.0, max_angle_deg=25.0).truth
    frames = []
    for f in truth.frames:
        xy = f.observations.rays[:, :2] / f.observations.rays[:, 2:]
        uv = (FOCAL * xy + [WIDTH / 2, HEIGHT / 2]).astype(np.float32)
        frames.append(replace(f, observations=replace(f.observations, uv_px=uv)))
    return replace(truth, frames=tuple(frames))


def describe(window, slot=SLOT, corners=100, describer=None):
    return describe_keyframe(window, slot, CAMERA.model, IMAGE, describer or UprightOrb(), VOCABULARY, corners)


def test_landmarks_lie_on_the_rays_that_see_them():
    w = window()
    k = describe(w)
    assert k.n_landmarks > 20
    local = se3.transform(se3.inverse(camera_poses(w)[SLOT]), k.points_w)
    assert np.allclose(local / np.linalg.norm(local, axis=1, keepdims=True), k.rays[: k.n_landmarks], atol=1e-6)
    assert np.allclose(k.T_w_c, camera_poses(w)[SLOT])


def test_landmarks_are_triangulated_before_the_keyframe_and_no_outliers():
    w = window()
    ids, _ = landmarks_seen(w, SLOT)
    earlier = np.unique(np.concatenate([f.observations.ids for f in w.frames[:SLOT]]))
    seen = w.frames[SLOT].observations.ids
    assert np.array_equal(ids, np.intersect1d(earlier, seen))
    status, inv_depth = w.landmarks.status.copy(), w.landmarks.inv_depth.copy()
    at = np.searchsorted(w.landmarks.ids, ids[:3])
    status[at[0]], inv_depth[at[1]], inv_depth[at[2]] = OUTLIER, np.nan, -0.2
    spoilt = replace(w, landmarks=replace(w.landmarks, status=status, inv_depth=inv_depth))
    assert np.array_equal(landmarks_seen(spoilt, SLOT)[0], ids[3:])


def test_points_are_landmarks_then_other_tracks_then_corners_each_with_its_ray():
    w = window()
    k, seen = describe(w), w.frames[SLOT].observations
    assert np.array_equal(np.sort(k.track_ids), seen.ids) and len(k.uv_px) > len(seen)
    assert np.array_equal(k.track_ids[: k.n_landmarks], landmarks_seen(w, SLOT)[0])
    row = np.searchsorted(seen.ids, k.track_ids)
    assert np.array_equal(k.uv_px[: len(row)], seen.uv_px[row])
    assert np.allclose(k.rays, CAMERA.model.lift(k.uv_px), atol=1e-6)
    assert len(k.descriptors) == len(k.rays) == len(k.uv_px)
    assert np.array_equal(k.bag.words, VOCABULARY.bag_of(k.descriptors).words)


def test_a_keyframe_without_tracks_has_corners_only():
    w = window()
    nothing = Observations(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 2), np.float32), np.zeros((0, 2)))
    bare = replace(w, frames=(*w.frames[:SLOT], replace(w.frames[SLOT], observations=nothing), *w.frames[SLOT + 1 :]))
    k = describe(bare)
    assert k.n_landmarks == 0 and len(k.track_ids) == 0 and len(k.uv_px) > 50


def test_a_vocabulary_of_other_descriptors_is_refused():
    with pytest.raises(VocabularyError, match="orb-upright"):
        describe(window(), describer=Brief(np.zeros((256, 2, 2), np.int16)))
