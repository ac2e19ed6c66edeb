"""GPS fusion in a run: each pose of the odometry, and the fixes that came with it, go to step.py.

The odometry goes by itself.  Fixes never reach the window, and corrections by loops never reach the fusion, whose model
is an error that grows along the way: a loop would make it jump.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import params
from ..clock import stopwatch
from ..report import FrameReport, Timings
from ..sensors import Calibration, Packet
from .available import antenna, settings_of, time_of
from .state import GpsState, OdometryPose, restart
from .step import step


def fuse(
    settings: params.Gps,
    calibration: Calibration,
    state: GpsState | None,
    packet: Packet,
    report: FrameReport,
    ms: Timings,
) -> tuple[GpsState | None, FrameReport]:
    """A frame of the run, with what GPS makes of its pose; frames without a pose leave the state alone.

    Switched off and on again it begins anew, but for the origin: the frames between are not known.
    """
    if not settings.enabled:
        return restart(state) if state else None, report
    p_b_gps = antenna(settings, calibration)
    if not calibration.gps_topic or p_b_gps is None or report.pose is None:
        return state, report
    T_o_b = np.concatenate([report.pose.p_w_b, report.pose.q_w_b])
    frame = OdometryPose(time_of(calibration, report.t_ns, report.pose), T_o_b)
    if state and state.recent and frame.t_ns <= state.recent[-1].t_ns:
        state = restart(state)  # the time offset was corrected by more than a frame
    with stopwatch(ms, "gps"):
        state, found = step(settings_of(settings, calibration), p_b_gps, state or GpsState(), frame, packet.gps)
    return state, replace(report, gps=replace(found, arrived=packet.gps))
