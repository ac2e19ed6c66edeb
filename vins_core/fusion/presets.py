"""Sets of `gps` parameters that belong together, as `section.name -> value`.

`parity`: VINS-Fusion's global_fusion (REFERENCE 19).  All six degrees of freedom, 0.1 m and 0.01 rad of odometry error
**per frame** whatever the rate, the first entry of a fix' covariance taken for a standard deviation (1 m if it is not
positive), Huber(1) and no gate, no lever arm.  So at 20 Hz the trajectory is soft and follows the fixes' noise
(REFERENCE 23.17), and a large outlier pulls it.  What is not reproduced, since it is a defect and no setting: that
nothing is ever marginalised, so every optimisation costs more than the last (H4; `smooth` is that optimisation, once);
that the heading starts at zero instead of from the motion (H6); that a fix more than 10 ms from any frame is lost (H2).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from types import MappingProxyType
from typing import Any

PRESETS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "parity": {
            "gps.dof": "6",
            "gps.min_status": -1,
            "gps.min_sigma_m": 1e-4,
            "gps.max_sigma_m": 1000.0,
            "gps.assumed_sigma_m": 1.0,
            "gps.covariance": "sigma",
            "gps.max_chi2": 1e9,
            "gps.min_fixes": 3,
            "gps.max_yaw_sigma_deg": 180.0,
            "gps.full_yaw_sigma_deg": 180.0,
            "gps.min_used_share": 0.0,
            "gps.lever_arm": False,
            "gps.noise": "frame",
            "gps.frame_sigma_m": 0.1,
            "gps.frame_sigma_deg": degrees(0.01),
            "gps.tilt_sigma_deg": 90.0,
            "gps.scale_sigma": 0.0,
            "gps.loss": "huber",
            "gps.loss_scale": 1.0,
            "gps.max_iterations": 5,
        }
    }
)
