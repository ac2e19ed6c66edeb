"""When and how a run tries to initialise: with one camera, two, depth, or without IMU; unknown rotations first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..params import Params
from ..report import FrameReport, HandEyeReport, InitReport, Status
from ..sensors import Calibration
from ..state import RunState
from ..window import online
from ..window.propagate import continue_from
from ..window.state import WindowState
from ..window.timing import referred_to
from . import hand_eye, stereo
from .step import initialize
from .time_offset import AGREES_S


def attempt(
    params: Params, calibration: Calibration, state: RunState, report: FrameReport
) -> tuple[RunState, FrameReport]:
    """One attempt, if it is time for another; the state with the initialised window, tracking, if it succeeds."""
    state, report = replace(state, status=Status.INITIALIZING), replace(report, status=Status.INITIALIZING)
    last = state.last_attempt_ns
    if last is not None and report.t_ns - last < params.init.retry_s * 1e9:
        return state, report
    window, said = _turned(params, calibration, state, report.hand_eye)
    state, report = replace(state, last_attempt_ns=report.t_ns), replace(report, initialization=said)
    if window is None:
        return state, report
    window = online.believe(params.online, window)
    if state.resume is not None:
        window = continue_from(window, state.resume)
    return replace(state, window=window, status=Status.TRACKING, history=(), resume=None, hand_eye=None), report


def _turned(
    params: Params, calibration: Calibration, state: RunState, rotation: HandEyeReport | None
) -> tuple[WindowState | None, InitReport]:
    """Where the extrinsic rotation is to be found, only once it is."""
    if rotation is None:
        return _timed(params, calibration, state)
    stage = hand_eye.stage(rotation)
    if not stage.passed:
        return None, InitReport((stage,), False, -1, None, None, rotation.b_g)
    window, said = _timed(params, calibration, state)
    return window, replace(said, stages=(stage, *said.stages))


def _timed(params: Params, calibration: Calibration, state: RunState) -> tuple[WindowState | None, InitReport]:
    """With the time offset as given; where the rotations tell another one, again with that."""
    if not calibration.has_imu:
        return stereo.begin(params, state.window)
    window, report = _at(params, calibration, state, state.window.td_s)
    if report.td_s is None or abs(report.td_s - state.window.td_s) < AGREES_S:
        return window, report
    return _at(params, calibration, state, report.td_s)


def _at(
    params: Params, calibration: Calibration, state: RunState, td_s: float
) -> tuple[WindowState | None, InitReport]:
    """With the rays as they were at the times of the poses if the time offset is `td_s`."""
    frames, history = (tuple(referred_to(f, td_s) for f in part) for part in (state.window.frames, state.history))
    window = replace(state.window, frames=frames, td_s=td_s)
    if len(calibration.cameras) > 1 or calibration.cameras[0].depth:
        return stereo.initialize(params, calibration, window)
    return initialize(params, calibration, window, history)


def find_rotation(params: Params, calibration: Calibration, state: RunState) -> tuple[RunState, HandEyeReport | None]:
    """Another attempt at the unknown rotation, with how camera and gyroscope turned since the frame before."""
    assert state.hand_eye is not None
    if len(state.history) < 2:
        return state, None
    found, report = hand_eye.calibrate(params.init, state.hand_eye, *state.history[-2:])
    mounted = hand_eye.mount(np.array([c.T_b_c for c in calibration.cameras]), found.R_b_c)
    return replace(state, hand_eye=found, window=replace(state.window, T_b_c=mounted)), report
