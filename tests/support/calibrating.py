"""A short run that has to find its time offset and its extrinsics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from vins_core.io.own_yaml import write
from vins_core.io.write import write_recording
from vins_core.runner import run_recording
from vins_core.simulation.scenarios import SCENARIOS
from vins_core.simulation.simulate import build

TD_S, DURATION_S = 0.020, 4.5


@pytest.fixture(scope="session")
def calibrating_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images stamped 20 ms early by a camera turned by 0.8 degrees, which the run has to find; never written to."""
    folder = tmp_path_factory.mktemp("calibrating")
    rough = replace(SCENARIOS["td_20ms"], believed_rotation_error_deg=(0.5, -0.5, 0.3), believed_extrinsics="refine")
    simulation = build("td_20ms", rough, 1, DURATION_S)
    write_recording(simulation.messages(), folder / "recording", "asl", settings=simulation.settings)
    write(folder / "calibration.yaml", simulation.calibration, simulation.settings.overrides)
    calib, settings = [folder / "calibration.yaml"], ["loop.enabled=off"]
    run_recording(folder / "recording", calib, out=folder / "run", settings=settings, embed_images=True)
    return folder / "run"
