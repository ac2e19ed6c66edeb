"""Sets of `pose_graph` parameters that belong together, as `section.name -> value`.

`parity`: the pose graph of VINS-Mono, whose residuals are in metres and degrees (REFERENCE Q2-Q4).
`parity-6dof`: that of VINS-Fusion without an IMU (REFERENCE Q6).
`seed`: the founding document (seeds 000.3.3.5 and 000.4): five previous keyframes, loops five times as heavy, the
robust loss on the residual before that weight.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from types import MappingProxyType
from typing import Any

_CERES = {"pose_graph.max_iterations": 5, "pose_graph.initial_radius": 1e4}
_HUBER = {"pose_graph.loss": "huber", "pose_graph.loss_scale": 0.1}

PRESETS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "parity": {
            "pose_graph.dof": "4",
            "pose_graph.sequential_edges": 4,
            "pose_graph.sigma_m": 1.0,
            "pose_graph.sigma_deg": 1.0,
            "pose_graph.loop_weight": 1.0,
            "pose_graph.loop_rotation_weight": 0.1,
            "pose_graph.loss_on": "weighted",
            **_HUBER,
            **_CERES,
        },
        "parity-6dof": {
            "pose_graph.dof": "6",
            "pose_graph.sequential_edges": 4,
            "pose_graph.sigma_m": 0.1,
            "pose_graph.sigma_deg": degrees(0.01),
            "pose_graph.loop_weight": 1.0,
            "pose_graph.loop_rotation_weight": 1.0,
            "pose_graph.loss_on": "weighted",
            **_HUBER,
            **_CERES,
        },
        "seed": {
            "pose_graph.dof": "4",
            "pose_graph.sequential_edges": 5,
            "pose_graph.sigma_m": 1.0,
            "pose_graph.sigma_deg": 1.0,
            "pose_graph.loop_weight": 5.0,
            "pose_graph.loop_rotation_weight": 1.0,
            "pose_graph.loss_on": "unweighted",
            **_HUBER,
            **_CERES,
        },
    }
)
