"""The beginning of the bundled sample as a run: it initialises at frame 11 and tracks to the end."""

from __future__ import annotations

from pathlib import Path

import pytest

from vins_core.runner import run_recording

FOLDER = Path(__file__).parents[2] / "sample_data"
RECORDING, CALIBRATION = FOLDER / "room_loop.bag", FOLDER / "room_loop.yaml"
DURATION_S, INITIALISED = 3.6, 11


@pytest.fixture(scope="session")
def sample_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 36 frames; never written to."""
    out = tmp_path_factory.mktemp("sample") / "run"
    run_recording(RECORDING, [CALIBRATION], out=out, duration_s=DURATION_S)
    return out
