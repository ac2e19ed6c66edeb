"""`fork`, `compare` and `--params` as a contract: names, outputs, exit codes, one sentence for each mistake."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from sample import CALIBRATION, RECORDING, sample_run

from app.__main__ import main
from vins_core.errors import RunError
from vins_core.record.reader import RunReader

__all__ = ["sample_run"]


def fork(run: Path, out: Path, *arguments: str) -> int:
    return main(["fork", str(run), "--out", str(out), *arguments])


def compared(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict:
    capsys.readouterr()
    assert main(["compare", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_fork_and_what_became_of_it(sample_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changes = ["--set", "window.keyframe_parallax=4", "--set", "window.max_iterations=9"]
    assert fork(sample_run, tmp_path / "fork", "--at", "14", "--frames", "8", *changes) == 0
    assert f"{tmp_path}/fork: 22 frames, 11 poses" in capsys.readouterr().out
    found = compared(capsys, sample_run, tmp_path / "fork")
    assert [p["key"] for p in found["parameters"]] == ["window.keyframe_parallax", "window.max_iterations"]
    assert found["first_difference"]["frame"] >= 14
    assert found["first_difference"]["knob"] in ("window.keyframe_parallax", "window.max_iterations")
    assert found["metrics"][1]["frames"] == 22


def test_a_fork_without_changes_has_no_first_difference(
    sample_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fork(sample_run, tmp_path / "fork", "--at", "20", "--frames", "3") == 0
    found = compared(capsys, sample_run, tmp_path / "fork")
    assert found["first_difference"] is None and found["first_number"] is None
    assert found["parameters"] == [] and found["frames_compared"] == 23


def test_compare_without_json_names_what_differs(
    sample_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fork(sample_run, tmp_path / "fork", "--at", "14", "--frames", "8", "--set", "window.keyframe_parallax=4")
    capsys.readouterr()
    assert main(["compare", str(sample_run), f"{tmp_path}/fork"]) == 0
    out = capsys.readouterr().out
    assert "window.keyframe_parallax  10" in out and "ATE rmse m" in out
    assert "first decision that differs: frame " in out and "px460 < 4 (keyframe)" in out
    assert main(["compare", str(sample_run), str(sample_run)]) == 0
    assert "no decision differs in 36 frames" in capsys.readouterr().out


def test_parameters_come_from_a_file_and_set_wins(
    sample_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "params.yaml").write_text("window:\n  size: 7\n  max_iterations: 5\nfrontend: {min_dist: 20}\n")
    file = ["--params", f"{tmp_path}/params.yaml", "--set", "window.max_iterations=6"]
    calib = ["--calib", str(CALIBRATION), "--duration", "0.5"]
    assert main(["run", str(RECORDING), *calib, "--out", f"{tmp_path}/run", *file]) == 0
    header = RunReader(tmp_path / "run").header
    window, keys = header.params.window, ("window.size", "window.max_iterations", "frontend.min_dist", "frontend.freq")
    assert (window.size, window.max_iterations, header.params.frontend.min_dist) == (7, 6, 20)
    assert [header.origins[k] for k in keys] == ["params", "set", "params", "default"]
    assert fork(sample_run, tmp_path / "fork", "--at", "30", "--frames", "1", *file) == 0
    header = RunReader(tmp_path / "fork").header
    assert header.parent is not None
    assert header.parent.changes == {"window.size": 7, "window.max_iterations": 6, "frontend.min_dist": 20}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--at", "36"], "no frame 36 to fork at"),
        (["--at", "5", "--frames", "0"], "at least 1"),
        (["--at", "5", "--set", "window.size"], "not of the form section.name=value"),
        (["--at", "5", "--set", "window.size=99"], "from 4 to 20"),
        (["--at", "5", "--params", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
    ],
)
def test_a_mistake_gets_one_sentence_and_no_folder(
    sample_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
) -> None:
    assert fork(sample_run, tmp_path / "fork", *arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and len(printed.err.splitlines()) == 1 and sentence in printed.err
    assert not (tmp_path / "fork").exists()


def test_what_is_not_a_run_cannot_be_compared(
    sample_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", str(sample_run), str(tmp_path)]) == 2
    assert "is not a run" in capsys.readouterr().err


def test_a_fork_that_is_interrupted_leaves_its_frames(sample_run: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "app", "fork", str(sample_run), "--at", "2", "--out", f"{tmp_path}/fork"]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while child.poll() is None:
        with contextlib.suppress(RunError):  # not there yet
            if len(RunReader(tmp_path / "fork")) > 4:
                os.kill(child.pid, signal.SIGINT)
                break
    _, error = child.communicate(timeout=60)
    forked = RunReader(tmp_path / "fork")
    assert child.returncode == 130 and "frames so far" in error
    assert 4 < len(forked) <= 36 and forked.outcome == "interrupted"
