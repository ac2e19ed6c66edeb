"""Loops and maps on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from looping import SETTINGS
from sample import CALIBRATION, RECORDING

from app.__main__ import main
from vins_core.io.trajectory import read_trajectory
from vins_core.record.reader import RunReader


@pytest.fixture(scope="module")
def saved(looping_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map, saved by the command under test."""
    folder = tmp_path_factory.mktemp("cli_map") / "map"
    assert main(["map", "save", str(looping_run), str(folder)]) == 0
    return folder


def said(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The sentence with which a command refuses."""
    capsys.readouterr()
    assert main(arguments) == 2
    return capsys.readouterr().err


def test_loops_prints_json_of_every_candidate(looping_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["loops", str(looping_run), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    rows, run = found["candidates"], RunReader(looping_run)
    accepted = {(row["query"], row["match"]) for row in rows if row["accepted"]}
    closures = [s.closure for s in run.summaries if s.closure and s.closure.match >= 0]
    assert accepted == {(c.keyframe.number, c.match) for c in closures if c.keyframe} != set()
    for row in rows:
        assert row["accepted"] == (row["outcome"] == "accepted") and row["place"] in (
            "same place",
            "between",
            "elsewhere",
        )
        assert run.keyframes[row["match"]].frame == row["match_frame"]
        for gate in row["gates"]:
            assert set(gate) >= {"name", "value", "op", "limit", "knob", "passed"}
        assert all(gate["passed"] for gate in row["gates"]) or not row["accepted"]
        if not row["accepted"] and row["outcome"] != "others were preferred":
            assert not all(gate["passed"] for gate in row["gates"])
    assert [stage["name"] for stage in found["funnel"]][::9] == ["queried", "accepted"]
    assert sum(k["match"] >= 0 for k in found["keyframes"]) == len(accepted)


def test_loops_prints_the_funnel_and_a_line_a_keyframe(looping_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["loops", str(looping_run)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["keyframes", "all", "same", "place", "elsewhere"]
    assert any("that truly revisit a place close a loop" in line for line in lines)
    assert any(line.endswith("accepted") for line in lines)
    assert any("heading" in line and "not <= 35" in line for line in lines)


def test_the_optimised_trajectory_is_evaluated_and_exported(
    looping_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = {}
    for choice in ("odometry", "optimized"):
        assert main(["eval", str(looping_run), "--json", "--trajectory", choice]) == 0
        found[choice] = json.loads(capsys.readouterr().out)
    run = RunReader(looping_run)
    assert found["odometry"]["poses"] == sum(s.pose is not None for s in run.summaries)
    assert found["optimized"]["poses"] == len(run.keyframes) < found["odometry"]["poses"]
    assert found["optimized"]["ate_rmse_m"] < 0.03
    assert main(["export", str(looping_run), "--tum", f"{tmp_path}/o.tum", "--trajectory", "optimized"]) == 0
    assert np.array_equal(read_trajectory(tmp_path / "o.tum").t_ns, [k.t_ns for k in run.keyframes])


def test_a_map_says_what_it_holds(saved: Path, looping_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["map", "load", str(saved)]) == 0
    text = capsys.readouterr().out
    assert f"{len(RunReader(looping_run).keyframes)} keyframes in 1 sessions" in text
    assert "pinhole-radtan, 376x240" in text and "words for 'orb-upright' descriptors" in text


def test_a_recording_goes_on_in_a_map(saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    load = ["map", "load", str(saved), str(RECORDING), "--calib", str(CALIBRATION)]
    assert "say where it goes with --out RUN" in said(load, capsys)
    out = tmp_path / "run"
    assert main([*load, "--out", str(out), "--start", "4", "--duration", "2.5", "--set", SETTINGS[0]]) == 0
    run = RunReader(out)
    assert run.places is not None and len(run.places.keyframes) > 0
    assert any(s.closure and 0 <= s.closure.match < len(run.places.keyframes) for s in run.summaries)


def test_loops_can_be_switched_off(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["run", str(RECORDING), "--calib", str(CALIBRATION), "--duration", "0.5", "--out"]
    assert main([*base, f"{tmp_path}/off", "--loops", "off"]) == 0
    assert main([*base, f"{tmp_path}/on", "--loops", "on", "--set", "loop.enabled=off"]) == 0
    off, on = RunReader(tmp_path / "off"), RunReader(tmp_path / "on")
    assert not off.header.params.loop.enabled and off.places is None
    assert on.header.params.loop.enabled and on.places is not None
    for arguments in (["loops"], ["eval", "--trajectory", "optimized"], ["map", "save"]):
        extra = [f"{tmp_path}/map"] if arguments[0] == "map" else []
        assert "has no loops: it was made with --loops off" in said([*arguments, f"{tmp_path}/off", *extra], capsys)


def test_what_contradicts_itself_is_told_before_a_run_begins(
    saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = ["run", str(RECORDING), "--calib", str(CALIBRATION), "--out", f"{tmp_path}/run"]
    words = tmp_path / "words.bin"
    words.write_bytes(b"no vocabulary")
    for extra, sentence in (
        (["--map", str(saved), "--loops", "off"], "loops, which are off"),
        (["--map", str(saved), "--vocabulary", str(words)], "a map brings its own vocabulary"),
        (["--brief-pattern", str(words)], "a BRIEF pattern belongs to a vocabulary"),
        (["--vocabulary", str(words)], "expected a vocabulary like brief_k10L6.bin"),
        (["--map", str(tmp_path)], "is not a map"),
    ):
        assert sentence in said([*base, *extra], capsys)
        assert not (tmp_path / "run").exists()
