"""The visual residual: a landmark anchored in a camera of frame i, seen again, by whichever camera, in frame j.

With b_i the anchor's ray scaled to z = 1 (or of unit length where it has no place on the normalised plane, see
geometry/inverse_depth.py), lambda the inverse depth and p_c the landmark in the camera that sees it again, there are
three kinds (REFERENCE O11):

    mono    p_c = T_b_c^-1  T_w_bj^-1 T_w_bi T_b_c  (b_i / lambda)     the same camera in another frame
    cross   p_c = T_b_c2^-1 T_w_bj^-1 T_w_bi T_b_c1 (b_i / lambda)     another camera in another frame
    same    p_c = T_b_c2^-1 T_b_c1 (b_i / lambda)                      another camera in the same frame

    plane:   r = (p_c.xy / p_c.z - f_j.xy / f_j.z) / sigma                         (REFERENCE O4)
    sphere:  r = [b_1 b_2]' (p_c / |p_c| - f_j) / sigma                            (seed 000.3.3.3)

where b_1, b_2 span the tangent plane of the unit sphere at the measured ray f_j.  Both do not change when p_c is
scaled, so the chain carries lambda p_c in homogeneous form: lambda = 0 is a point at infinity, nothing divides by it.
The sphere form takes any ray f_j, the plane form needs f_j.z > 0.

Where the time offset td is a variable, both rays are those at the time of their poses (REFERENCE O7): with x =
f.xy / f.z and its velocity v, x(td) = x - (td - td_0) v, where the rays given are those at td_0.  The unit ray moves
with df/dt = z ((v, 0) - f (f'(v, 0))).
"""

from __future__ import annotations

from typing import Literal

import casadi as ca
import numpy as np

from ..geometry.inverse_depth import MIN_RAY_Z, bearing
from .factor import Block, Factor, pose, vector
from .symbolic import Pose

FOCAL_PX = 460.0
"""Focal length of the virtual camera in which pixel thresholds are stated ("px460")."""

Kind = Literal["mono", "cross", "same"]

BLOCKS = (pose("pose_i"), pose("pose_j"), pose("extrinsic"), vector("inv_depth", 1))
CROSS_BLOCKS = (*BLOCKS[:2], pose("extrinsic_i"), pose("extrinsic_j"), BLOCKS[3])
SAME_BLOCKS = CROSS_BLOCKS[2:]
TD = vector("td", 1)


def _point_in_camera_j(values: list, anchor: ca.SX) -> ca.SX:
    """lambda p_c, (3,)."""
    *poses, inv_depth = values
    extrinsics = poses[2:] or poses  # of one camera, or of two; `same` has no other poses
    point = extrinsics[0].act(anchor, inv_depth)
    if len(poses) > 2:
        pose_i, pose_j = poses[:2]
        assert isinstance(pose_i, Pose)
        point = pose_j.inverse_act(pose_i.act(point, inv_depth), inv_depth)
    return extrinsics[-1].inverse_act(point, inv_depth)


def _plane(values: list, data: ca.SX) -> ca.SX:
    anchor, observed_xy, sqrt_info = ca.vertsplit(data, [0, 3, 5, 6])
    p = _point_in_camera_j(values, anchor)
    return sqrt_info * (p[:2] / p[2] - observed_xy)


def _sphere(values: list, data: ca.SX) -> ca.SX:
    anchor, b1, b2, sqrt_info = ca.vertsplit(data, [0, 3, 6, 9, 10])
    p = _point_in_camera_j(values, anchor)
    return sqrt_info * ca.vertcat(ca.dot(b1, p), ca.dot(b2, p)) / ca.norm_2(p)


def _both_forms(suffix: str, blocks: tuple[Block, ...]) -> dict[str, Factor]:
    return {
        "plane": Factor(f"reprojection_plane{suffix}", blocks, 6, _plane),
        "sphere": Factor(f"reprojection_sphere{suffix}", blocks, 10, _sphere),
    }


FACTORS = _both_forms("", BLOCKS)
KINDS: dict[Kind, dict[str, Factor]] = {
    "mono": FACTORS,
    "cross": _both_forms("_cross", CROSS_BLOCKS),
    "same": _both_forms("_same", SAME_BLOCKS),
}
"""kind -> form -> factor."""


def _with_td(held: Factor) -> Factor:
    """`held` with td as a variable before the inverse depth; to its data comes what `motion` gives."""
    n = held.n_data

    def residual(values: list, data: ca.SX) -> ca.SX:
        *cameras, td, inv_depth = values
        anchor, rest, moves_anchor, moves_r, td_0 = ca.vertsplit(data, [0, 3, n, n + 3, n + 5, n + 6])
        late = td - td_0
        r = held.residual([*cameras, inv_depth], ca.vertcat(anchor - late * moves_anchor, rest))
        return r + late * moves_r

    return Factor(f"{held.name}_td", (*held.blocks[:-1], TD, held.blocks[-1]), n + 6, residual)


TIMED: dict[Kind, dict[str, Factor]] = {
    kind: {form: _with_td(factor) for form, factor in forms.items()} for kind, forms in KINDS.items()
}
"""The same with the time offset as a variable."""


def tangent_basis(rays: np.ndarray) -> np.ndarray:
    """Two orthonormal directions orthogonal to each unit ray, (n, 3) -> (n, 2, 3).

    The first leans towards the axis (x or y) that the ray is furthest from, so it is never degenerate.
    """
    rays = np.asarray(rays, float)
    use_x = np.abs(rays[:, 0]) <= np.abs(rays[:, 1])
    axis = np.where(use_x[:, None], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    b1 = axis - rays * np.sum(axis * rays, 1, keepdims=True)
    b1 /= np.linalg.norm(b1, axis=1, keepdims=True)
    return np.stack([b1, np.cross(rays, b1)], 1)


def measurement(form: str, rays_i: np.ndarray, rays_j: np.ndarray, sqrt_info: float) -> np.ndarray:
    """The data of the factor, one column per projection, (n_data, n).

    `rays_i`, `rays_j` (n, 3) are unit rays in the anchoring and in the observing camera; `sqrt_info` is 1/sigma of a
    normalised coordinate (plane) or of an angle in radians (sphere): FOCAL_PX / (sigma in px460).
    """
    anchor = bearing(rays_i)
    scale = np.full((1, len(rays_i)), sqrt_info)
    if form == "plane":
        return np.concatenate([anchor.T, (rays_j[:, :2] / rays_j[:, 2:]).T, scale])
    return np.concatenate([anchor.T, tangent_basis(rays_j).reshape(-1, 6).T, scale])


def motion(
    form: str,
    rays_i: np.ndarray,
    rays_j: np.ndarray,
    velocity_i: np.ndarray,
    velocity_j: np.ndarray,
    td_0: float,
    sqrt_info: float,
) -> np.ndarray:
    """What the factors with td take besides `measurement`, (6, n): how fast anchor and residual move, and td_0.

    Rays are those at td_0; `velocity_i`, `velocity_j` (n, 2) are their d(x/z, y/z)/dt, 1/s.
    """
    on_plane = np.column_stack([velocity_i, np.zeros(len(velocity_i))])
    moves_anchor = np.where(rays_i[:, 2:] > MIN_RAY_Z, on_plane, _turn(rays_i, velocity_i))  # as `bearing`
    moves_r = velocity_j.T
    if form != "plane":
        moves_r = np.einsum("nki,ni->kn", tangent_basis(rays_j), _turn(rays_j, velocity_j))
    return np.concatenate([moves_anchor.T, sqrt_info * moves_r, np.full((1, len(rays_j)), td_0)])


def _turn(rays: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """df/dt (n, 3) of unit rays."""
    along_plane = np.column_stack([rays[:, 2:] * velocity, np.zeros(len(rays))])
    return along_plane - rays * np.sum(rays * along_plane, 1, keepdims=True)
