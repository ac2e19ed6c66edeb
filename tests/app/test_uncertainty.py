"""The ellipsoids drawn, against samples of the estimator's own claim."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from app.context import RunView, Selection
from app.optimum import compared
from app.scene.frame import SceneFrame
from app.scene.uncertainty import drawn, enlargement
from app.uncertainty import uncertainty
from vins_core import examine
from vins_core.errors import RunError
from vins_core.geometry import so3
from vins_core.record.reader import RunReader

FRAME = 28


@pytest.fixture(scope="module")
def run(sample_run: Path) -> RunView:
    return RunView(RunReader(sample_run))


def test_a_frame_that_was_not_solved_says_so(run: RunView) -> None:
    with pytest.raises(RunError, match="frame 4 was not solved"):
        compared(run.reader, 4)


def test_ellipsoids_have_the_shape_of_the_covariance(run: RunView) -> None:
    known, examined = uncertainty(run, FRAME), examine.uncertainty(run.reader, FRAME)
    assert known is not None and examined is not None
    found = examined.covariances
    turns = so3.to_matrix(known.poses.wxyz)
    shapes = np.einsum("kij,kj,klj->kil", turns, known.poses.axes**2 / 9, turns)
    np.testing.assert_allclose(shapes, found.poses[:, :3, :3], atol=1e-12)
    window = run.report(FRAME).window
    assert window is not None
    np.testing.assert_array_equal(known.poses.centres, window.p_w_b)


def test_the_oldest_pose_is_held_and_newer_ones_are_known_less(run: RunView) -> None:
    known = uncertainty(run, FRAME)
    assert known is not None
    largest = known.poses.axes.max(1)
    assert largest[0] < 1e-4 < largest[-1] and (np.diff(largest) > 0).all()


def test_only_the_selected_landmark_is_drawn(run: RunView) -> None:
    known = uncertainty(run, FRAME)
    assert known is not None and len(known.landmark_ids) > 20
    id = int(known.landmark_ids[3])
    frame = SceneFrame(
        run, FRAME, run.report(FRAME), Selection("track", id), None, np.zeros((0, 3)), 3.0, uncertainty=known
    )
    n = len(known.poses.centres)
    centres, axes, _, factor = drawn(frame)
    assert len(centres) == n + 1 and np.array_equal(centres[-1], known.landmarks.centres[3]) and factor >= 1
    assert (axes[-1] >= known.landmarks.axes[3] - 1e-12).all()
    assert len(drawn(dataclasses.replace(frame, selection=Selection()))[0]) == n
    assert len(drawn(dataclasses.replace(frame, uncertainty=None))[0]) == 0


@pytest.mark.parametrize(
    ("size", "wanted", "factor"), [(0.001, 0.1, 100), (0.004, 0.1, 20), (0.3, 0.1, 1), (0, 1, 5e4)]
)
def test_what_is_small_is_enlarged_by_a_round_factor(size: float, wanted: float, factor: float) -> None:
    assert enlargement(size, wanted) == factor
