"""How far from its optical axis a camera looks."""

from __future__ import annotations

import numpy as np

from .camera import CameraModel

GRID = 32  # pixels looked at along each side


def widest_angle_rad(camera: CameraModel) -> float:
    """The largest angle between the optical axis and the ray of a pixel, 0 to pi."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, GRID), np.linspace(0, camera.height - 1, GRID))
    z = camera.lift(np.stack([u.ravel(), v.ravel()], -1))[:, 2]
    return float(np.arccos(np.clip(np.nanmin(z), -1.0, 1.0)))
