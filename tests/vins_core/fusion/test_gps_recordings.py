"""Fixes of a recording that cannot be part of the project; its folder is named by VINS_DATA."""

import os
from pathlib import Path

import numpy as np
import pytest
from gps_run import final, live, settings

from vins_core import params
from vins_core.evaluation.evaluate import evaluate
from vins_core.fusion.geodesy import EnuFrame
from vins_core.fusion.presets import PRESETS
from vins_core.io.recording import open_recording
from vins_core.io.trajectory import read_trajectory
from vins_core.sensors import Trajectory
from vins_core.simulation.drive import Drive

pytestmark = pytest.mark.skipif("VINS_DATA" not in os.environ, reason="VINS_DATA is not set")


@pytest.fixture(scope="module")
def room() -> tuple[Drive, Trajectory]:
    """VINS-Mono's own trajectory through a room, 15 mm off, and fixes of 0.3 m at 2 Hz."""
    folder = Path(os.environ["VINS_DATA"])
    odometry = read_trajectory(folder / "cpp_baseline" / "sim_room_60s_mono_imu.tum")
    with open_recording(folder / "sim_room_60s") as recording:
        fixes, truth = tuple(recording.gps()), recording.truth()
    assert truth is not None
    T_o_b = np.concatenate([odometry.p_w_b, odometry.q_w_b], 1)
    none, nowhere = np.zeros(len(fixes), bool), (-1, -1)
    return Drive(odometry.t_ns, T_o_b, T_o_b, fixes, none, np.zeros(3), nowhere, EnuFrame.at(fixes[0])), truth


def ate_m(t_ns: np.ndarray, T_e_b: np.ndarray, truth: Trajectory) -> float:
    known = np.isfinite(T_e_b[:, 0])
    result = evaluate(Trajectory(t_ns[known], T_e_b[known, :3], T_e_b[known, 3:]), truth, 0.01).ate_rmse_m
    assert result is not None
    return result


def test_good_odometry_is_not_spoilt_by_worse_fixes(room):
    """VINS-Fusion: from 13 mm to 264 mm (REFERENCE 23.17)."""
    drive, truth = room
    run, (smoothed, _, _) = live(settings(), drive), final(settings(), drive)
    assert drive.t_ns[run.first] - drive.t_ns[0] < 25e9
    assert ate_m(drive.t_ns, run.track.T_e_b, truth) < 0.12
    assert ate_m(drive.t_ns, smoothed.T_e_b, truth) < 0.07
    knowing = settings(position_walk=0.005, yaw_walk_deg=0.01)
    assert ate_m(drive.t_ns, final(knowing, drive)[0].T_e_b, truth) < 0.025


def test_parity_spoils_it_as_vins_fusion_does(room):
    drive, truth = room
    parity = params.replace(params.Params(), PRESETS["parity"]).gps
    assert 0.15 < ate_m(drive.t_ns, final(parity, drive)[0].T_e_b, truth) < 0.4
