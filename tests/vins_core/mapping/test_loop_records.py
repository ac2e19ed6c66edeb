"""Loops in a record: every frame goes on bit for bit, accidents are told, and forgeries do no harm."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from looping import recorded
from same import differences

from vins_core.errors import VinspectError
from vins_core.mapping.study import LoopStudy
from vins_core.record.codec import pack
from vins_core.record.folder import MAP
from vins_core.record.fork import fork
from vins_core.record.reader import RunReader
from vins_core.record.writer import state_sections


def test_a_fork_without_changes_is_the_run_bit_for_bit(looping_run: Path, tmp_path: Path) -> None:
    run = RunReader(looping_run)
    at = next(s.frame for s in run.summaries if s.closure and s.closure.match >= 0) - 2
    fork(run, at, tmp_path / "fork", {})
    other = RunReader(tmp_path / "fork")
    assert len(other) == len(run) and other.outcome == "finished"
    for k in range(len(run)):
        assert differences(other.report(k), run.report(k)) == []
        assert differences(state_sections(other.state(k)), state_sections(run.state(k))) == []
    assert len(other.keyframes) == len(run.keyframes) > 30
    assert [d for a, b in zip(other.keyframes, run.keyframes) for d in differences(a, b)] == []


def test_a_frame_knows_its_map_whichever_frame_is_asked_for_first(looping_run: Path) -> None:
    forwards, backwards = RunReader(looping_run), RunReader(looping_run)
    n = len(forwards)
    states = {k: pack(state_sections(backwards.state(k))) for k in reversed(range(0, n, 7))}
    for k, packed in states.items():
        assert packed == pack(state_sections(forwards.state(k)))


def test_keyframes_and_edges_of_the_last_state_are_all_that_the_frames_said(looping_run: Path) -> None:
    run = RunReader(looping_run)
    said = [c for c in recorded(run) if c]
    closure = run.state(len(run) - 1).closure
    assert closure is not None
    entries = [c.keyframe for c in said if c.keyframe]
    assert [e.number for e in entries] == list(range(len(closure.graph)))
    np.testing.assert_array_equal(closure.graph.T_vio, [e.T_vio for e in entries])
    edges = [e for c in said for e in c.edges]
    np.testing.assert_array_equal(closure.graph.loops, [(e.earlier, e.later) for e in edges])
    np.testing.assert_array_equal(closure.graph.T_loops, [e.T_i_j for e in edges])
    accepted = {(c.loop.accepted.match, c.loop.accepted.query) for c in said if c.loop and c.loop.accepted}
    waiting = {(p.edge.earlier, p.edge.later) for p in closure.pending}
    assert accepted == waiting | {(e.earlier, e.later) for e in edges}


# -- damage ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def damaged(looping_run: Path, tmp_path: Path) -> Path:
    """A copy to be damaged."""
    shutil.copytree(looping_run, tmp_path / "run")
    return tmp_path / "run"


def readings(path: Path) -> dict[str, str]:
    """A hash of what loops need of a record, or the sentence that says why it cannot be read."""
    found: dict[str, str] = {}

    def read(name: str, what: Callable[[], bytes]) -> None:
        try:
            found[name] = hashlib.sha256(what()).hexdigest()
        except VinspectError as problem:
            assert str(path) in str(problem), "an error names its file"
            found[name] = f"refused: {problem}"

    with RunReader(path) as run:
        last = len(run) - 1
        for k in (0, 30, last):
            read(f"state {k}", lambda k=k: pack(state_sections(run.state(k))))  # type: ignore[misc]
        for k in (0, 5):
            read(f"keyframe {k}", lambda k=k: pack({"keyframe": run.keyframes[k]}))  # type: ignore[misc]
        read("study", lambda: repr(LoopStudy(run).pair(20, 5).outcome).encode())
    return found


def accident(data: bytes, rng: np.random.Generator) -> bytes:
    at, n = int(rng.integers(len(data))), int(rng.integers(1, 100))
    return (
        data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :],
        data[:at] + rng.bytes(n) + data[at + n :],
        data[:at] + data[at + n :],
        data[:at],
    )[rng.integers(4)]


def test_an_accident_to_the_map_is_told(damaged: Path) -> None:
    whole, files = readings(damaged), sorted((damaged / MAP).iterdir())
    assert not any(value.startswith("refused") for value in whole.values()) and len(files) == 3
    told = 0
    for seed in range(30):
        rng, file = np.random.default_rng(seed), files[seed % len(files)]
        original = file.read_bytes()
        file.write_bytes(accident(original, rng))
        found = readings(damaged)
        file.write_bytes(original)
        assert all(found[what] == value or found[what].startswith("refused") for what, value in whole.items())
        told += found != whole
    assert told > 20


def test_a_forged_map_is_refused_or_does_no_harm(damaged: Path) -> None:
    header = damaged / MAP / "map.json"
    document = json.loads(header.read_text())
    for seed in range(30):
        rng = np.random.default_rng(seed)
        part = list(document["parts"].values())[seed % len(document["parts"])]
        file = damaged / MAP / part["file"]
        original = file.read_bytes()
        forged = accident(original, rng)
        file.write_bytes(forged)
        lie = {**part, "bytes": len(forged), "sha256": hashlib.sha256(forged).hexdigest()}
        parts = {name: lie if p == part else p for name, p in document["parts"].items()}
        header.write_text(json.dumps({**document, "parts": parts}))
        readings(damaged)
        file.write_bytes(original)
    header.write_text(json.dumps(document))
    assert not any(value.startswith("refused") for value in readings(damaged).values())


def test_a_run_without_its_map_can_still_be_looked_at(damaged: Path) -> None:
    shutil.rmtree(damaged / MAP)
    with RunReader(damaged) as run:
        assert run.report(50).closure is not None and run.summaries[50].closure is not None
        with pytest.raises(VinspectError, match="lacks its folder map, which its loops need; copy the whole folder"):
            run.state(50)
        with pytest.raises(VinspectError, match="has no loops"):
            LoopStudy(run)
