"""Loop closing where it is hardest: rooms that nothing tells apart, a body without a yaw.  `pytest -m slow`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from vins_core.io.write import write_recording
from vins_core.mapping.study import LoopStudy
from vins_core.mapping.truth import Place
from vins_core.record.reader import RunReader
from vins_core.report import LoopOutcome
from vins_core.runner import run_recording
from vins_core.simulation import simulate

pytestmark = pytest.mark.slow


def study_of(scenario: str, folder: Path) -> LoopStudy:
    simulation = simulate(scenario)
    write_recording(simulation.messages(), folder / "recording", "asl", settings=simulation.settings)
    run_recording(folder / "recording", out=folder / "run")
    study = LoopStudy(RunReader(folder / "run"))
    study.advance(len(study.rows()))
    return study


def test_no_loop_joins_rooms_that_nothing_tells_apart_and_it_is_the_odometry_that_knows(tmp_path: Path) -> None:
    study = study_of("twin_rooms", tmp_path)
    candidates = [c for r in study.judged() for c in r.candidates]
    places = {(c.query, c.match): truth.place for c in candidates if (truth := study.truth(c.query, c.match))}
    accepted = Counter(places[c.query, c.match] for c in candidates if c.accepted)
    assert accepted[Place.ELSEWHERE] == 0 and accepted[Place.SAME] > 100

    look_the_same = [
        c
        for c in candidates
        if places[c.query, c.match] is Place.ELSEWHERE
        and c.outcome is not LoopOutcome.NOT_CHOSEN  # a true loop was accepted before its turn came
        and all(g.passed for g in c.gates if g.decides and g.name not in ("drift", "agreement"))
    ]
    assert len(look_the_same) > 200
    assert all(c.outcome is LoopOutcome.INCONSISTENT for c in look_the_same)
    drift = [g for c in look_the_same for g in c.gates if g.name == "drift"]
    assert min(g.value for g in drift if g.value is not None) > 5 * drift[0].limit  # and not by a hair
    agreeing = [g for c in look_the_same for g in c.gates if g.name == "agreement"]
    assert not any(g.value for g in agreeing)  # what the bound refuses confirms nothing

    without = study.predict({"loop.consistency": False})
    assert without is not None and without.count(without.accepted, Place.ELSEWHERE) > 50


def test_a_level_camera_loses_no_loop_to_its_heading_as_it_would_to_its_euler_yaw(tmp_path: Path) -> None:
    study = study_of("level_camera", tmp_path)
    revisits, reports = study.revisits(), study.judged()
    assert revisits is not None
    closed = {r.keyframe for r in reports if r.accepted}
    assert len(closed & revisits) > 0.9 * len(revisits)
    for c in (c for r in reports for c in r.candidates):
        truth = study.truth(c.query, c.match)
        if truth and truth.place is Place.SAME:
            assert c.outcome not in (LoopOutcome.HEADING, LoopOutcome.INCONSISTENT, LoopOutcome.UNCONFIRMED)
        if c.accepted:
            assert truth and truth.place is not Place.ELSEWHERE
    euler = study.predict({"loop.heading": "euler", "loop.max_heading_deg": 30.0})
    assert euler is not None and len(euler.lost) > 0.25 * len(closed)
