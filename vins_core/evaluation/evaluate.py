"""A run against ground truth, in the numbers that papers and evo report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import RecordingError
from ..report import FrameSummary
from ..sensors import Trajectory
from . import ate, rpe
from .align import align, spans_a_plane
from .associate import associate

RPE_DELTA_M = 1.0


@dataclass(frozen=True)
class Evaluation:
    """None where a number does not exist: nothing estimated, no orientations in the truth, path too short."""

    poses: int  # poses of the run
    pairs: int  # of them with truth within max_dt
    ate_rmse_m: float | None  # after SE(3) alignment (evo_ape -a)
    ate_max_m: float | None
    rotation_rmse_deg: float | None  # after the same alignment (evo_ape -a -r angle_deg)
    scale: float | None  # what the estimate must be multiplied by, from Sim(3) alignment (evo_ape -as)
    rpe_rmse_m: float | None  # over 1 m of the estimate's path, all pairs (evo_rpe -d 1 -u m --all_pairs)
    first_pose_s: float | None  # after the first image


def run_trajectory(summaries: Sequence[FrameSummary]) -> Trajectory:
    """The poses of a run, at their times on the IMU's clock: each the newest frame's estimate right after its own
    solve, never revised."""
    rows = [(s.t_imu_ns, s.pose) for s in summaries if s.pose is not None]
    return Trajectory(
        np.array([t for t, _ in rows], np.int64),
        np.array([p.p_w_b for _, p in rows]).reshape(-1, 3),
        np.array([p.q_w_b for _, p in rows]).reshape(-1, 4),
        np.array([p.v_w_b for _, p in rows]).reshape(-1, 3),
        np.array([p.b_g for _, p in rows]).reshape(-1, 3),
        np.array([p.b_a for _, p in rows]).reshape(-1, 3),
    )


def evaluate(estimate: Trajectory, truth: Trajectory, max_dt_s: float, first_image_ns: int | None = None) -> Evaluation:
    """Raises RecordingError when there are poses but fewer than three of them have truth."""
    first_pose_s = None
    if len(estimate) and first_image_ns is not None:
        first_pose_s = int(estimate.t_ns[0] - first_image_ns) / 1e9
    if len(estimate) == 0:
        return Evaluation(0, 0, None, None, None, None, None, None)
    known = np.isfinite(truth.p_w_b).all(1)
    truth = Trajectory(truth.t_ns[known], truth.p_w_b[known], truth.q_w_b[known])
    i, j = associate(truth.t_ns, estimate.t_ns, max_dt_s)
    if len(i) < 3:
        raise RecordingError(_no_overlap(estimate, truth, len(i), max_dt_s))
    p_t, q_t, p_e, q_e = truth.p_w_b[i], truth.q_w_b[i], estimate.p_w_b[j], estimate.q_w_b[j]
    rigid = align(p_e, p_t)
    errors = ate.position_errors(p_e, p_t, rigid)
    scale = align(p_e, p_t, with_scale=True).scale
    rotation = drift = None
    if np.isfinite(q_t).all():
        if spans_a_plane(p_e, p_t):
            rotation = float(np.rad2deg(ate.rmse(ate.rotation_errors(q_e, q_t, rigid))))
        a, b = rpe.pairs_by_path(p_e, RPE_DELTA_M)
        if len(a):
            drift = ate.rmse(rpe.translation_errors(p_e, q_e, p_t, q_t, a, b))
    return Evaluation(
        poses=len(estimate),
        pairs=len(i),
        ate_rmse_m=ate.rmse(errors),
        ate_max_m=float(errors.max()),
        rotation_rmse_deg=rotation,
        scale=scale if np.isfinite(scale) else None,
        rpe_rmse_m=drift,
        first_pose_s=first_pose_s,
    )


def _no_overlap(estimate: Trajectory, truth: Trajectory, pairs: int, max_dt_s: float) -> str:
    def span(t: Trajectory) -> str:
        return f"{t.t_ns[0] * 1e-9:.3f} to {t.t_ns[-1] * 1e-9:.3f} s" if len(t) else "no poses"

    return (
        f"only {pairs} of {len(estimate)} poses have truth within {max_dt_s:g} s, at least 3 are needed: "
        f"the run has {span(estimate)}, the truth {span(truth)}; check that both use one clock, or raise --max-dt"
    )
