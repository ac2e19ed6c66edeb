"""GPS on the command line: what `info` says of it, and the trajectories on the earth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.__main__ import main
from vins_core.fusion.conclusion import final_track
from vins_core.io.trajectory import read_trajectory
from vins_core.io.write import calibration_path
from vins_core.record.reader import RunReader


def evaluated(run: Path, trajectory: str, capsys: pytest.CaptureFixture[str]) -> dict[str, float]:
    assert main(["eval", str(run), "--trajectory", trajectory, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_eval_judges_the_final_and_the_live_trajectory(street_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    odometry, final, live = (evaluated(street_run, name, capsys) for name in ("odometry", "global", "global_live"))
    assert final["poses"] == odometry["poses"] > live["poses"] > 12
    assert max(final["ate_rmse_m"], live["ate_rmse_m"]) < 0.1


def test_export_writes_metres_east_north_and_up(street_run: Path, tmp_path: Path) -> None:
    assert main(["export", str(street_run), "--tum", f"{tmp_path}/g.tum", "--trajectory", "global"]) == 0
    written, final = read_trajectory(tmp_path / "g.tum"), final_track(RunReader(street_run))
    np.testing.assert_allclose(written.p_w_b, final.T_e_b[:, :3], atol=1e-6)
    np.testing.assert_allclose(written.t_ns, final.t_ns, atol=1000)


@pytest.mark.parametrize("trajectory", ["global", "global_live"])
def test_a_run_without_fixes_says_so(
    sample_run: Path, trajectory: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(sample_run), "--tum", f"{tmp_path}/x", "--trajectory", trajectory]) == 2
    assert "has no GPS fusion: its recording has no fixes" in capsys.readouterr().err


def test_info_says_whether_fixes_can_be_fused(
    street_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = calibration_path(street_recording)
    assert main(["info", str(street_recording), "--calib", str(own)]) == 0
    assert "GPS: fixes of /gps0 are fused, from an antenna at (0.6, 0, 0.8) m" in capsys.readouterr().out
    bare = tmp_path / "bare.yaml"
    bare.write_text("\n".join(line for line in own.read_text().splitlines() if "p_b_gps" not in line))
    assert main(["info", str(street_recording), "--calib", str(bare), "--json"]) == 0
    assert "does not say where the antenna is" in json.loads(capsys.readouterr().out)["gps"]
    assert main(["info", str(street_recording), "--json"]) == 0
    assert "a calibration tells" in json.loads(capsys.readouterr().out)["gps"]
