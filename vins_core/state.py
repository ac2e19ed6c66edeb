"""What a run carries from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .frontend.state import TrackerState
from .fusion.state import GpsState
from .fusion.state import restart as restart_gps
from .initialization.hand_eye import HandEye
from .mapping import closure as mapping
from .mapping.closure import Closure
from .mapping.places import Places
from .report import PoseEstimate, Status
from .sensors import Calibration
from .window.slide import drop_oldest, drop_second_newest
from .window.state import Landmarks, WindowFrame, WindowState


@dataclass(frozen=True)
class RunState:
    """Everything a run carries from frame to frame."""

    tracker: TrackerState
    window: WindowState
    status: Status
    history: tuple[WindowFrame, ...] = field(default=())
    """While initialising: every frame since the oldest of the window, kept or not (VINS' all_image_frame), each with
    the pre-integration from the frame just before it in time; empty once tracking."""
    last_attempt_ns: int | None = None
    rejected_ids: tuple[int, ...] = ()
    """Tracks the estimator rejected in this frame as outliers; the tracker drops them in the next one."""
    behind_ids: tuple[int, ...] = ()
    """Likewise, because their depth came out negative."""
    resume: PoseEstimate | None = None
    """After a restart: the last healthy pose, which the next initialisation starts from."""
    closure: Closure | None = None
    """What loop closing carries; None where loops are not closed."""
    gps: GpsState | None = None
    """What GPS fusion carries; None before the first pose, and where no fixes are fused."""
    hand_eye: HandEye | None = None
    """While unknown extrinsics keep it from initialising: what is known of them by now."""


def start(calibration: Calibration, places: Places | None = None) -> RunState:
    """The state before the first packet; loops are closed only with `places`."""
    state = RunState(TrackerState.empty(), empty_window(calibration), Status.FILLING)
    if calibration.extrinsics == "unknown" and calibration.has_imu:
        state = replace(state, hand_eye=HandEye())
    return state if places is None else replace(state, closure=mapping.begin(places))


def empty_window(calibration: Calibration) -> WindowState:
    T_b_c = np.array([c.T_b_c for c in calibration.cameras])
    return WindowState((), Landmarks.empty(), None, T_b_c, calibration.has_imu, calibration.td_of(0))


def forget(calibration: Calibration, state: RunState, is_keyframe: bool) -> RunState:
    """Slide without estimates: the oldest frame is dropped, or the one before the newest; without IMU, the only one."""
    if not state.window.inertial:
        return replace(state, window=empty_window(calibration), history=())
    window = drop_oldest(state.window) if is_keyframe else drop_second_newest(state.window, calibration.noise)
    first, *rest = (f for f in state.history if f.frame >= window.frames[0].frame)
    return replace(state, window=window, history=(replace(first, imu=None), *rest))


def restart(calibration: Calibration, state: RunState, last_healthy: PoseEstimate | None) -> RunState:
    """Forget window and prior, keep the tracks, remember where to continue (SPEC 5.4, unlike REFERENCE F7)."""
    closure = mapping.interrupt(state.closure) if state.closure else None
    gps = restart_gps(state.gps) if state.gps else None
    window = empty_window(calibration)
    if calibration.extrinsics == "unknown":
        window = replace(window, T_b_c=state.window.T_b_c)
    return RunState(state.tracker, window, Status.FAILED, resume=last_healthy, closure=closure, gps=gps)
