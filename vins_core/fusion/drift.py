"""How odometry moves from one moment to another, and how its error grows on the way.

Odometry is good over metres and wrong over kilometres: position and heading do a random walk with the path, and the
scale is off by a share s that changes slowly, by a Gauss-Markov process of standard deviation sigma_s and length l.
Over a path of d metres, from p_o to p_o + m,

    p' = p + R_e_o (m + s a) + n_p,    R_e_o' = R_e_o Exp(n_theta),    s' = k s + n_s,    k = exp(-d / l)

with the error state (dp, dtheta, ds), dp and dtheta in the axes of `o`, so that nothing here depends on an estimate:

    F = [ I  -[m]x  a ]        Q = diag(sigma_p^2 d I, sigma_theta^2 d I, sigma_s^2 (1 - k^2))
        [ 0    I    0 ]
        [ 0    0    k ]

Increments in a row compose: what begins as noise of the heading ends as a position error across the path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import params
from ..geometry import so3

SIZE = 7
"""Of the error state: position, rotation, scale."""
ROTATION, TILT, SCALE = slice(3, 6), slice(3, 5), 6

REST_M = 1e-3
REST_RAD = 1e-5
"""Random walk per sqrt(s) of odometry at rest."""
MIN_SCALE_NOISE = 1e-7


@dataclass(frozen=True)
class Increment:
    """Odometry between two moments; arrays may have leading axes for many of them."""

    moved_o: np.ndarray  # (..., 3) m
    stretched_o: np.ndarray  # (..., 3) a: by how much more it moved for a scale of 1
    kept: np.ndarray  # (...) k: share of the scale's error that is still the same
    covariance: np.ndarray  # (..., 7, 7) Q

    def __post_init__(self) -> None:
        """Of single increments NumPy makes a number; it stays an array, as it is recorded."""
        object.__setattr__(self, "kept", np.asarray(self.kept, float))

    def __getitem__(self, rows: slice | np.ndarray) -> Increment:
        return Increment(self.moved_o[rows], self.stretched_o[rows], self.kept[rows], self.covariance[rows])

    @property
    def transition(self) -> np.ndarray:
        """F, (..., 7, 7)."""
        F = np.zeros((*self.kept.shape, SIZE, SIZE))
        F[...] = np.eye(SIZE)
        F[..., :3, ROTATION] = -so3.skew(self.moved_o)
        F[..., :3, SCALE] = self.stretched_o
        F[..., SCALE, SCALE] = self.kept
        return F


def nothing() -> Increment:
    """The increment from a moment to itself."""
    return Increment(np.zeros(3), np.zeros(3), np.ones(()), np.zeros((SIZE, SIZE)))


def between(settings: params.Gps, moved_o: np.ndarray, dt_s: np.ndarray | float) -> Increment:
    """Increments between consecutive frames, from how far the body moved in the odometry, (..., 3), and the time."""
    moved_o, dt_s = np.asarray(moved_o, float), np.asarray(dt_s, float)
    variance = np.zeros((*moved_o.shape[:-1], SIZE))
    if settings.noise == "frame":
        kept = np.ones(moved_o.shape[:-1])
        variance[..., :3] = settings.frame_sigma_m**2
        variance[..., ROTATION] = np.deg2rad(settings.frame_sigma_deg) ** 2
    else:
        d = np.linalg.norm(moved_o, axis=-1)
        kept = np.exp(-d / settings.scale_length_m)
        tilt, yaw = np.deg2rad([settings.tilt_walk_deg, settings.yaw_walk_deg])
        walk = np.array([settings.position_walk] * 3 + [tilt, tilt, yaw])
        rest = np.repeat([REST_M, REST_RAD], 3)
        variance[..., :6] = d[..., None] * walk**2 + dt_s[..., None] * rest**2
        variance[..., SCALE] = settings.scale_sigma**2 * (1.0 - kept**2)
    if settings.dof == "4":
        variance[..., TILT] = 0.0
    if settings.scale_sigma > 0:
        variance[..., SCALE] += MIN_SCALE_NOISE**2
    return Increment(moved_o, moved_o.copy(), kept, variance[..., None] * np.eye(SIZE))


def compose(first: Increment, second: Increment) -> Increment:
    """The increment over both ways."""
    F = second.transition
    return Increment(
        first.moved_o + second.moved_o,
        first.stretched_o + first.kept[..., None] * second.stretched_o,
        first.kept * second.kept,
        F @ first.covariance @ np.swapaxes(F, -1, -2) + second.covariance,
    )


def stack(increments: list[Increment]) -> Increment:
    """Many increments as one with a leading axis."""
    return Increment(
        np.array([i.moved_o for i in increments]).reshape(-1, 3),
        np.array([i.stretched_o for i in increments]).reshape(-1, 3),
        np.array([i.kept for i in increments]).reshape(-1),
        np.array([i.covariance for i in increments]).reshape(-1, SIZE, SIZE),
    )
