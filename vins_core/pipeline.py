"""A frame on one page: `step` turns a state and a packet into the next state and a report."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .clock import stopwatch
from .factors.preintegration import preintegrate
from .frontend import depth
from .frontend.state import TrackerState
from .frontend.step import track
from .fusion.stage import fuse
from .fusion.state import GpsState
from .fusion.state import restart as restart_gps
from .initialization import hand_eye, stereo
from .initialization.hand_eye import HandEye
from .initialization.step import initialize
from .initialization.time_offset import AGREES_S
from .mapping import closure as mapping
from .mapping.closure import Closure
from .mapping.places import Places
from .params import Frontend, Params
from .report import (
    FrameReport,
    Gate,
    HandEyeReport,
    InitReport,
    KeyframeReport,
    LossReason,
    PoseEstimate,
    Status,
    Timings,
    TrackReport,
)
from .sensors import Calibration, CameraCalibration, ImageSource, Packet
from .window import online
from .window.keyframe import decide
from .window.locate import locate
from .window.marginalize import marginalize_oldest
from .window.propagate import continue_from, predict
from .window.slide import drop_oldest, drop_second_newest, restrict
from .window.state import Landmarks, Observations, WindowFrame, WindowState
from .window.step import estimate, pose_of
from .window.timing import at_middle_row, referred_to, with_velocity_now


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
    state = RunState(TrackerState.empty(), _empty_window(calibration), Status.FILLING)
    if calibration.extrinsics == "unknown" and calibration.has_imu:
        state = replace(state, hand_eye=HandEye())
    return state if places is None else replace(state, closure=mapping.begin(places))


def step(
    params: Params,
    calibration: Calibration,
    images: ImageSource,
    state: RunState,
    packet: Packet,
    places: Places | None = None,
) -> tuple[RunState, FrameReport, Timings]:
    """Track, `advance`; then close loops where there are `places`, and fuse fixes where there is GPS.

    Deterministic: the same arguments give the same state and report, bit for bit.
    """
    previous = state.tracker.image
    ms: Timings = {}
    with stopwatch(ms, "track"):
        front_end, cameras = _front_end(params, calibration, state)
        tracked = track(
            front_end,
            cameras[0],
            images,
            state.tracker,
            packet,
            {LossReason.OUTLIER: state.rejected_ids, LossReason.DEPTH: state.behind_ids},
            cameras[1] if len(cameras) > 1 else None,
        )
    if calibration.cameras[0].depth:
        with stopwatch(ms, "depth"):
            tracked = depth.measure(params.frontend, calibration.cameras[0], images, packet, tracked)
    state, report, ms = advance(params, calibration, state, packet, tracked, ms)
    if places is not None and params.loop.enabled and report.status is Status.TRACKING:
        assert state.closure is not None and previous is not None
        closure, report = mapping.close(params, places, images, state.closure, state.window, previous, report, ms)
        state = replace(state, closure=closure)
    gps, report = fuse(params.gps, calibration, state.gps, packet, report, ms)
    return replace(state, gps=gps), report, ms


def advance(
    params: Params,
    calibration: Calibration,
    state: RunState,
    packet: Packet,
    tracked: tuple[TrackerState, Observations, TrackReport],
    ms: Timings,
) -> tuple[RunState, FrameReport, Timings]:
    """The estimator's half of a frame: integrate, decide; then initialise, or solve and slide.

    `tracked` is what the front end made of the packet; a what-if may give what it made of it earlier.
    """
    arrived = receive(params, calibration, state, packet, tracked, ms)
    state, report = arrived.state, arrived.report
    if not arrived.ready:
        return state, report, ms
    requests = state.closure.requests if state.closure and params.loop.enabled else ()
    result = estimate(
        params, arrived.calibration, state.window, arrived.keyframe, arrived.previous, ms, requests, arrived.gates
    )
    report = result.explain(report)
    if packet.late_ns:
        report = replace(report, pose=replace(result.pose, late_s=packet.late_ns * 1e-9))
    if result.window is None:
        state = _restart(calibration, state, arrived.previous)
        return state, replace(report, status=Status.FAILED, pose=None), ms
    outliers, behind = (tuple(result.rejected[r].tolist()) for r in (LossReason.OUTLIER, LossReason.DEPTH))
    state = replace(state, window=result.window, rejected_ids=outliers, behind_ids=behind)
    return state, replace(report, status=Status.TRACKING), ms


@dataclass(frozen=True)
class Arrival:
    """A frame that has entered the window."""

    state: RunState
    report: FrameReport
    calibration: Calibration  # as `params.imu` and `params.online` have it
    keyframe: KeyframeReport
    previous: PoseEstimate | None  # the estimate of the frame before; None right after an initialisation
    ready: bool  # the window is initialised: its turn (window/step.py) comes next
    gates: tuple[Gate, ...] = ()  # on which its health depends, too


def receive(
    params: Params,
    calibration: Calibration,
    state: RunState,
    packet: Packet,
    tracked: tuple[TrackerState, Observations, TrackReport],
    ms: Timings,
) -> Arrival:
    """The part of `advance` before the window's turn: integrate, decide about the keyframe, initialise."""
    calibration = _effective(params, calibration)
    tracker, observations, tracks = tracked
    tracking = state.status is Status.TRACKING
    state = _shrink(params, calibration, _calibrating(params, calibration, state))
    observations = _timed(calibration, state, packet, observations)
    previous = pose_of(state.window.frames[-1]) if tracking else None
    with stopwatch(ms, "preintegrate"):
        state = _arrive(calibration, state, packet, observations)
    gates: tuple[Gate, ...] = ()
    if tracking and not state.window.inertial:
        with stopwatch(ms, "locate"):
            window, located = locate(params, state.window)
        state, gates = replace(state, window=window), (located,)
    found = None
    if state.hand_eye is not None:
        with stopwatch(ms, "initialize"):
            state, found = _find_rotation(params, calibration, state)
    R_b_c = state.window.T_b_c[0][:3, :3]
    posed = tracking and not state.window.inertial
    keyframe = decide(params.window, state.window.frames, R_b_c, gyro_is_calibrated=tracking, posed=posed)
    state = _remember_decision(state, keyframe.is_keyframe)
    state = replace(state, tracker=tracker, rejected_ids=(), behind_ids=())
    report = FrameReport(
        frame=packet.frame,
        t_ns=packet.t_ns,
        images=packet.images,
        n_imu=len(packet.imu),
        status=Status.FILLING,
        anomalies=packet.anomalies,
        tracks=tracks,
        keyframe=keyframe,
        hand_eye=found,
    )
    enough = params.window.size + 1 if state.window.inertial else 1
    if len(state.window.frames) < enough and not tracking:
        return Arrival(replace(state, status=Status.FILLING), report, calibration, keyframe, previous, False)
    if not tracking:
        with stopwatch(ms, "initialize"):
            state, report = _initialize(params, calibration, state, report)
        if state.status is not Status.TRACKING:
            state = _forget(calibration, state, keyframe.is_keyframe)
            return Arrival(state, report, calibration, keyframe, previous, False)
    return Arrival(state, report, calibration, keyframe, previous, True, gates)


def _calibrating(params: Params, calibration: Calibration, state: RunState) -> RunState:
    """The window estimates what of the calibration the parameters say from now on."""
    wish = online.wanted(params.online, calibration)
    if wish == state.window.calibrates:
        return state
    window = replace(state.window, calibrates=wish)
    tracking = state.status is Status.TRACKING
    return replace(state, window=online.believe(params.online, window) if tracking else window)


def _effective(params: Params, calibration: Calibration) -> Calibration:
    """The calibration as the parameters have it."""
    noise, imu = calibration.noise, params.imu
    scaled = replace(
        noise,
        acc_n=noise.acc_n * imu.acc_n_scale,
        gyr_n=noise.gyr_n * imu.gyr_n_scale,
        acc_w=noise.acc_w * imu.acc_w_scale,
        gyr_w=noise.gyr_w * imu.gyr_w_scale,
        gap_s=imu.gap_s,
        gap_acc=imu.gap_acc,
        gap_gyr=imu.gap_gyr,
    )
    calibration = replace(calibration, noise=scaled)
    return calibration if params.online.rolling_shutter else calibration.exposed_at_once()


def _empty_window(calibration: Calibration) -> WindowState:
    T_b_c = np.array([c.T_b_c for c in calibration.cameras])
    return WindowState((), Landmarks.empty(), None, T_b_c, calibration.has_imu, calibration.td_of(0))


def _arrive(calibration: Calibration, state: RunState, packet: Packet, observations: Observations) -> RunState:
    """Append the new frame, with the motion since the previous one and, once tracking, a predicted state.

    A window starts with the first frame that has tracks to offer.  Without IMU nothing is known of the motion here.
    """
    if not state.window.frames and not len(observations):
        return state
    zero, identity = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    td_s = _cut_by(calibration, state.window, packet)
    newest = WindowFrame(packet.frame, packet.t_ns, False, observations, None, zero, identity, zero, zero, zero, td_s)
    if state.window.frames and state.window.inertial:
        last = state.window.frames[-1]
        imu = preintegrate(packet.imu, last.b_a, last.b_g, calibration.noise)
        newest = replace(newest, imu=imu, b_a=last.b_a, b_g=last.b_g)
        if state.status is Status.TRACKING:
            p, q, v = predict(last, imu, calibration.gravity_m_s2)
            newest = replace(newest, p_w_b=p, q_w_b=q, v_w_b=v)
    frames = (*state.window.frames, newest)
    window = replace(state.window, frames=frames, landmarks=restrict(state.window.landmarks, frames))
    history = () if state.status is Status.TRACKING else (*state.history, newest)
    return replace(state, window=window, history=history)


def _cut_by(calibration: Calibration, window: WindowState, packet: Packet) -> float:
    """The time offset by which the IMU samples of a packet were cut."""
    if not len(packet.imu):
        return window.td_s
    late_ns, half_s = packet.late_ns, 0.5 * calibration.cameras[0].readout_s
    return window.td_s if late_ns == round((window.td_s + half_s) * 1e9) else late_ns * 1e-9 - half_s


def _timed(calibration: Calibration, state: RunState, packet: Packet, observations: Observations) -> Observations:
    """Where it matters when each ray was seen: velocities at the frame, and rays at the time of its middle row."""
    if not (state.window.knows_td or any(camera.readout_s for camera in calibration.cameras)):
        return observations
    images = [left.t_ns for left, _ in packet.pairs]
    before = images[-2] if len(images) > 1 else state.tracker.image.t_ns if state.tracker.image else packet.t_ns
    observations = with_velocity_now(observations, packet.imu, before + packet.late_ns, state.window.T_b_c)
    return at_middle_row(calibration, observations)


def _remember_decision(state: RunState, is_keyframe: bool) -> RunState:
    frames = list(state.window.frames)
    if len(frames) > 1:
        frames[-2] = replace(frames[-2], is_keyframe=is_keyframe)
    return replace(state, window=replace(state.window, frames=tuple(frames)))


def _initialize(
    params: Params, calibration: Calibration, state: RunState, report: FrameReport
) -> tuple[RunState, FrameReport]:
    state, report = replace(state, status=Status.INITIALIZING), replace(report, status=Status.INITIALIZING)
    last = state.last_attempt_ns
    if last is not None and report.t_ns - last < params.init.retry_s * 1e9:
        return state, report
    window, attempt = _attempt(params, calibration, state, report.hand_eye)
    state, report = replace(state, last_attempt_ns=report.t_ns), replace(report, initialization=attempt)
    if window is None:
        return state, report
    window = online.believe(params.online, window)
    if state.resume is not None:
        window = continue_from(window, state.resume)
    return replace(state, window=window, status=Status.TRACKING, history=(), resume=None, hand_eye=None), report


def _attempt(
    params: Params, calibration: Calibration, state: RunState, rotation: HandEyeReport | None
) -> tuple[WindowState | None, InitReport]:
    if rotation is None:
        return _attempt_with_rotation(params, calibration, state)
    stage = hand_eye.stage(rotation)
    if not stage.passed:
        return None, InitReport((stage,), False, -1, None, None, rotation.b_g)
    window, attempt = _attempt_with_rotation(params, calibration, state)
    return window, replace(attempt, stages=(stage, *attempt.stages))


def _attempt_with_rotation(
    params: Params, calibration: Calibration, state: RunState
) -> tuple[WindowState | None, InitReport]:
    if not calibration.has_imu:
        return stereo.begin(params, state.window)
    window, report = _attempt_at(params, calibration, state, state.window.td_s)
    if report.td_s is None or abs(report.td_s - state.window.td_s) < AGREES_S:
        return window, report
    return _attempt_at(params, calibration, state, report.td_s)


def _attempt_at(
    params: Params, calibration: Calibration, state: RunState, td_s: float
) -> tuple[WindowState | None, InitReport]:
    """With the rays as they were at the times of the poses if the time offset is `td_s`."""
    frames, history = (tuple(referred_to(f, td_s) for f in part) for part in (state.window.frames, state.history))
    window = replace(state.window, frames=frames, td_s=td_s)
    if len(calibration.cameras) > 1 or calibration.cameras[0].depth:
        return stereo.initialize(params, calibration, window)
    return initialize(params, calibration, window, history)


def _find_rotation(params: Params, calibration: Calibration, state: RunState) -> tuple[RunState, HandEyeReport | None]:
    """Another attempt at the unknown rotation, with how camera and gyroscope turned since the frame before."""
    assert state.hand_eye is not None
    if len(state.history) < 2:
        return state, None
    found, report = hand_eye.calibrate(params.init, state.hand_eye, *state.history[-2:])
    mounted = hand_eye.mount(np.array([c.T_b_c for c in calibration.cameras]), found.R_b_c)
    return replace(state, hand_eye=found, window=replace(state.window, T_b_c=mounted)), report


def _front_end(
    params: Params, calibration: Calibration, state: RunState
) -> tuple[Frontend, tuple[CameraCalibration, ...]]:
    """Its parameters and cameras: extrinsics as estimated; where they are to be found, no prediction before that."""
    if not (state.window.calibrates.extrinsics or (calibration.extrinsics == "unknown" and calibration.has_imu)):
        return params.frontend, calibration.cameras
    if state.hand_eye is not None and state.hand_eye.R_b_c is None:
        return replace(params.frontend, predict="off"), calibration.cameras
    return params.frontend, tuple(replace(c, T_b_c=T) for c, T in zip(calibration.cameras, state.window.T_b_c))


def _shrink(params: Params, calibration: Calibration, state: RunState) -> RunState:
    """A window that is larger than `window.size`, which only a changed size makes it, loses its oldest frames."""
    while len(state.window.frames) > params.window.size:
        if state.status is Status.TRACKING:
            prior, _ = marginalize_oldest(params, state.window, calibration.gravity_m_s2)
            state = replace(state, window=drop_oldest(replace(state.window, prior=prior)))
        else:
            state = _forget(calibration, state, is_keyframe=True)
    return state


def _forget(calibration: Calibration, state: RunState, is_keyframe: bool) -> RunState:
    """Slide without estimates: the oldest frame is dropped, or the one before the newest; without IMU, the only one."""
    if not state.window.inertial:
        return replace(state, window=_empty_window(calibration), history=())
    window = drop_oldest(state.window) if is_keyframe else drop_second_newest(state.window, calibration.noise)
    first, *rest = (f for f in state.history if f.frame >= window.frames[0].frame)
    return replace(state, window=window, history=(replace(first, imu=None), *rest))


def _restart(calibration: Calibration, state: RunState, last_healthy: PoseEstimate | None) -> RunState:
    """Forget window and prior, keep the tracks, remember where to continue (SPEC 5.4, unlike REFERENCE F7)."""
    closure = mapping.interrupt(state.closure) if state.closure else None
    gps = restart_gps(state.gps) if state.gps else None
    window = _empty_window(calibration)
    if calibration.extrinsics == "unknown":
        window = replace(window, T_b_c=state.window.T_b_c)
    return RunState(state.tracker, window, Status.FAILED, resume=last_healthy, closure=closure, gps=gps)
