"""Where the gyroscope says tracks went, so that flow can start there (after REFERENCE TF2, TF3).

VINS-Fusion extrapolates the last two poses and needs depths for it.  But it is rotation that moves tracks far from one
image to the next, and the gyroscope measures that without any estimate: hundredths of a radian per second of bias are
a pixel here.  So this works from the first image on, and never feeds an error of the estimator back into the tracks.
"""

from __future__ import annotations

import numpy as np

from ..geometry import so3
from ..sensors import CameraCalibration, ImuSamples


def turn_between(imu: ImuSamples, start_ns: int, end_ns: int) -> np.ndarray:
    """Attitude (4,) wxyz of the body at `end_ns` in its frame at `start_ns`: Exp of the integrated rate.

    Exact while the axis of rotation stays; between two images coning adds a few pixels at the very worst.
    """
    inside = imu.t_ns[(imu.t_ns > start_ns) & (imu.t_ns < end_ns)]
    t_s = (np.concatenate([[start_ns], inside, [end_ns]]) - start_ns) * 1e-9
    gyro = np.stack([np.interp(t_s, (imu.t_ns - start_ns) * 1e-9, axis) for axis in imu.gyro_rad_s.T], -1)
    return so3.exp(np.trapezoid(gyro, t_s, axis=0))


def turn_pixels(camera: CameraCalibration, q_b_next: np.ndarray, rays: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) float32 of far points seen along `rays` (n, 3) after the body turned by `q_b_next`.

    Where the lens shows nothing any more, the old pixel.
    """
    R_b_c = camera.T_b_c[:3, :3]
    R_c_next = R_b_c.T @ so3.to_matrix(q_b_next) @ R_b_c
    turned = camera.model.project(rays @ R_c_next)
    return np.where(np.isfinite(turned), turned, uv_px).astype(np.float32)
