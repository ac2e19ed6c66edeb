import dataclasses

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from plane_world import HEIGHT, PARAMS, WIDTH, render

from vins_core.frontend.detect import detect_corners, keep_spaced

IMAGE = render(np.eye(3))
NONE = np.zeros((0, 2), np.float32)


def distances(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=-1)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 80), st.integers(5, 60), st.integers(0, 2**31))
def test_kept_tracks_are_apart_and_dropped_ones_had_an_elder_nearby(n, min_dist, seed):
    uv = np.random.default_rng(seed).uniform(0, 200, (n, 2)).astype(np.float32)
    keep = keep_spaced(uv, min_dist, None)
    d = distances(uv, uv)
    np.fill_diagonal(d, np.inf)
    assert (d[np.ix_(keep, keep)] > min_dist).all()
    elder = keep[None] & (np.arange(n)[None] < np.arange(n)[:, None]) & (d <= min_dist + 1e-3)
    assert elder[~keep].any(1).all()


def test_a_track_outside_the_usable_area_neither_stays_nor_displaces_another():
    usable = np.full((HEIGHT, WIDTH), 255, np.uint8)
    usable[:, :100] = 0
    uv = np.array([[99.4, 50], [102.0, 50.0], [99.6, 200.0]], np.float32)  # rounds to 99, 102, 100
    assert keep_spaced(uv, 10, usable).tolist() == [False, True, True]


def test_new_corners_keep_their_distance_from_each_other_and_from_tracks():
    taken = np.array([[50.3, 60.8], [200.5, 100.2], [315.0, 235.0]], np.float32)
    corners = detect_corners(IMAGE, 100, taken, PARAMS, None)
    assert len(corners) > 40 and corners.dtype == np.float32
    assert distances(corners, taken).min() > PARAMS.min_dist - 0.75  # positions are rounded to pixels
    d = distances(corners, corners)
    assert d[~np.eye(len(d), dtype=bool)].min() >= PARAMS.min_dist


def test_the_strongest_corners_come_first_and_no_more_than_asked_for():
    response = cv2.cornerMinEigenVal(IMAGE, 3)
    many = detect_corners(IMAGE, 50, NONE, PARAMS, None)
    strength = response[tuple(many.astype(int).T[::-1])]
    assert len(many) == 50 and (np.diff(strength) <= 0).all()
    np.testing.assert_array_equal(detect_corners(IMAGE, 10, NONE, PARAMS, None), many[:10])
    for n in (0, -5):
        assert detect_corners(IMAGE, n, NONE, PARAMS, None).shape == (0, 2)


def test_no_corner_where_nothing_is_or_nothing_may_be():
    assert detect_corners(np.full_like(IMAGE, 90), 50, NONE, PARAMS, None).shape == (0, 2)
    usable = np.zeros_like(IMAGE)
    assert detect_corners(IMAGE, 50, NONE, PARAMS, usable).shape == (0, 2)
    usable[:, 200:] = 255
    kept = usable.copy()
    corners = detect_corners(IMAGE, 50, np.array([[250.0, 100.0]], np.float32), PARAMS, usable)
    assert len(corners) > 10 and (corners[:, 0] >= 200).all()
    np.testing.assert_array_equal(usable, kept)


def test_no_corner_is_born_where_it_would_be_lost_at_once():
    params = dataclasses.replace(PARAMS, border_px=25)
    corners = detect_corners(IMAGE, 100, NONE, params, None)
    assert len(corners) > 20
    assert (corners >= 25).all() and (corners < [WIDTH - 25, HEIGHT - 25]).all()
