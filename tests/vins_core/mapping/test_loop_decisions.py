"""Two runs that close loops differently: the first decision that differs is named with its gate and parameter."""

from __future__ import annotations

from pathlib import Path

import pytest

from vins_core.record.compare import compare
from vins_core.record.fork import fork
from vins_core.record.reader import RunReader

AT = 45


@pytest.mark.parametrize(
    ("changes", "stage", "gate", "cause"),
    [
        ({"loop.max_heading_deg": 8.0}, "loop", "heading", "limit"),
        ({"loop.min_inliers": 200}, "loop", "pose inliers", "limit"),
        ({"loop.min_score_ratio": 0.9}, "loop", "score", "limit"),
        ({"loop.every": 4}, "loop", "every", "limit"),
        ({"loop.candidates": 2}, "loop", "candidates", ""),
        ({"loop.relocalize": 0}, "solve", "loops in the window", ""),
    ],
    ids=str,
)
def test_a_changed_parameter_is_named_as_the_cause(
    looping_run: Path, tmp_path: Path, changes: dict, stage: str, gate: str, cause: str
) -> None:
    with RunReader(looping_run) as run:
        fork(run, AT, tmp_path / "fork", changes, frames=8)
        with RunReader(tmp_path / "fork") as other:
            found = compare(run, other)
    assert {s.key for s in found.parameters} <= changes.keys()
    first = found.first_difference
    assert first is not None and first.frame >= AT
    assert (first.stage, first.gate, first.cause, first.knob) == (stage, gate, cause, next(iter(changes)))
    assert found.first_number is None


def test_agreement_that_is_asked_for_is_told(looping_run: Path, tmp_path: Path) -> None:
    with RunReader(looping_run) as run:
        fork(run, AT, tmp_path / "fork", {"loop.min_agreement": 20, "loop.sure_drift": 0.0}, frames=1)
        with RunReader(tmp_path / "fork") as other:
            first = compare(run, other).first_difference
    assert first is not None and (first.gate, first.knob) == ("agreement", "loop.min_agreement")


def test_loops_switched_off_are_told(looping_run: Path, tmp_path: Path) -> None:
    with RunReader(looping_run) as run:
        fork(run, AT, tmp_path / "fork", {"loop.enabled": False, "loop.relocalize": 0}, frames=1)
        with RunReader(tmp_path / "fork") as other:
            assert other.report(AT).closure is None
            first = compare(run, other).first_difference
    assert first is not None and first.frame == AT and first.knob in ("loop.enabled", "loop.relocalize")


def test_a_fork_without_changes_decides_the_same(looping_run: Path, tmp_path: Path) -> None:
    with RunReader(looping_run) as run:
        fork(run, AT, tmp_path / "fork", {}, frames=8)
        with RunReader(tmp_path / "fork") as other:
            found = compare(run, other)
    assert found.first_difference is None and found.first_number is None
