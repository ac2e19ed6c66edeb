"""Is the second newest frame a keyframe?  (REFERENCE W2-W4, seed 004.8)

The decision is taken when the next frame arrives: the second newest frame becomes a keyframe when the newest one
has lost too many of its tracks, or when it has itself moved far enough from the frame before it.  "Moved" is the
mean parallax of the tracks both see, after the rotation between them has been taken out, so that a camera that
merely turns makes no keyframes.
"""

from __future__ import annotations

import numpy as np

from ..geometry import so3
from ..params import Window
from ..report import Gate, KeyframeReport
from .state import WindowFrame

FOCAL_460 = 460.0


def decide(
    params: Window, frames: tuple[WindowFrame, ...], R_b_c: np.ndarray, gyro_is_calibrated: bool, posed: bool = False
) -> KeyframeReport:
    """Keyframe decision about `frames[-2]`; `frames[-1]` is the frame that has just arrived.

    R_b_c: (3, 3) rotation of the camera in the body.  `gyro_is_calibrated` says whether the gyroscope bias has been
    estimated; before that the rotation is taken from the images alone (`align_rays`), because an unknown bias of
    0.1 rad/s would pass for 5 px of parallax in a tenth of a second.  Without IMU the rotation is that of the estimated
    poses, once there are such (`posed`); one found from the images alone takes some of a sideways motion with it.
    """
    if len(frames) < 3:
        return _report(True, "the window has fewer than three frames", np.nan, np.nan, 0, frames, ())
    third, second, newest = frames[-3], frames[-2], frames[-1].observations
    tracked = len(np.intersect1d(newest.ids, second.observations.ids, assume_unique=True))
    _, i, j = np.intersect1d(third.observations.ids, second.observations.ids, assume_unique=True, return_indices=True)
    rays_i, rays_j = third.observations.rays[i], second.observations.rays[j]
    raw = compensated = np.nan
    if len(i):
        raw = parallax_px460(rays_i, rays_j)
        if posed:
            q_i_j = so3.multiply(so3.inverse(third.q_w_b), second.q_w_b)
            compensated = parallax_px460(rays_i @ (R_b_c.T @ so3.to_matrix(q_i_j) @ R_b_c), rays_j)
        elif gyro_is_calibrated and second.imu is not None:
            R_ci_cj = R_b_c.T @ so3.to_matrix(second.imu.delta_q) @ R_b_c
            compensated = parallax_px460(rays_i @ R_ci_cj, rays_j)
        else:
            compensated = parallax_px460(rays_i @ align_rays(rays_i, rays_j).T, rays_j)
    used = compensated if params.compensate_rotation else raw
    gates = (
        Gate("tracked", tracked, ">=", params.keyframe_min_tracked, "window.keyframe_min_tracked"),
        Gate("parallax", used, "<", params.keyframe_parallax, "window.keyframe_parallax", "px460"),
    )
    if tracked < params.keyframe_min_tracked:
        reason = f"only {tracked} tracks reach the newest frame"
    elif not len(i):
        reason = "no track is shared with the frame before"
    elif used >= params.keyframe_parallax:
        reason = f"mean parallax {used:.1f} px"
    else:
        return _report(False, f"mean parallax only {used:.1f} px", compensated, raw, tracked, frames, gates)
    return _report(True, reason, compensated, raw, tracked, frames, gates)


def parallax_px460(rays_i: np.ndarray, rays_j: np.ndarray) -> float:
    """Mean distance of corresponding rays (n, 3) on the normalised plane x 460; beyond 80 degrees the angle x 460."""
    near = np.minimum(rays_i[:, 2], rays_j[:, 2]) > 0.17
    z_i, z_j = np.where(near, rays_i[:, 2], 1.0), np.where(near, rays_j[:, 2], 1.0)
    plane = np.linalg.norm(rays_i[:, :2] / z_i[:, None] - rays_j[:, :2] / z_j[:, None], axis=1)
    angle = np.arctan2(np.linalg.norm(np.cross(rays_i, rays_j), axis=1), np.sum(rays_i * rays_j, axis=1))
    return float(FOCAL_460 * np.mean(np.where(near, plane, angle)))


def align_rays(rays_i: np.ndarray, rays_j: np.ndarray) -> np.ndarray:
    """The rotation R (3, 3) minimising sum |R ray_i - ray_j|^2 (Wahba's problem, solved by SVD)."""
    U, _, Vt = np.linalg.svd(rays_j.T @ rays_i)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def _report(
    is_keyframe: bool,
    reason: str,
    compensated: float,
    raw: float,
    tracked: int,
    frames: tuple[WindowFrame, ...],
    gates: tuple[Gate, ...],
) -> KeyframeReport:
    newest = frames[-1].observations.ids if frames else np.zeros(0, np.int64)
    counts = np.zeros(len(newest), int)
    for frame in frames:
        counts += np.isin(newest, frame.observations.ids, assume_unique=True)
    return KeyframeReport(
        is_keyframe=is_keyframe,
        reason=reason,
        parallax_px=float(compensated),
        parallax_raw_px=float(raw),
        tracked=tracked,
        long_tracks=int(np.sum(counts >= 4)),
        new_tracks=int(np.sum(counts == 1)),
        gates=gates,
    )
