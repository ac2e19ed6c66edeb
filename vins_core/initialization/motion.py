"""Is there motion to initialise from, and which two frames show it best?  (REFERENCE N1-N3, seed 004.14)"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..factors.preintegration import Preintegration
from ..geometry.two_view import RelativePose, estimate_relative_pose
from ..params import Imu, Init
from ..report import Gate, InitStage, all_pass
from ..window.keyframe import FOCAL_460, align_rays, parallax_px460
from .tracks import TrackTable


def excitation(
    params: Init, limits: Imu, imu: Sequence[Preintegration], window_imu: Sequence[Preintegration]
) -> InitStage:
    """N1: how much the mean specific force delta_v / dt varies over the frames, each in the body at its beginning.

    It does not vary at rest and at constant velocity, where scale cannot be observed.  Turning alone varies it too;
    the uncertainty of the scale after refinement is the finer test.
    """
    force = np.array([p.delta_v / p.dt_s for p in imu if p.dt_s > 0])
    value = float(np.sqrt(np.mean(np.sum((force - force.mean(0)) ** 2, 1)))) if len(force) else 0.0
    longest = max(p.dt_s for p in window_imu)
    gates = (
        Gate(
            "excitation", value, ">=", params.min_excitation, "init.min_excitation", "m/s^2", params.require_excitation
        ),
        Gate("longest_interval", longest, "<=", limits.max_interval_s, "imu.max_interval_s", "s"),
    )
    outcome = ""
    if not all_pass(gates[:1]):
        outcome = f"the accelerometer varies by only {value:.2f} m/s^2: move with more changes of speed or direction"
    elif not gates[1].passed:
        outcome = f"the window still spans {longest:.0f} s without a keyframe: keep moving"
    return InitStage("excitation", gates, outcome)


@dataclass(frozen=True)
class Reference:
    """A frame of the window whose relative pose to the newest frame is known."""

    slot: int
    pose: RelativePose  # newest camera in the reference camera, unit baseline


def references(params: Init, tracks: TrackTable) -> Iterator[tuple[Reference | None, InitStage]]:
    """N2, N3: frames that share enough tracks with the newest and see it from far enough away, oldest first.

    Parallax may come from turning alone, so what the best rotation between the two leaves unexplained is a gate, too.
    When no frame qualifies, one `None` with the gates of the frame that came furthest.
    """
    newest = tracks.n_frames - 1
    furthest: InitStage | None = None
    for slot in range(newest):
        pose, stage = _relate(params, *tracks.common(slot, newest), slot)
        if stage.passed and pose is not None:
            yield Reference(slot, pose), stage
            furthest = stage
        elif furthest is None or (not furthest.passed and _progress(stage) > _progress(furthest)):
            furthest = stage
    assert furthest is not None
    if not furthest.passed:
        yield None, furthest


def _relate(params: Init, rays_l: np.ndarray, rays_n: np.ndarray, slot: int) -> tuple[RelativePose | None, InitStage]:
    parallax = translation = pose = None
    if len(rays_l):
        parallax = parallax_px460(rays_l, rays_n)
        translation = parallax_px460(rays_l @ align_rays(rays_l, rays_n).T, rays_n)
    gates: tuple[Gate, ...] = (
        Gate("matches", len(rays_l), ">", params.min_matches, "init.min_matches"),
        Gate("parallax", parallax, ">", params.min_parallax_px, "init.min_parallax_px", "px460"),
        Gate("translation", translation, ">=", params.min_translation_px, "init.min_translation_px", "px460"),
    )
    if all_pass(gates):
        pose = estimate_relative_pose(rays_l, rays_n, params.ransac_px / FOCAL_460)
        inliers = 0 if pose is None else int(np.count_nonzero(pose.in_front))
        gates += (Gate("pose_inliers", inliers, ">=", params.min_pose_inliers, "init.min_pose_inliers"),)
    why = {
        "matches": "too few tracks reach from an older frame to the newest: move more slowly, find more texture",
        "parallax": "too little parallax between any frame of the window and the newest: move the camera sideways",
        "translation": "the camera has only turned: move it sideways",
        "pose_inliers": "no relative pose explains the tracks between the reference frame and the newest",
    }
    outcome = next((why[g.name] for g in gates if not g.passed), "")
    return pose, InitStage("relative pose", gates, outcome, {"reference_slot": float(slot)})


def _progress(stage: InitStage) -> tuple[int, float]:
    """How many gates passed before the first failure, and how near the failed one came."""
    passed = next(k for k, g in enumerate(stage.gates) if not g.passed)
    gate = stage.gates[passed]
    return passed, 0.0 if gate.value is None else gate.value / max(gate.limit, 1e-9)
