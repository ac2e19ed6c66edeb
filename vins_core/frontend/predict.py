"""Where the gyroscope says tracks went, so that flow can start there (REFERENCE TF2; fast rotation).

VINS-Fusion extrapolates the last two poses and needs depths for it (TF3).  Between two images it is rotation that
moves tracks far, and the gyroscope measures that without any estimate: a few thousandths of a radian per second of
bias are less than a pixel here.  So this works from the first image on, and never feeds an error of the estimator
back into the tracks.
"""

from __future__ import annotations

import numpy as np

from ..geometry import so3
from ..geometry.camera import CameraModel
from ..sensors import CameraCalibration, ImuSamples


def turn_between(imu: ImuSamples, start_ns: int, end_ns: int) -> np.ndarray:
    """Attitude (4,) wxyz of the body at `end_ns` in its frame at `start_ns`: the product of Exp(gyro dt), mid-point."""
    inside = imu.t_ns[(imu.t_ns > start_ns) & (imu.t_ns < end_ns)]
    t_ns = np.concatenate([[start_ns], inside, [end_ns]])
    since_s = (t_ns - start_ns) * 1e-9
    gyro = np.stack([np.interp(since_s, (imu.t_ns - start_ns) * 1e-9, axis) for axis in imu.gyro_rad_s.T], -1)
    steps = so3.exp(0.5 * (gyro[1:] + gyro[:-1]) * np.diff(since_s)[:, None])
    q = steps[0]
    for step in steps[1:]:
        q = so3.multiply(q, step)
    return so3.normalize(q)


def turn_pixels(camera: CameraCalibration, q_b_next: np.ndarray, rays: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) float32 of far points seen along `rays` (n, 3) after the body turned by `q_b_next`.

    Where the lens shows nothing any more, the old pixel.
    """
    model: CameraModel = camera.model
    R_b_c = camera.T_b_c[:3, :3]
    R_c_next = R_b_c.T @ so3.to_matrix(q_b_next) @ R_b_c
    turned = model.project(rays @ R_c_next)
    return np.where(np.isfinite(turned), turned, uv_px).astype(np.float32)
