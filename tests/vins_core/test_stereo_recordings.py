"""Two cameras on real recordings, which `VINS_DATA` names the folder of."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from vins_core.record.reader import RunReader
from vins_core.runner import run_recording
from vins_core.sensors import Trajectory

DATA = Path(os.environ.get("VINS_DATA", ""))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (DATA / "kitti_0009").is_dir(), reason="VINS_DATA names no folder with kitti_0009"),
]


def path_length_errors(t_ns: np.ndarray, p: np.ndarray, truth: Trajectory, at_least_m: float) -> np.ndarray:
    """Relative errors of the lengths of all sub-paths of `at_least_m` and more."""
    true_p = np.stack([np.interp(t_ns, truth.t_ns, axis) for axis in truth.p_w_b.T], 1)
    ours, theirs = (np.append(0, np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))) for x in (p, true_p))
    i, j = np.triu_indices(len(t_ns), 1)
    true_m = theirs[j] - theirs[i]
    return np.abs((ours[j] - ours[i]) / true_m - 1)[true_m >= at_least_m]


def test_a_car_drives_as_far_as_it_drove(tmp_path: Path) -> None:
    """KITTI without an IMU worth the name: VINS-Fusion is 1.1 % off."""
    run_recording(DATA / "kitti_0009", out=tmp_path / "run")
    run = RunReader(tmp_path / "run")
    assert run.header.mode == "stereo" and run.truth is not None
    posed = [s for s in run.summaries if s.pose is not None]
    assert len(posed) >= 49
    errors = path_length_errors(
        np.array([s.t_ns for s in posed]), np.array([s.pose.p_w_b for s in posed]), run.truth, 20.0
    )
    assert len(errors) > 100 and errors.mean() < 0.011
