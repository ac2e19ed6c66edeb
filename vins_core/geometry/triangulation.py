"""Points from unit rays of several views: the homogeneous linear least squares of Hartley & Zisserman 12.2.

A view with T_c_a = [R t] and unit ray r constrains the homogeneous point X in frame a by

    (I - r r') [R t] X = 0,

two independent equations whatever the direction of the ray, so that rays beyond 90 degrees need no special case.
X is the right singular vector of the stacked equations with the smallest singular value (REFERENCE W8, seed 000.2.6).
A point is behind a camera or at infinity when the rays say so: signs, bounds and replacements are the caller's.
"""

import numpy as np

from . import inverse_depth, se3


def triangulate_tracks(
    T_w_c: np.ndarray, track: np.ndarray, slot: np.ndarray, rays: np.ndarray, anchor_slot: np.ndarray
) -> np.ndarray:
    """Depths of m tracks in their anchor cameras (inverse_depth.py), (m,) metres; negative behind the camera.

    T_w_c (k, 4, 4): camera poses; track (N,), slot (N,): row of the track and of the pose of each observation;
    rays (N, 3): unit rays in the observing camera; anchor_slot (m,): the camera in which depth is measured,
    along its own ray of the track if it has one.
    A track observes a slot at most once.  NaN for tracks with fewer than two observations; what comes out without
    parallax is arbitrary.
    """
    m, k = len(anchor_slot), len(T_w_c)
    T_c_a = se3.inverse(T_w_c)[:, None] @ T_w_c[None]  # (observing, anchor, 4, 4)
    equations = np.zeros((m, k, 3, 4))
    equations[track, slot] = _equations(T_c_a[slot, anchor_slot[track]], rays)
    X = _null_vectors(equations.reshape(m, 3 * k, 4))
    anchor_rays = np.tile([0.0, 0.0, 1.0], (m, 1))
    own = slot == anchor_slot[track]
    anchor_rays[track[own]] = rays[own]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = inverse_depth.depth(anchor_rays, X[:, :3]) / X[:, 3]
    return np.where(np.bincount(track, minlength=m) >= 2, depth, np.nan)


def triangulate_pair(T_a_w: np.ndarray, T_b_w: np.ndarray, rays_a: np.ndarray, rays_b: np.ndarray) -> np.ndarray:
    """Points in the world (n, 3) seen along unit rays (n, 3) by two cameras with poses (4, 4) or (n, 4, 4)."""
    T_w_a, T_b_a = se3.inverse(T_a_w), T_b_w @ se3.inverse(T_a_w)
    equations = np.concatenate([_equations(np.eye(4), rays_a), _equations(T_b_a, rays_b)], axis=1)
    X = _null_vectors(equations)
    with np.errstate(divide="ignore", invalid="ignore"):
        points_a = X[:, :3] / X[:, 3:]
    return se3.transform(T_w_a, points_a)


def _equations(T_c_a: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(I - r r') [R t], (n, 3, 4)."""
    P = np.broadcast_to(T_c_a[..., :3, :], (len(rays), 3, 4))
    return P - rays[:, :, None] * np.einsum("ni,nij->nj", rays, P)[:, None]


def _null_vectors(A: np.ndarray) -> np.ndarray:
    """Unit X (m, 4) minimising |A X| for each of (m, rows, 4)."""
    return np.linalg.eigh(np.swapaxes(A, -1, -2) @ A)[1][..., 0]
