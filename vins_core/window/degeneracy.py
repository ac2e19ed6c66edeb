"""Does the window see motion at all?  (SPEC 5.4)

Without translation there is no parallax: new landmarks get no depth, and scale and accelerometer bias drift on what
the prior remembers.  Two motions do that: standing still, and turning on the spot.
"""

from __future__ import annotations

import numpy as np

from ..geometry import so3
from ..params import Health
from ..report import Gate
from .keyframe import parallax_px460
from .state import WindowFrame

MIN_SHARED = 8
"""Tracks that must be shared before their parallax says something."""


def check(params: Health, frames: tuple[WindowFrame, ...], R_b_c: np.ndarray) -> tuple[tuple[Gate, ...], str]:
    """Advisory gates and a sentence ("" when the window moves).

    The parallax is that between the newest frame and the oldest one that still shares tracks with it, after the
    estimated rotation between them has been taken out; R_b_c (3, 3) turns camera into body.
    """
    newest = frames[-1]
    parallax: float | None = None
    turned = 0.0
    for frame in frames[:-1]:
        _, i, j = np.intersect1d(
            frame.observations.ids, newest.observations.ids, assume_unique=True, return_indices=True
        )
        if len(i) < MIN_SHARED:
            continue
        q_i_j = so3.multiply(so3.inverse(frame.q_w_b), newest.q_w_b)
        R_ci_cj = R_b_c.T @ so3.to_matrix(q_i_j) @ R_b_c
        parallax = parallax_px460(frame.observations.rays[i] @ R_ci_cj, newest.observations.rays[j])
        turned = float(np.degrees(np.linalg.norm(so3.log(q_i_j))))
        break
    gate = Gate(
        "window parallax",
        parallax,
        ">=",
        params.min_window_parallax,
        "health.min_window_parallax",
        "px460",
        decides=False,
    )
    if parallax is None or gate.passed:
        return (gate,), ""
    if turned > params.still_rotation_deg:
        return (gate,), f"pure rotation: the camera turned by {turned:.0f} deg with only {parallax:.1f} px of parallax"
    return (gate,), f"standing still: only {parallax:.1f} px of parallax in the whole window"
