"""Sets of `loop` parameters that belong together, as `section.name -> value`.

`parity`: the loop detection of VINS-Mono (REFERENCE 15, 16), for a vocabulary of a million words.  VINS describes FAST
corners without a cap, which `loop.max_corners` approaches.
`seed`: the founding documents (seeds 000.4 and 004.24): every third keyframe, 500 corners, RANSAC on the epipolar
geometry before PnP, at most 30 degrees and 20 m.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

_VINS_LIMITS = {
    "loop.min_gap": 50,
    "loop.min_inliers": 26,
    "loop.max_heading_deg": 30.0,
    "loop.max_distance_m": 20.0,
}

PRESETS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "parity": {
            **_VINS_LIMITS,
            "loop.max_corners": 3000,
            "loop.skip_first": 10,
            "loop.candidates": 4,
            "loop.order": "oldest",
            "loop.score": "absolute",
            "loop.min_score": 0.015,
            "loop.min_neighbour_score": 0.05,
            "loop.max_hamming": 79,
            "loop.max_ratio": 1.0,
            "loop.cross_check": False,
            "loop.min_matches": 26,
            "loop.epipolar": "off",
            "loop.guided_px": 0.0,
            "loop.pnp_px": 10.0,
            "loop.max_rms_px": 20.0,
            "loop.max_sigma_m": 100.0,
            "loop.max_tilt_deg": 180.0,
            "loop.heading": "euler",
            "loop.consistency": False,
        },
        "seed": {
            **_VINS_LIMITS,
            "loop.every": 3,
            "loop.max_corners": 500,
            "loop.min_matches": 26,
            "loop.epipolar": "fundamental",
            "loop.epipolar_px": 5.0,
            "loop.epipolar_confidence": 0.99,
        },
    }
)
