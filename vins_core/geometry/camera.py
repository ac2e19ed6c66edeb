"""Camera models: pixels to unit rays and back.

Every model works on unit rays, so that fields of view beyond 180 degrees need no special case.
`project` of a point outside the model's domain gives NaN; `lift` of a pixel outside it gives NaN.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np


class CameraModel(Protocol):
    """Shape-only interface; one frozen dataclass a model, so that a calibration can be compared and stored."""

    width: int
    height: int

    def project(self, points_c: np.ndarray) -> np.ndarray:
        """(n, 3) points or rays in the camera frame -> (n, 2) pixels, NaN where the model has no image of them."""
        ...

    def lift(self, uv_px: np.ndarray) -> np.ndarray:
        """(n, 2) pixels -> (n, 3) unit rays in the camera frame, NaN outside the model's domain."""
        ...
