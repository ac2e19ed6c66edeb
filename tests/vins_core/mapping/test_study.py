"""Loops looked into on demand: what was decided, why, and what it would take to decide otherwise."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from looping import recorded
from same import differences

from vins_core import params as parameters
from vins_core.errors import RunError
from vins_core.loop import gates
from vins_core.mapping.funnel import STAGES
from vins_core.mapping.study import LoopStudy
from vins_core.mapping.truth import Place, Truth
from vins_core.params import DECLARATIONS
from vins_core.record.reader import RunReader
from vins_core.record.writer import RunWriter
from vins_core.report import LoopOutcome


@pytest.fixture(scope="module")
def study(looping_run: Path) -> LoopStudy:
    study = LoopStudy(RunReader(looping_run))
    assert study.advance(10**6) == 0
    return study


def refused(study: LoopStudy) -> list[tuple[int, int]]:
    """Pairs at the same place that were looked at and not accepted."""
    return [
        (report.keyframe, c.match)
        for report in study.judged()
        if report.accepted is None
        for c in report.candidates
        if c.T_match_query is not None
    ]


def test_there_is_a_row_for_every_keyframe_offered(study: LoopStudy) -> None:
    said = [(k, c) for k, c in enumerate(recorded(study.run)) if c and c.loop]
    for row, (k, closure) in zip(study.rows(), said, strict=True):
        loop = closure.loop
        assert loop is not None
        assert (row.number, row.frame, row.made_in, row.t_ns) == (loop.keyframe, loop.frame, k, loop.t_ns)
        assert (row.outcome, row.n_candidates) == (loop.outcome, len(loop.candidates))
        assert row.match == (loop.accepted.match if loop.accepted else -1)


def test_a_report_decides_what_the_run_decided_and_knows_every_gate(study: LoopStudy) -> None:
    for closure in recorded(study.run):
        if closure is None or closure.loop is None or closure.loop.keyframe % 6:
            continue
        was, found = closure.loop, study.report(closure.loop.keyframe)
        assert (found.outcome, found.accepted and found.accepted.match) == (
            was.outcome,
            was.accepted and was.accepted.match,
        )
        assert [c.match for c in found.candidates][: len(was.candidates)] == [c.match for c in was.candidates]
        for c in found.candidates:
            assert {g.name for g in c.gates} >= set(list(gates.MEANING)[9:]) and c.matches is not None
        if was.accepted and found.accepted:
            assert differences(found.accepted, was.accepted) == []
        assert study.report(was.keyframe) is found


def test_a_report_with_other_settings_is_judged_by_them(study: LoopStudy) -> None:
    params = parameters.replace(study.run.header.params, {"loop.min_inliers": 200, "loop.candidates": 2})
    found = study.report(30, params)
    assert found.accepted is None and len(found.candidates) == 2
    assert {g.limit for c in found.candidates for g in c.gates if g.knob == "loop.min_inliers"} == {200.0}


def test_any_pair_can_be_asked_about(study: LoopStudy) -> None:
    proposed = study.report(30)
    again = study.pair(30, proposed.candidates[0].match)
    assert differences(again.candidates[0], proposed.candidates[0]) == []
    never = study.pair(30, 28).candidates[0]
    assert never.outcome is LoopOutcome.TOO_RECENT and never.T_match_query is not None
    truth = study.truth(30, 28)
    assert truth is not None and truth.distance_m == pytest.approx(
        float(np.linalg.norm(never.T_match_query[:3])), abs=0.05
    )
    for query, match in ((5, 5), (5, 6), (10**4, 0), (5, -1)):
        with pytest.raises(IndexError):
            study.pair(query, match)


def test_truth_tells_places_apart() -> None:
    assert Truth(1.0, 30.0).place is Place.SAME
    assert Truth(1.01, 30.0).place is Truth(0.0, 31.0).place is Truth(2.0, 60.0).place is Place.BETWEEN
    assert Truth(2.01, 0.0).place is Truth(0.0, 61.0).place is Place.ELSEWHERE


def test_revisits_are_those_of_the_truth(study: LoopStudy) -> None:
    n, gap = len(study.rows()), study.run.header.params.loop.min_gap
    found = set()
    for query in range(n):
        known = [study.truth(query, match) for match in range(query - gap)]
        if any(t is not None and t.place is Place.SAME for t in known):
            found.add(query)
    assert study.revisits() == found and 10 < len(found) < n - gap


def test_the_funnel_narrows_from_all_keyframes_to_the_loops(study: LoopStudy) -> None:
    found, revisits = study.funnel(), study.revisits()
    assert revisits is not None and tuple(stage.name for stage in found) == STAGES
    assert found[0].count == sum(row.number >= 0 for row in study.rows())
    assert (found[0].same_place, found[0].elsewhere) == (len(revisits), found[0].count - len(revisits))
    assert found[-1].count == sum(row.match >= 0 for row in study.rows())
    for before, after in pairwise(found):
        assert before.count >= after.count
        if before.name not in STAGES[:2]:
            assert (before.same_place or 0) >= (after.same_place or 0)
            assert (before.elsewhere or 0) >= (after.elsewhere or 0)


def test_the_smallest_change_accepts_the_loop_and_nothing_smaller_does(study: LoopStudy) -> None:
    remedies = [study.smallest_change(*pair) for pair in refused(study)]
    found = [r for r in remedies if r is not None and r.accepts]
    assert found
    for remedy in found:
        assert remedy.changes and (remedy.query, remedy.match) not in [(p.query, p.match) for p in remedy.others]
        for key in remedy.changes:
            less = study.predict({k: v for k, v in remedy.changes.items() if k != key})
            assert less is not None
            assert (remedy.query, remedy.match) not in [(p.query, p.match) for p in less.accepted]
        for key, value in remedy.changes.items():
            declared = DECLARATIONS[key]
            assert declared.low is not None and declared.high is not None
            assert declared.low <= value <= declared.high and len(f"{value:g}".replace(".", "").lstrip("0")) <= 6


def test_a_loop_that_was_accepted_needs_no_change(study: LoopStudy) -> None:
    row = next(row for row in study.rows() if row.match >= 0)
    remedy = study.smallest_change(row.number, row.match)
    assert remedy is not None and remedy.changes == {} and remedy.accepts and remedy.others == ()


def test_work_can_be_done_bit_by_bit_and_cancelled(looping_run: Path) -> None:
    study = LoopStudy(RunReader(looping_run))
    n = len(study.rows())
    assert study.judged() == () and study.funnel()[0].count == 0
    assert study.advance(3) == n - 3 and study.funnel()[0].count == 3
    assert study.predict({"loop.min_inliers": 30}, cancelled=lambda: True) is None
    shares: list[float] = []
    assert study.predict({"loop.min_inliers": 30}, progress=shares.append) is not None
    assert shares == sorted(shares) and 0 < len(shares) <= n and study.advance() == 0


def test_a_study_follows_a_run_that_grows(looping_run: Path, study: LoopStudy, tmp_path: Path) -> None:
    run = study.run
    with RunWriter(tmp_path / "run", run.header, run.truth, places=run.places) as writer:
        writer.adopt(run, 50)
        reader = RunReader(tmp_path / "run")
        growing = LoopStudy(reader)
        assert growing.advance(10**6) == 0
        rows = study.rows()
        assert growing.rows() == rows[: len(growing.rows())] and len(growing.rows()) < len(rows)
        for k in range(50, len(run)):
            writer.append(run.report(k), run.timings(k), run.packet(k), run.state(k))
        reader.refresh()
        assert growing.rows() == rows and growing.advance(0) > 0
        assert growing.advance(10**6) == 0 and growing.funnel() == study.funnel()
        assert growing.revisits() == study.revisits()
        assert differences(growing.judged(), study.judged()) == []


def test_threads_do_not_get_in_each_others_way(looping_run: Path, study: LoopStudy) -> None:
    shared = LoopStudy(RunReader(looping_run))

    def ask(i: int) -> object:
        shared.advance(4)
        shared.rows()
        return replace(shared.pair(20 + i % 4, i % 4), candidates=()) if i % 2 else shared.predict({}) and None

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(ask, range(8)))
    shared.advance(10**6)
    assert differences(shared.judged(), study.judged()) == []


def test_a_run_without_loops_has_nothing_to_look_into(sample_run: Path, tmp_path: Path) -> None:
    run = RunReader(sample_run)
    with RunWriter(tmp_path / "run", run.header):
        pass
    with pytest.raises(RunError, match="has no loops: it was made with --loops off"):
        LoopStudy(RunReader(tmp_path / "run"))
