"""What if this frame had been estimated with other parameters?  (SPEC 9.3b)

The frame is repeated from the recorded state before it, with the recorded tracks or, when a parameter of the front
end is in question, with its images tracked again; the record stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .frontend.state import TrackerState
from .fusion.stage import fuse
from .geometry import so3
from .params import Params
from .pipeline import advance, step
from .record.compare import Difference, differing_decision
from .record.fork import recorded_images, state_before
from .record.reader import RunReader
from .report import CostSplit, FrameReport, Timings, TrackReport
from .sensors import ImageSource
from .solver import backend
from .window.state import Observations


@dataclass(frozen=True)
class WhatIf:
    """One frame as it was recorded and as it would have been; without what the map said of it."""

    before: FrameReport
    after: FrameReport
    params_before: Params
    params_after: Params
    ms: Timings  # of the repetition
    reran_frontend: bool

    @property
    def first_difference(self) -> Difference | None:
        """The first decision that differs; it names the gate that tipped it."""
        return differing_decision(self.before, self.after, self.params_before, self.params_after)


def resolve(
    run: RunReader, k: int, params: Params, images: ImageSource | None = None, rerun_frontend: bool = False
) -> WhatIf:
    """Repeat frame k of a run with `params`, from the recorded state after frame k - 1.

    `images` are needed only to run the front end again; by default those that the run refers to.
    With the parameters of that frame (`header.params_at(k)`), `after` equals `before` bit for bit.
    Raises RunError when the frame cannot be restored, or the back end of the run is not available.
    """
    header = run.header
    if rerun_frontend and images is None:
        with recorded_images(run) as source:
            return resolve(run, k, params, source, rerun_frontend=True)
    state, packet, before = state_before(run, k), run.packet(k), run.report(k)
    with backend.using(backend.recorded(header.backend)):
        if rerun_frontend:
            assert images is not None
            _, after, ms = step(params, header.calibration, images, state, packet)
        else:
            tracked = recorded_tracks(run, k, params)
            state, after, ms = advance(params, header.calibration, state, packet, tracked, {})
            _, after = fuse(params.gps, header.calibration, state.gps, packet, after, ms)
    before, after = without_map(before), without_map(after)
    return WhatIf(before, after, header.params_at(k), params, ms, rerun_frontend)


def without_map(report: FrameReport) -> FrameReport:
    """What front end, estimator and GPS fusion said of a frame."""
    return replace(report, relocalizations=(), closure=None)


def needs_frontend(changes: dict[str, object]) -> bool:
    """Whether only running the front end again shows what these parameters (`section.name`) do to a frame."""
    return any(k.startswith("frontend.") and k != "frontend.min_track_count" for k in changes)


def recorded_tracks(run: RunReader, k: int, params: Params) -> tuple[TrackerState, Observations, TrackReport]:
    """What the front end made of frame k, with the age that `params` demands of a track."""
    tracker, report = run.state(k).tracker, run.report(k).tracks
    seen = tracker.age >= params.frontend.min_track_count
    right = tracker.right.among(tracker.ids[seen]) if tracker.right else None
    depth_m = report.usable_depth_m[seen] if len(report.depth_loss) else None
    return (
        tracker,
        Observations(tracker.ids[seen], tracker.rays[seen], tracker.uv_px[seen], report.velocity[seen], right, depth_m),
        report,
    )


@dataclass(frozen=True)
class LandmarkEffect:
    """Landmarks that both solves know, by id; depths and points of both."""

    ids: np.ndarray  # (n,)
    inv_depth: np.ndarray  # (2, n) before and after
    xyz_w: np.ndarray  # (2, n, 3)
    error_px: np.ndarray  # (2, n)
    status: np.ndarray  # (2, n) index into LANDMARK_STATUSES
    only_before: np.ndarray  # (m,) ids that only one of them knows
    only_after: np.ndarray


@dataclass(frozen=True)
class ResidualEffect:
    """Projections that both solves used, one row each: (track, observing slot) and both errors."""

    ids: np.ndarray  # (n,)
    slots: np.ndarray  # (n,)
    error_px: np.ndarray  # (2, n)
    imu_sigma: np.ndarray | None  # (2, intervals, 5) of p, q, v, ba, bg; None when the windows differ in length


@dataclass(frozen=True)
class Effect:
    """What other parameters did to a window, state by state; differences are after minus before.

    None where one of the two did not solve.
    """

    cost: tuple[CostSplit, CostSplit]
    frames: np.ndarray  # (n,) frames both windows hold
    p_m: np.ndarray  # (n, 3)
    rotation_deg: np.ndarray  # (n,)
    v_m_s: np.ndarray  # (n, 3)
    b_a: np.ndarray  # (n, 3) m/s^2
    b_g: np.ndarray  # (n, 3) rad/s
    landmarks: LandmarkEffect
    residuals: ResidualEffect


def effect(before: FrameReport, after: FrameReport) -> Effect | None:
    """Both estimates of one frame side by side; None unless both were solved."""
    a, b = before.window, after.window
    if before.solve is None or after.solve is None or a is None or b is None:
        return None
    frames, i, j = np.intersect1d(a.frames, b.frames, assume_unique=True, return_indices=True)
    return Effect(
        cost=(before.solve.after, after.solve.after),
        frames=frames,
        p_m=b.p_w_b[j] - a.p_w_b[i],
        rotation_deg=np.degrees(np.linalg.norm(so3.difference(b.q_w_b[j], a.q_w_b[i]), axis=-1)),
        v_m_s=b.v_w_b[j] - a.v_w_b[i],
        b_a=b.b_a[j] - a.b_a[i],
        b_g=b.b_g[j] - a.b_g[i],
        landmarks=_landmarks(before, after),
        residuals=_residuals(before, after),
    )


def _landmarks(before: FrameReport, after: FrameReport) -> LandmarkEffect:
    a, b = before.landmarks, after.landmarks
    assert a is not None and b is not None
    ids, i, j = np.intersect1d(a.ids, b.ids, assume_unique=True, return_indices=True)
    return LandmarkEffect(
        ids,
        np.stack([a.inv_depth[i], b.inv_depth[j]]),
        np.stack([a.xyz_w[i], b.xyz_w[j]]),
        np.stack([a.error_px[i], b.error_px[j]]),
        np.stack([a.status[i], b.status[j]]),
        np.setdiff1d(a.ids, ids),
        np.setdiff1d(b.ids, ids),
    )


def _residuals(before: FrameReport, after: FrameReport) -> ResidualEffect:
    a, b = before.solve, after.solve
    assert a is not None and b is not None
    own = [s.visual_camera == 0 if len(s.visual_camera) else slice(None) for s in (a, b)]
    a, b = (
        replace(s, visual_ids=s.visual_ids[k], visual_slots=s.visual_slots[k], visual_error_px=s.visual_error_px[k])
        for s, k in zip((a, b), own)
    )
    keys = [s.visual_ids * 256 + s.visual_slots[:, 1] for s in (a, b)]
    both, i, j = np.intersect1d(*keys, return_indices=True)
    sigmas = (a.imu_sigma, b.imu_sigma)
    return ResidualEffect(
        both // 256,
        both % 256,
        np.stack([a.visual_error_px[i], b.visual_error_px[j]]),
        np.stack(sigmas) if sigmas[0].shape == sigmas[1].shape else None,
    )
