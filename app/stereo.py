"""What two cameras see of the same tracks, as arrays: matches, refused matches, epipolar lines, landmarks.

All pixels are those of the recorded images; distances are in px460, as in the gates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vins_core.frontend.reject import epipolar_distance_px
from vins_core.geometry import se3, so3
from vins_core.report import RIGHT_LOSSES, FrameReport, RightLoss
from vins_core.sensors import CameraCalibration

MATCHED = 255
"""`TrackReport.right_loss` of a track that the second camera sees."""
INVERSE_DEPTHS = np.array([0.0, 0.1, 0.3, 0.7, 1.5, 4.0])
"""1/m along a ray at which its image in the other camera is looked up: a line for any camera model."""


@dataclass(frozen=True)
class StereoPicture:
    """One row per track alive."""

    sizes: tuple[tuple[int, int], tuple[int, int]]  # (width, height) of the left image and of the right one
    ids: np.ndarray  # (n,)
    age: np.ndarray  # (n,)
    left_px: np.ndarray  # (n, 2)
    right_px: np.ndarray  # (n, 2) NaN where it was not found
    loss: np.ndarray  # (n,) index into RIGHT_LOSSES, 255 for a match
    epipolar_px: np.ndarray  # (n,) distance to the epipolar line, px460; NaN where it was not found
    offset_px: np.ndarray  # (n,) the same with a sign: to which side of it in the right image
    lines_px: np.ndarray  # (n, s, 2) the track's ray as the right camera would see it; NaN outside
    landmark_px: np.ndarray  # (n, 2) where the right camera would see its landmark as solved; NaN without depth

    @property
    def matched(self) -> np.ndarray:
        return self.loss == MATCHED

    def count(self, loss: RightLoss) -> int:
        return int(np.count_nonzero(self.loss == RIGHT_LOSSES.index(loss)))


def stereo_picture(report: FrameReport, cameras: tuple[CameraCalibration, ...]) -> StereoPicture | None:
    """None when the run had one camera.  Extrinsics are those of the frame, where they are estimated."""
    tracks = report.tracks
    if len(cameras) < 2 or len(tracks.right_loss) != len(tracks.ids):
        return None
    left, right = (camera.model for camera in cameras[:2])
    T_b_c = [camera.T_b_c for camera in cameras] if report.calibration is None else report.calibration.T_b_c
    T_c1_c0 = se3.inverse(T_b_c[1]) @ T_b_c[0]
    rays = left.lift(tracks.uv_px)
    along = (rays @ T_c1_c0[:3, :3].T)[:, None] + INVERSE_DEPTHS[:, None] * rays[:, None, 2:] * T_c1_c0[:3, 3]
    distance, offset = _epipolar(T_c1_c0, rays, right.lift(tracks.right_uv_px))
    return StereoPicture(
        ((left.width, left.height), (right.width, right.height)),
        tracks.ids,
        tracks.age,
        tracks.uv_px,
        tracks.right_uv_px,
        tracks.right_loss,
        distance,
        offset,
        _inside(cameras[1], along.reshape(-1, 3)).reshape(*along.shape[:2], 2),
        _landmarks(report, cameras[1], T_b_c[1]),
    )


def _epipolar(T_c1_c0: np.ndarray, rays_0: np.ndarray, rays_1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) distance to the epipolar line, and the same with the side on which ray_1 lies."""
    E = so3.skew(T_c1_c0[:3, 3]) @ T_c1_c0[:3, :3]
    distance = np.full(len(rays_0), np.nan)
    known = np.isfinite(rays_0).all(1) & np.isfinite(rays_1).all(1)
    distance[known] = epipolar_distance_px(E, rays_0[known], rays_1[known])
    with np.errstate(invalid="ignore"):
        return distance, distance * np.sign(np.sum(rays_1 * (rays_0 @ E.T), 1))


def _landmarks(report: FrameReport, camera: CameraCalibration, T_b_c: np.ndarray) -> np.ndarray:
    """(n, 2) pixels of the landmarks of the tracks alive, from the newest pose of the window."""
    ids, seen = report.tracks.ids, np.full((len(report.tracks.ids), 2), np.nan)
    landmarks, window = report.landmarks, report.window
    if landmarks is None or window is None or not len(landmarks.ids):
        return seen
    row = np.minimum(np.searchsorted(landmarks.ids, ids), len(landmarks.ids) - 1)
    known = landmarks.ids[row] == ids
    T_w_c = se3.from_quaternion_translation(window.q_w_b[-1], window.p_w_b[-1]) @ T_b_c
    points_c = se3.transform(se3.inverse(T_w_c), landmarks.xyz_w[row[known]].astype(float))
    seen[known] = _inside(camera, points_c)
    return seen


def _inside(camera: CameraCalibration, points_c: np.ndarray) -> np.ndarray:
    """(n, 2) pixels, NaN for what the image does not show."""
    size = camera.model.width, camera.model.height
    with np.errstate(all="ignore"):
        uv = np.asarray(camera.model.project(points_c), float)
        shown = np.all((uv >= 0) & (uv <= size), axis=1)
    return np.where(shown[:, None], uv, np.nan)
