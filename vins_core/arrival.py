"""A frame enters the window: integrate, decide about the keyframe, initialise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .clock import stopwatch
from .factors.preintegration import preintegrate
from .frontend.state import TrackerState
from .initialization.attempt import attempt, find_rotation
from .params import Params
from .report import FrameReport, Gate, KeyframeReport, PoseEstimate, Status, Timings, TrackReport
from .sensors import Calibration, Packet
from .state import RunState, forget
from .window import online
from .window.keyframe import decide
from .window.locate import locate
from .window.marginalize import marginalize_oldest
from .window.propagate import predict
from .window.slide import drop_oldest, restrict
from .window.state import Observations, WindowFrame, WindowState
from .window.step import pose_of
from .window.timing import at_middle_row, with_velocity_now


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
            state, found = find_rotation(params, calibration, state)
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
            state, report = attempt(params, calibration, state, report)
        if state.status is not Status.TRACKING:
            state = forget(calibration, state, keyframe.is_keyframe)
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


def _shrink(params: Params, calibration: Calibration, state: RunState) -> RunState:
    """A window that is larger than `window.size`, which only a changed size makes it, loses its oldest frames."""
    while len(state.window.frames) > params.window.size:
        if state.status is Status.TRACKING:
            prior, _ = marginalize_oldest(params, state.window, calibration.gravity_m_s2)
            state = replace(state, window=drop_oldest(replace(state.window, prior=prior)))
        else:
            state = forget(calibration, state, is_keyframe=True)
    return state
