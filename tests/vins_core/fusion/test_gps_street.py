"""The street scenario as it is, in every mode that can drive it; and a room with its fixes, from VINS_DATA."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from street import on_earth, verdicts

from vins_core.evaluation.evaluate import evaluate, run_trajectory
from vins_core.fusion.conclusion import final_track, global_trajectory
from vins_core.io.modes import Mode
from vins_core.io.write import calibration_path, write_recording
from vins_core.record.reader import RunReader
from vins_core.report import FixVerdict, GpsStatus
from vins_core.runner import run_recording
from vins_core.simulation.simulate import Simulation, simulate

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def drive() -> Simulation:
    return simulate("street_gps")


@pytest.fixture(scope="module")
def recording(drive: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("recording") / "street.bag"
    return write_recording(drive.messages(), out, "ros1", settings=drive.settings)


@pytest.mark.parametrize("mode", ["stereo_imu", "stereo", "mono_imu"])
def test_it_stays_right_on_the_earth(drive: Simulation, recording: Path, mode: Mode, tmp_path: Path) -> None:
    run_recording(
        recording, [calibration_path(recording)], out=tmp_path / "run", mode=mode, settings=["loop.enabled=off"]
    )
    run = RunReader(tmp_path / "run")
    final, live = final_track(run), global_trajectory(run, live=True)
    assert run.truth is not None and final.origin is not None and not final.notes
    error = np.linalg.norm((final.T_e_b[:, :3] - on_earth(run.truth, final.t_ns, final.origin))[:, :2], axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.4 and error.max() < 1.0
    error = np.linalg.norm((live.p_w_b - on_earth(run.truth, live.t_ns, final.origin))[:, :2], axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.5 and error.max() < 1.2
    assert (live.t_ns[0] - run.summaries[0].t_ns) * 1e-9 < 11

    outliers = {fix.t_ns for fix, outlier in zip(drive.fixes, drive.outlier) if outlier}
    for used in ({t for t, v in verdicts(run).items() if v is FixVerdict.USED}, set(final.fix_t_ns[final.fix_used])):
        assert not outliers & used
        assert len(used) >= 0.97 * (len(final.fix_t_ns) - len(outliers & set(final.fix_t_ns))) - 1
    outage = max(s.gps.outage_s for s in run.summaries if s.gps and s.gps.status is GpsStatus.FUSING)
    assert outage == pytest.approx(5.0, abs=0.4)


@pytest.mark.skipif("VINS_DATA" not in os.environ, reason="VINS_DATA is not set")
def test_a_room_with_fixes_worse_than_the_odometry(tmp_path: Path) -> None:
    """9 m across, 0.3 m noise at 2 Hz; antenna and body are one in that simulation, which a user has to say."""
    folder = Path(os.environ["VINS_DATA"]) / "sim_room_60s"
    settings = ["gps.lever_arm=off", "loop.enabled=off"]
    run_recording(folder, [folder / "vins_mono.yaml"], out=tmp_path / "run", settings=settings)
    run = RunReader(tmp_path / "run")
    assert run.truth is not None
    ate = {
        name: evaluate(path, run.truth, 0.006).ate_rmse_m
        for name, path in {
            "odometry": run_trajectory(run.summaries),
            "final": global_trajectory(run),
            "live": global_trajectory(run, live=True),
        }.items()
    }
    assert ate["odometry"] < 0.03 and ate["final"] < 0.08 and ate["live"] < 0.15
    assert sum(v is FixVerdict.GATED for v in verdicts(run).values()) <= 3
