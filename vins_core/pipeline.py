"""A frame on one page: `step` turns a state and a packet into the next state and a report."""

from __future__ import annotations

from dataclasses import replace

from .arrival import receive
from .clock import stopwatch
from .frontend import depth
from .frontend.state import TrackerState
from .frontend.step import track
from .fusion.stage import fuse
from .mapping import closure as mapping
from .mapping.places import Places
from .params import Frontend, Params
from .report import FrameReport, LossReason, Status, Timings, TrackReport
from .sensors import Calibration, CameraCalibration, ImageSource, Packet
from .state import RunState, restart
from .window.state import Observations
from .window.step import estimate


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
        state = restart(calibration, state, arrived.previous)
        return state, replace(report, status=Status.FAILED, pose=None), ms
    outliers, behind = (tuple(result.rejected[r].tolist()) for r in (LossReason.OUTLIER, LossReason.DEPTH))
    state = replace(state, window=result.window, rejected_ids=outliers, behind_ids=behind)
    return state, replace(report, status=Status.TRACKING), ms


def _front_end(
    params: Params, calibration: Calibration, state: RunState
) -> tuple[Frontend, tuple[CameraCalibration, ...]]:
    """Its parameters and cameras: extrinsics as estimated; where they are to be found, no prediction before that."""
    if not (state.window.calibrates.extrinsics or (calibration.extrinsics == "unknown" and calibration.has_imu)):
        return params.frontend, calibration.cameras
    if state.hand_eye is not None and state.hand_eye.R_b_c is None:
        return replace(params.frontend, predict="off"), calibration.cameras
    return params.frontend, tuple(replace(c, T_b_c=T) for c, T in zip(calibration.cameras, state.window.T_b_c))
