"""The street scenario with a receiver that is good enough for a drive of a few seconds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vins_core.fusion.geodesy import EnuFrame
from vins_core.io.write import calibration_path, write_recording
from vins_core.record.reader import RunReader
from vins_core.report import FixVerdict
from vins_core.runner import run_recording
from vins_core.sensors import Trajectory
from vins_core.simulation.receiver import START
from vins_core.simulation.scenarios import SCENARIOS
from vins_core.simulation.simulate import Simulation, build

DURATION_S = 4.8
SETTINGS = ["loop.enabled=off", "gps.max_yaw_sigma_deg=2"]  # metres show no more


def short_drive() -> Simulation:
    """Fixes of 3 cm, so that a few metres show the heading; some of them are 10 m off, and half a second has none."""
    scenario = SCENARIOS["street_gps"]
    assert scenario.gps is not None
    receiver = replace(scenario.gps, rate_hz=10.0, sigma_m=(0.03, 0.03, 0.05), outlier_share=0.3, outage_s=(3.6, 4.1))
    return build("street_gps", replace(scenario, gps=receiver), 1, DURATION_S)


@pytest.fixture(scope="session")
def street_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    drive = short_drive()
    out = tmp_path_factory.mktemp("street") / "street.bag"
    return write_recording(drive.messages(), out, "ros1", settings=drive.settings)


@pytest.fixture(scope="session")
def street_run(street_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 46 frames with two cameras, IMU and GPS; never written to."""
    out = tmp_path_factory.mktemp("street") / "run"
    result = run_recording(street_recording, [calibration_path(street_recording)], out=out, settings=SETTINGS)
    assert not any("GPS" in note for note in result.notes)
    return out


def on_earth(truth: Trajectory, t_ns: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """(n, 3) true positions in the ENU frame at `origin`; the stamps are those of truth."""
    rows = np.searchsorted(truth.t_ns, t_ns)
    np.testing.assert_array_equal(truth.t_ns[rows], t_ns)
    return EnuFrame(*origin.tolist()).from_geodetic(*START.to_geodetic(truth.p_w_b[rows]))


def verdicts(run: RunReader) -> dict[int, FixVerdict]:
    """Of every fix, as it stands at the end."""
    found = [s.gps for s in run.summaries if s.gps is not None]
    return {f.t_ns: f.verdict for gps in found for f in (*gps.fixes, *gps.revised)}
