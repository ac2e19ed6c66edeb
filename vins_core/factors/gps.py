"""Odometry that drifts against the earth, and fixes that hold it: the two residuals of GPS fusion.

Frames: `o` the world of the odometry, `e` east-north-up at the first fix, `b` the body.  A node is what the odometry
cannot know of one moment: (p_e_b, q_e_o) as a pose block, where the body is and how the odometry's world is turned,
and s, by how much the odometry is too short.  R_e_b = R_e_o R_o_b.  The tangent turns R_e_o on the side of `o`, whose
z axis is vertical: its third component is yaw, the others are inclination, which a VIO has none of.

Position of the antenna (SPEC 8.2; VINS-Fusion's GPS factor has no lever arm, REFERENCE H6), with the way l_o from the
body to the antenna in the axes of `o`:

    r = p_e_b + R_e_o l_o - z_e                                                           [m]

Odometry from node i to node j, which moved by m_o, and by s a_o more (fusion/drift.py):

    r = [ R_e_o,i' (p_e_b,j - p_e_b,i) - m_o - s_i a_o ]                                  [m]
        [ 2 vec(q_e_o,i^-1 q_e_o,j)                    ]                                  [rad]
        [ s_j - k s_i                                  ]

Both are to be weighted with the covariance of their measurement.
"""

from __future__ import annotations

import casadi as ca

from .factor import Factor, pose, vector
from .symbolic import conjugate, multiply


def _antenna(values: list, data: ca.SX) -> ca.SX:
    (node,) = values
    lever_o, z_e = ca.vertsplit(data, [0, 3, 6])
    return node.p + node.rotate(lever_o) - z_e


def _drift(values: list, data: ca.SX) -> ca.SX:
    node_i, s_i, node_j, s_j = values
    moved_o, stretched_o, kept = ca.vertsplit(data, [0, 3, 6, 7])
    return ca.vertcat(
        node_i.inverse_rotate(node_j.p - node_i.p) - moved_o - s_i * stretched_o,
        2 * multiply(conjugate(node_i.q), node_j.q)[1:],
        s_j - kept * s_i,
    )


ANTENNA = Factor("gps_antenna", (pose("node"),), 6, _antenna)
"""Data: l_o (3,), z_e (3,)."""
DRIFT = Factor("gps_drift", (pose("node_i"), vector("scale_i", 1), pose("node_j"), vector("scale_j", 1)), 7, _drift)
"""Data: m_o (3,), a_o (3,), k."""

ACTIVE_ANTENNA = tuple(b.name for b in ANTENNA.blocks)
ACTIVE_DRIFT = tuple(b.name for b in DRIFT.blocks)
