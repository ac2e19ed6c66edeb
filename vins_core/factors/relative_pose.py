"""The relative pose of two keyframes, measured in the frame of the earlier one: the edges of the pose graph.

4-DoF (seeds 000.3.3.5 and 000.4, REFERENCE Q2).  The IMU knows roll and pitch, so a keyframe keeps those of its
odometry pose (p^o, R^o) and has the variables x = (p, psi), psi being a turn of that pose about gravity:
T_w_b = (p, Rz(psi) R^o).  With the measurement (p_ij, R_ij),

    r = [ w_p (Rz(psi_i)' (p_j - p_i) - R^o_i p_ij) ],      t_ij = turn(R^o_i R_ij R^o_j')
        [ w_r (psi_j - psi_i - t_ij)                ]

The position is compared along the axes of the odometry's world, which costs the same as along those of keyframe i
(one weight for all axes) and leaves z apart from everything else.  psi is never read from an attitude, so no mounting
of the IMU is singular; an edge of the odometry itself has t_ij = 0.

6-DoF (REFERENCE Q6): variables T_w_b, and

    r = [ w_p (R_i' (p_j - p_i) - p_ij)    ]
        [ w_r 2 vec(q_ij^-1 q_i^-1 q_j)    ]
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from ..geometry import heading, so3
from .factor import Factor, pose, vector
from .symbolic import conjugate, multiply


def _four_dof(values: list, data: ca.SX) -> ca.SX:
    x_i, x_j = values
    moved, turned, w_p, w_r = ca.vertsplit(data, [0, 3, 4, 5, 6])
    d = x_j - x_i
    c, s = ca.cos(x_i[3]), ca.sin(x_i[3])
    seen = ca.vertcat(c * d[0] + s * d[1], c * d[1] - s * d[0], d[2])
    return ca.vertcat(w_p * (seen - moved), w_r * (d[3] - turned))


def _six_dof(values: list, data: ca.SX) -> ca.SX:
    pose_i, pose_j = values
    p_ij, q_ij, w_p, w_r = ca.vertsplit(data, [0, 3, 7, 8, 9])
    q_error = multiply(conjugate(q_ij), multiply(conjugate(pose_i.q), pose_j.q))
    return ca.vertcat(
        w_p * (pose_i.inverse_rotate(pose_j.p - pose_i.p) - p_ij),
        w_r * 2 * q_error[1:],
    )


FOUR_DOF = Factor("relative_pose_4dof", (vector("node_i", 4), vector("node_j", 4)), 6, _four_dof)
"""Nodes are (x, y, z, psi); residual (m, rad) times (w_p, w_r)."""
SIX_DOF = Factor("relative_pose_6dof", (pose("pose_i"), pose("pose_j")), 9, _six_dof)

ACTIVE_4 = tuple(b.name for b in FOUR_DOF.blocks)
ACTIVE_6 = tuple(b.name for b in SIX_DOF.blocks)


def measurement_4dof(
    q_odometry_i: np.ndarray, q_odometry_j: np.ndarray, T_i_j: np.ndarray, w_p: np.ndarray, w_r: np.ndarray
) -> np.ndarray:
    """The data of `FOUR_DOF`, one column per edge, (6, e).

    q_odometry (e, 4): attitudes of both ends in the odometry; T_i_j (e, 7): (p, q wxyz); w_p in 1/m, w_r in 1/rad.
    """
    seen_from_j = so3.multiply(so3.multiply(q_odometry_i, T_i_j[:, 3:]), so3.inverse(q_odometry_j))
    moved = so3.rotate(q_odometry_i, T_i_j[:, :3])
    return np.concatenate([moved.T, heading.turn(seen_from_j)[None], w_p[None], w_r[None]])


def measurement_6dof(T_i_j: np.ndarray, w_p: np.ndarray, w_r: np.ndarray) -> np.ndarray:
    """The data of `SIX_DOF`, one column per edge, (9, e)."""
    return np.concatenate([T_i_j.T, w_p[None], w_r[None]])
