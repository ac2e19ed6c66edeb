"""What other settings would have accepted is told exactly, as far as it can be known (SPEC 9.3a)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from looping import close_again, loops, recorded
from same import differences
from sample import CALIBRATION, RECORDING

from vins_core import params as parameters
from vins_core.mapping.counterfactual import Prediction
from vins_core.mapping.study import LoopStudy
from vins_core.params import DECLARATIONS
from vins_core.record.fork import fork
from vins_core.record.reader import RunReader
from vins_core.runner import run_recording

LIMITS = {
    "loop.min_score_ratio": (0.1, 0.9),
    "loop.min_neighbour_score": (0.1, 0.6),
    "loop.min_matches": (20, 110),
    "loop.min_epipolar": (20, 110),
    "loop.min_inliers": (15, 110),
    "loop.max_rms_px": (0.5, 2.0),
    "loop.max_sigma_m": (0.001, 0.03),
    "loop.max_tilt_deg": (0.1, 2.0),
    "loop.max_heading_deg": (2.0, 45.0),
    "loop.max_distance_m": (0.1, 1.0),
    "loop.candidates": (1, 6),
    "loop.max_drift": (1.0, 2.0),
    "loop.sure_drift": (0.01, 1.0),
    "loop.min_agreement": (0, 8),
    "loop.agreement_span": (1, 8),
    "loop.drift_inflation": (1.0, 4.0),
}
"""Decision limits, and where they matter."""
CONSISTENCY = tuple(LIMITS)[-5:]


def random_changes(count: int, seed: int) -> Iterator[dict[str, Any]]:
    rng = np.random.default_rng(seed)
    for i in range(count):
        chosen = rng.choice(list(LIMITS), size=int(rng.integers(1, 3)), replace=False).tolist()
        changes: dict[str, Any] = {}
        for key in chosen:
            low, high = LIMITS[key]
            value = rng.uniform(low, high)
            changes[key] = round(value) if DECLARATIONS[key].type is int else float(value)
        if i % 2 or set(chosen) & set(CONSISTENCY):
            changes["loop.consistency"] = True
        yield changes


def predicted(found: Prediction | None) -> list[tuple[int, int]]:
    assert found is not None
    return [(p.query, p.match) for p in found.accepted]


def predict(study: LoopStudy, changes: Mapping[str, Any]) -> Prediction:
    found = study.predict(changes)
    assert found is not None
    return found


def test_without_changes_everything_is_as_it_was(looping_run: Path) -> None:
    run = RunReader(looping_run)
    found = predict(LoopStudy(run), {})
    was = [(c.loop.keyframe, c.loop.outcome) for c in recorded(run) if c and c.loop]
    assert [(r.keyframe, r.outcome) for r in found.reports] == was
    assert predicted(found) == loops(recorded(run)) != []
    assert found.gained == found.lost == () and found.first_difference is None
    assert found.exact_until == found.reports[-1].keyframe


def test_loop_closing_over_recorded_windows_is_that_of_the_run(feedforward_run: Path) -> None:
    """So that a change can be tried without estimating the odometry again."""
    run = RunReader(feedforward_run)
    for described in (True, False):
        again = close_again(run, run.header.params, described)
        assert [d for a, b in zip(again, recorded(run), strict=True) for d in differences(a, b)] == []


@pytest.mark.parametrize("changes", list(random_changes(8, seed=5)), ids=str)
def test_changed_limits_are_predicted_over_the_whole_run(feedforward_run: Path, changes: dict[str, Any]) -> None:
    run, found = studied(feedforward_run), predict(study_of(feedforward_run), changes)
    would = loops(close_again(run, parameters.replace(run.header.params, changes)))
    assert predicted(found) == would
    assert found.exact_until == found.reports[-1].keyframe
    was = loops(recorded(run))
    assert [(p.query, p.match) for p in found.gained] == [p for p in would if p not in was]
    assert [(p.query, p.match) for p in found.lost] == [p for p in was if p not in would]


@pytest.mark.parametrize(
    "changes",
    [
        {"loop.min_gap": 5},
        {"loop.min_gap": 14, "loop.candidates": 2},
        {"loop.order": "oldest"},
        {"loop.score": "absolute", "loop.min_score": 0.15},
        {"loop.max_ratio": 0.7, "loop.min_inliers": 60},
        {"loop.cross_check": False, "loop.max_hamming": 40},
        {"loop.epipolar": "off", "loop.guided_px": 0.0},
        {"loop.pnp_px": 2.0, "loop.min_inliers": 70},
        {"loop.heading": "euler"},
    ],
    ids=str,
)
def test_what_limits_compare_is_computed_again_where_it_changes(feedforward_run: Path, changes: dict[str, Any]) -> None:
    run = studied(feedforward_run)
    would = loops(close_again(run, parameters.replace(run.header.params, changes)))
    assert predicted(study_of(feedforward_run).predict(changes)) == would


@pytest.mark.parametrize(
    "changes",
    [
        {"loop.every": 2, "loop.min_gap": 4},
        {"loop.skip_first": 7},
        {"loop.min_spacing_m": 0.12, "loop.min_gap": 5, "loop.max_ratio": 0.8},
        {"loop.every": 3, "loop.skip_first": 4, "loop.min_gap": 2, "loop.min_agreement": 1},
    ],
    ids=str,
)
def test_keyframes_may_be_left_out(feedforward_run: Path, changes: dict[str, Any]) -> None:
    run, found = studied(feedforward_run), predict(study_of(feedforward_run), changes)
    would = [c.loop for c in close_again(run, parameters.replace(run.header.params, changes)) if c and c.loop]
    assert [r.outcome for r in found.reports] == [r.outcome for r in would]
    frames = {r.keyframe: r.frame for r in would}
    numbers = {r.frame: r.keyframe for r in found.reports}
    accepted = [(r.frame, frames[r.accepted.match]) for r in would if r.accepted]
    assert accepted and predicted(found) == [(numbers[query], numbers[match]) for query, match in accepted]
    assert len({r.keyframe for r in found.reports}) == len(found.reports) > len(frames)


def test_a_fork_accepts_what_was_predicted(feedforward_run: Path, tmp_path: Path) -> None:
    run, changes = RunReader(feedforward_run), {"loop.max_heading_deg": 21.5}
    found = predict(LoopStudy(run), changes)
    assert found.lost and found.fork_at is not None
    fork(run, found.fork_at, tmp_path / "fork", changes)
    with RunReader(tmp_path / "fork") as other:
        assert loops(recorded(other)) == predicted(found)
        again = zip(close_again(run, other.header.params), recorded(other), strict=True)
        assert [d for a, b in islice(again, found.fork_at, None) for d in differences(a, b)] == []


@pytest.mark.parametrize("changes", [{"loop.max_heading_deg": 27.0}, {"loop.min_inliers": 61}], ids=str)
def test_with_feedback_it_is_exact_up_to_the_first_loop_that_differs(
    looping_run: Path, tmp_path: Path, changes: dict[str, Any]
) -> None:
    run = RunReader(looping_run)
    found = predict(LoopStudy(run), changes)
    first = found.first_difference
    assert first is not None and found.fork_at is not None and found.exact_until == first
    assert found.is_exact(first) and not found.is_exact(first + 1)
    fork(run, found.fork_at, tmp_path / "fork", changes, frames=1)
    with RunReader(tmp_path / "fork") as other:
        assert loops(recorded(other)) == [p for p in predicted(found) if p[0] <= first]
        assert [p for p in loops(recorded(run)) if p[0] <= first] != loops(recorded(other))


def test_changes_from_a_frame_on_leave_what_was_before(looping_run: Path) -> None:
    study = LoopStudy(RunReader(looping_run))
    row = study.rows()[len(study.rows()) // 2 + 5]
    found = study.predict({"loop.min_inliers": 200}, at=row.made_in)
    assert found is not None and found.lost
    assert min(p.query for p in found.lost) >= row.number
    assert max(p.query for p in found.accepted) < row.number


def test_what_only_a_fork_answers_is_said(looping_run: Path) -> None:
    study = LoopStudy(RunReader(looping_run))
    found = predict(study, {"loop.max_corners": 300, "loop.max_heading_deg": 20.0, "pose_graph.loop_weight": 2.0})
    assert found.unanswered == ("loop.max_corners",)
    assert found.exact_until < study.first and found.lost
    assert predict(study, {"frontend.max_cnt": 100}).unanswered == ("frontend.max_cnt",)
    assert predict(study, {"pose_graph.loop_weight": 2.0}).exact_until == found.reports[-1].keyframe


_STUDIES: dict[Path, LoopStudy] = {}


def study_of(path: Path) -> LoopStudy:
    if path not in _STUDIES:
        _STUDIES[path] = LoopStudy(RunReader(path))
    return _STUDIES[path]


def studied(path: Path) -> RunReader:
    return study_of(path).run


@pytest.mark.slow
def test_fifty_random_changes_over_a_lap_and_more(tmp_path: Path) -> None:
    """With 56 loops to win or lose; at least 20 of the changes alter five of them or more."""
    out, settings = tmp_path / "run", ("loop.relocalize=0",)
    run_recording(RECORDING, [CALIBRATION], out=out, settings=settings)
    run = RunReader(out)
    study, was, altered = LoopStudy(run), set(loops(recorded(run))), 0
    for changes in random_changes(50, seed=11):
        would = loops(close_again(run, parameters.replace(run.header.params, changes)))
        assert predicted(study.predict(changes)) == would, changes
        altered += len(was ^ set(would)) >= 5
    assert altered >= 20
    changes = {"loop.min_inliers": 90}
    found = predict(study, changes)
    assert found.fork_at is not None
    fork(run, found.fork_at, tmp_path / "fork", changes)
    assert loops(recorded(RunReader(tmp_path / "fork"))) == predicted(found)
