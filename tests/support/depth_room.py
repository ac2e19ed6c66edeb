"""A room seen by a depth camera: one recording, a run of each variant."""

from __future__ import annotations

from pathlib import Path

import pytest

from vins_core.io.write import calibration_path, write_recording
from vins_core.runner import run_recording
from vins_core.simulation.simulate import simulate

VARIANTS = ("trust", "confirm", "hold")
EMBEDDED = "confirm"
"""The run that holds its images."""


@pytest.fixture(scope="session")
def depth_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    simulation = simulate("depth_camera", 3, 2.4)
    out = tmp_path_factory.mktemp("depth") / "room.bag"
    return write_recording(simulation.messages(), out, "ros1", settings=simulation.settings)


@pytest.fixture(scope="session")
def depth_runs(depth_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Run folders of 23 frames by variant; never written to."""
    folder = tmp_path_factory.mktemp("depth_runs")
    for variant in VARIANTS:
        run_recording(
            depth_recording,
            [calibration_path(depth_recording)],
            out=folder / variant,
            settings=[f"depth.variant={variant}", "loop.enabled=0"],
            embed_images=variant == EMBEDDED,
        )
    return {variant: folder / variant for variant in VARIANTS}
