"""What the command line tells of a calibration that was found."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from calibrating import TD_S

from app.__main__ import main


def test_eval_tells_what_the_calibration_came_to(calibrating_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", str(calibrating_run)]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, unit in (("td", "ms"), ("cam0 moved by", "cm"), ("cam0 turned by", "deg")):
        (line,) = (text for text in lines if text.strip().startswith(f"{name} "))
        assert f" {unit} (sigma " in line


def test_the_same_in_json(calibrating_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", str(calibrating_run), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["calibration"]
    assert found["td"]["unit"] == "ms" and found["td"]["value"][0] == pytest.approx(1e3 * TD_S, abs=1.0)
    assert len(found["cam0 turned by"]["value"]) == len(found["cam0 turned by"]["sigma"]) == 3


def test_a_run_that_takes_its_calibration_as_given_tells_nothing_of_it(
    sample_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["eval", str(sample_run), "--json"]) == 0
    assert "calibration" not in json.loads(capsys.readouterr().out)
