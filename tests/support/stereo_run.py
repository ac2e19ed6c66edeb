"""A short run with two cameras, for what the interface shows of them."""

from __future__ import annotations

from pathlib import Path

from vins_core.io.write import calibration_path, write_recording
from vins_core.runner import run_recording
from vins_core.simulation.simulate import simulate


def stereo_run(folder: Path, duration_s: float = 1.5) -> Path:
    """The simulated room seen by two cameras, without the IMU; its images are in the record."""
    simulation = simulate("stereo", duration_s=duration_s)
    bag = write_recording(simulation.messages(), folder / "room.bag", "ros1", settings=simulation.settings)
    run_recording(bag, [calibration_path(bag)], out=folder / "run", mode="stereo", embed_images=True)
    return folder / "run"
