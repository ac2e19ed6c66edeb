"""Synthetic runs for the record's tests: states that share arrays from frame to frame as a real window does."""

from __future__ import annotations

import numpy as np

from vins_core.factors.preintegration import Preintegration
from vins_core.frontend.state import TrackerState
from vins_core.geometry.camera import camera_from_dict
from vins_core.params import Params
from vins_core.record.header import RunHeader
from vins_core.report import (
    BlockReport,
    CostSplit,
    FrameReport,
    Gate,
    HealthReport,
    IterationReport,
    KeyframeReport,
    LandmarkReport,
    MarginalizationReport,
    PoseEstimate,
    SolveReport,
    Status,
    TrackReport,
    WindowReport,
)
from vins_core.sensors import (
    Calibration,
    CameraCalibration,
    DepthRef,
    GpsFix,
    ImageRef,
    ImuNoise,
    ImuSamples,
    Packet,
    Trajectory,
)
from vins_core.state import RunState
from vins_core.window.state import BlockKey, Landmarks, Observations, Prior, WindowFrame, WindowState

T0 = 1_403_636_580_000_000_000
TRACKS, LANDMARKS, FACTORS, PRIOR = 150, 190, 1300, 75


def calibration() -> Calibration:
    model = camera_from_dict(
        "pinhole-radtan", width=752, height=480, fx=458.654, fy=457.296, cx=367.215, cy=248.375,
        k1=-0.28340811, k2=0.07395907, p1=0.00019359, p2=1.76187114e-05,
    )  # fmt: skip
    camera = CameraCalibration("cam0", model, np.eye(4) + 1 / 3, "/cam0/image_raw")
    return Calibration((camera,), ImuNoise("discrete", 0.08, 0.004, 4e-5, 2e-6), 9.81007, 0.0, "/imu0", ("a.yaml",))


def header(**changes: object) -> RunHeader:
    return RunHeader(Params(), calibration(), **changes)  # type: ignore[arg-type]


def truth(n: int = 50) -> Trajectory:
    rng = np.random.default_rng(7)
    q = rng.normal(size=(n, 4))
    return Trajectory(T0 + np.arange(n) * 5_000_000, rng.normal(size=(n, 3)), q / np.linalg.norm(q, axis=1)[:, None])


def fixes(t_ns: int, count: int) -> tuple[GpsFix, ...]:
    place = np.random.default_rng(count)
    return tuple(
        GpsFix(t_ns - i, *place.normal(size=3).tolist(), place.normal(size=(3, 3)), status=i - 1) for i in range(count)
    )


def pose(rng: np.random.Generator) -> PoseEstimate:
    return PoseEstimate(*(rng.normal(size=n) for n in (3, 4, 3, 3, 3)))


def frames(count: int, window: int = 11):
    """Yields (report, timings, packet, state) of a made-up but realistically sized run."""
    rng = np.random.default_rng(0)
    kept: list[WindowFrame] = []
    ids = np.arange(TRACKS)
    T_b_c = np.eye(4)[None]
    for k in range(count):
        t_ns = T0 + k * 100_000_000
        imu = ImuSamples(t_ns - np.arange(21)[::-1] * 5_000_000, rng.normal(size=(21, 3)), rng.normal(size=(21, 3)))
        images = tuple(ImageRef(t_ns - d, 0, 2 * k + 1 - i) for i, d in enumerate((50_000_000, 0)))
        packet = Packet(k, images, imu, gps=fixes(t_ns, k % 3), depths=(None, DepthRef(t_ns + 1, 0, k))[: 2 * (k % 2)])
        ids = np.sort(np.concatenate([rng.choice(ids, TRACKS - 10, replace=False), ids.max() + 1 + np.arange(10)]))
        seen = Observations(
            ids,
            rng.normal(size=(TRACKS, 3)),
            rng.normal(size=(TRACKS, 2)).astype(np.float32),
            rng.normal(size=(TRACKS, 2)).astype(np.float32),
        )
        b = np.zeros(3)
        integral = Preintegration(
            imu, b, b, 0.1, *(rng.normal(size=s) for s in (3, 4, 3, (15, 6), (15, 15)))
        )  # fmt: skip
        kept.append(WindowFrame(k, t_ns, k % 3 == 0, seen, integral if k else None, *(b for _ in range(5))))
        kept = [  # states change in every solve, measurements never
            WindowFrame(
                f.frame, f.t_ns, f.is_keyframe, f.observations, f.imu, *(rng.normal(size=n) for n in (3, 4, 3, 3, 3))
            )
            for f in kept[-window:]
        ]
        landmarks = Landmarks(np.arange(LANDMARKS), rng.normal(size=LANDMARKS), np.zeros(LANDMARKS, np.uint8))
        prior = Prior(
            (BlockKey("pose", k), BlockKey("speed_bias", k)),
            (rng.normal(size=7), rng.normal(size=9)),
            np.asfortranarray(rng.normal(size=(PRIOR, PRIOR))),
            rng.normal(size=PRIOR),
        )
        tracker = TrackerState(
            images[-1],
            ids,
            seen.uv_px,
            seen.rays,
            np.ones(TRACKS, np.int32),
            np.full((TRACKS, 2), np.nan, np.float32),
            9,
        )
        state = RunState(
            tracker,
            WindowState(tuple(kept), landmarks, prior, T_b_c),
            Status.TRACKING,
            history=tuple(kept[:2]),
            last_attempt_ns=t_ns,
            rejected_ids=(3, 5),
            resume=pose(rng),
        )
        yield _report(rng, packet, seen, state), {"track": 3.25, "solve": 11.5}, packet, state


def _report(rng: np.random.Generator, packet: Packet, seen: Observations, state: RunState) -> FrameReport:
    n, gates = len(state.window.frames), (Gate("tracked", 12.0, ">=", 20.0, "window.keyframe_min_tracked"),)
    newest = state.window.frames[-1]
    tracks = TrackReport(
        seen.ids, seen.uv_px, np.ones(TRACKS, np.int32), seen.velocity, np.arange(5), np.zeros((5, 2), np.float32),
        np.ones(5, np.int32), np.zeros(5, np.uint8), 10, gates,
    )  # fmt: skip
    solve = SolveReport(
        CostSplit(3.0, 2.0, 1.0), CostSplit(1.0, 0.5, 0.25), (IterationReport(3.0, True, 0.1, 0.9, 1e12),) * 8,
        "converged", LANDMARKS, rng.integers(0, 999, FACTORS), rng.integers(0, 11, (FACTORS, 2), np.uint8),
        rng.normal(size=FACTORS).astype(np.float32), rng.normal(size=(n - 1, 5)),
    )  # fmt: skip
    stack = {
        name: np.array([getattr(f, name) for f in state.window.frames])
        for name in ("p_w_b", "q_w_b", "v_w_b", "b_a", "b_g")
    }
    window = WindowReport(
        np.array([f.frame for f in state.window.frames]), np.array([f.t_ns for f in state.window.frames]),
        np.ones(n, bool), **stack, shared=np.ones(n, np.int32), error_px=np.ones(n, np.float32),
    )  # fmt: skip
    landmarks = LandmarkReport(
        state.window.landmarks.ids, rng.normal(size=(LANDMARKS, 3)).astype(np.float32),
        state.window.landmarks.inv_depth, rng.normal(size=LANDMARKS).astype(np.float32),
        np.ones(LANDMARKS, np.uint8), np.ones(LANDMARKS, np.uint8), rng.normal(size=LANDMARKS).astype(np.float32),
        state.window.landmarks.status,
    )  # fmt: skip
    blocks = tuple(BlockReport(f"inv_depth of {i}", 1, i, True) for i in range(56))
    return FrameReport(
        packet.frame, packet.t_ns, packet.images, len(packet.imu), Status.TRACKING, (), tracks,
        KeyframeReport(True, "parallax 12.5 px", 12.5, 14.0, 120, 80, 10, gates), None, solve, window, landmarks,
        MarginalizationReport("MARGIN_OLD", 57, PRIOR, blocks, 71, rng.normal(size=PRIOR)), HealthReport(gates, ""),
        PoseEstimate(newest.p_w_b, newest.q_w_b, newest.v_w_b, newest.b_a, newest.b_g),
    )  # fmt: skip
