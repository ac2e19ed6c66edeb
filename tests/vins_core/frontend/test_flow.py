import dataclasses

import numpy as np
from plane_world import HEIGHT, PARAMS, WIDTH, homography, move, render, texture

from vins_core.frontend.detect import detect_corners
from vins_core.frontend.ledger import FATES, KEPT
from vins_core.frontend.track import follow
from vins_core.report import LossReason

STILL, MOVED = render(np.eye(3)), homography((0.03, 0.01, 0.0), (0.0, 0.0, 0.01))
CORNERS = detect_corners(STILL, 60, np.zeros((0, 2), np.float32), PARAMS, None)


def test_an_unchanged_image_moves_nothing():
    uv, fate = follow(STILL, STILL, CORNERS, PARAMS)
    inner = ((CORNERS > 1) & (CORNERS < [WIDTH - 2, HEIGHT - 2])).all(1)
    assert (fate[inner] == KEPT).all()
    np.testing.assert_allclose(uv[inner], CORNERS[inner], atol=0.01)


def test_points_are_found_where_the_homography_puts_them():
    uv, fate = follow(STILL, render(MOVED), CORNERS, PARAMS)
    error = np.linalg.norm(uv - move(MOVED, CORNERS), axis=1)[fate == KEPT]
    assert (fate == KEPT).mean() > 0.8 and np.median(error) < 0.06 and np.quantile(error, 0.9) < 0.3


def test_flow_back_removes_mostly_what_is_wrong():
    hole = render(MOVED)
    hole[80:160, 100:220] = render(np.eye(3), texture(5))[80:160, 100:220]
    loose = dataclasses.replace(PARAMS, flow_back=False)
    uv, fate = follow(STILL, hole, CORNERS, loose)
    wrong = np.linalg.norm(uv - move(MOVED, CORNERS), axis=1) > 2
    uv, strict = follow(STILL, hole, CORNERS, PARAMS)
    gone = (strict == FATES[LossReason.FLOW_BACK]) & (fate == KEPT)
    assert (gone & wrong).sum() >= 5 and (gone & wrong).sum() > 0.6 * (wrong & (fate == KEPT)).sum()
    assert (gone & ~wrong).sum() <= 0.1 * (~wrong).sum()


def test_nothing_to_follow_is_nothing_followed():
    uv, fate = follow(STILL, STILL, np.zeros((0, 2), np.float32), PARAMS)
    assert uv.shape == (0, 2) and fate.shape == (0,)


def test_input_is_left_alone():
    before = CORNERS.copy()
    follow(STILL, render(MOVED), CORNERS, PARAMS)
    np.testing.assert_array_equal(CORNERS, before)
