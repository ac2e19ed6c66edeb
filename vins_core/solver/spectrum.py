"""What a matrix of information knows, and what it claims to know but cannot (SPEC 6.2).

Camera and IMU see neither where the whole window is nor which way it faces: along the four gauge directions

    x, y, z:  dp_k = e,                                           1 m for every frame k
    yaw:      dp_k = e_z x (p_k - c),  dtheta_k = R_k' e_z,  dv_k = e_z x v_k,        1 rad about the centroid c

every factor is constant, so its Jacobian maps them to zero, n(x)' J'J n(x) = 0, as long as J was taken at the same x.
A prior is made of Jacobians that were taken at different times.  n moves with the estimates, J does not, and what is
left of J n counts as knowledge: the information that leaked (Huang, Mourikis, Roumeliotis 2008; Hesch et al. 2013).
x, y and z do not depend on the estimates and never leak; yaw does.

All functions take a square root J of the information, because J'J itself cannot hold a small leak beside bias
information of 1e15.  Blocks are anything with `kind` ("pose", "speed_bias", "extrinsic", "td") and `size`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import qr

from ..factors.prior import difference_poses, inverse_right_jacobian
from ..geometry import so3

GAUGE = ("x", "y", "z", "yaw")
"""The four directions, in the order of every array of four; 1/m^2 for the first three, 1/rad^2 for yaw."""

UP = np.array([0.0, 0.0, 1.0])


class Block(Protocol):
    @property
    def kind(self) -> str: ...
    @property
    def size(self) -> int: ...


@dataclass(frozen=True)
class Spectrum:
    """Eigen-decomposition of the information J'J."""

    eigenvalues: np.ndarray  # (n,) ascending
    vectors: np.ndarray  # (n, n) column k belongs to eigenvalue k
    rank: int  # eigenvalues above the threshold

    @property
    def condition(self) -> float:
        """Largest over smallest eigenvalue that counts; NaN when none does."""
        known = self.eigenvalues[len(self.eigenvalues) - self.rank :]
        return float(known[-1] / known[0]) if len(known) else float("nan")


@dataclass(frozen=True)
class Leakage:
    """What the information says about the gauge directions."""

    information: np.ndarray  # (4,) |J n|^2 per unit direction: 1/m^2, 1/rad^2
    relative: np.ndarray  # (4,) over what the blocks know of their own part of n: 0 free, 1 as if they were independent
    wish: np.ndarray  # (4,) how far along n the residual would like to go, m and rad; NaN where J n is zero

    @property
    def sigma(self) -> np.ndarray:
        """(4,) the standard deviation that is claimed, m and rad; infinite when free."""
        with np.errstate(divide="ignore"):
            return 1.0 / np.sqrt(self.information)


@dataclass(frozen=True)
class Pull:
    """What a least-squares term wants of variables that are held where they are."""

    floor: float  # the part of 1/2 |r|^2 that stays unless they move, all others being free
    wish: np.ndarray  # (k,) where they would go
    sigma: np.ndarray  # (k,) how well that is known; NaN where it is not


def spectrum(J: np.ndarray, threshold: float) -> Spectrum:
    """Eigenvalues of J'J at or below `threshold` count as zero."""
    _, singular, Vt = np.linalg.svd(J)
    eigenvalues = np.zeros(J.shape[1])
    eigenvalues[: len(singular)] = singular**2
    return Spectrum(eigenvalues[::-1], Vt[::-1].T, int((eigenvalues > threshold).sum()))


def gauge_directions(blocks: Sequence[Block], values: Sequence[np.ndarray]) -> np.ndarray:
    """(n, 4) tangents of the gauge directions at the values of the blocks, (7,), (9,) or (1,) each."""
    poses = [x[:3] for b, x in zip(blocks, values) if b.kind == "pose"]
    centroid = np.mean(poses, axis=0) if poses else np.zeros(3)
    rows = [np.zeros((b.size, 4)) for b in blocks]
    for n, b, x in zip(rows, blocks, values):
        if b.kind == "pose":
            n[:3, :3] = np.eye(3)
            n[:3, 3] = np.cross(UP, x[:3] - centroid)
            n[3:, 3] = so3.rotate(so3.inverse(x[3:]), UP)
        elif b.kind == "speed_bias":
            n[:3, 3] = np.cross(UP, x[:3])
    return np.concatenate(rows) if rows else np.zeros((0, 4))


def jacobian_at(
    J: np.ndarray, blocks: Sequence[Block], x0: Sequence[np.ndarray], x: Sequence[np.ndarray]
) -> np.ndarray:
    """J of r + J (x [-] x0) with respect to the tangent at x instead of x0."""
    J, start = J.copy(), 0
    for block, a, b in zip(blocks, x0, x):
        if block.kind in ("pose", "extrinsic"):
            turn = slice(start + 3, start + 6)
            phi = difference_poses(b[None], a[None])[:, 3:]
            J[:, turn] = J[:, turn] @ inverse_right_jacobian(phi)[0]
        start += block.size
    return J


def leakage(J: np.ndarray, r: np.ndarray, blocks: Sequence[Block], values: Sequence[np.ndarray]) -> Leakage:
    """J (rows, n) and r (rows,) over `blocks`, J with respect to the tangent at `values`."""
    n = gauge_directions(blocks, values)
    Jn = J @ n
    information = np.square(Jn).sum(0)
    alone, start = np.zeros(4), 0
    for b in blocks:
        part = slice(start, start + b.size)
        alone += np.square(J[:, part] @ n[part]).sum(0)
        start += b.size
    with np.errstate(divide="ignore", invalid="ignore"):
        return Leakage(information, np.where(alone > 0, information / alone, 0.0), -(r @ Jn) / information)


def pull(J: np.ndarray, r: np.ndarray, held: np.ndarray) -> Pull:
    """What 1/2 |r + J d|^2 wants of d = `held` @ e, held (n, k) orthonormal, while all else in d adapts freely.

    Rows that only the held directions can change are found by projecting out the range of the others (columns scaled
    to one, so that units do not decide about rank).
    """
    Q = np.linalg.qr(held, mode="complete")[0]
    others = J @ Q[:, held.shape[1] :]
    norms = np.linalg.norm(others, axis=0)
    Q, R, _ = qr(others / np.where(norms > 0, norms, 1.0), pivoting=True, check_finite=False)
    rank = int(np.sum(np.abs(R.diagonal()) > 1e-10))
    A, b = Q[:, rank:].T @ (J @ held), Q[:, rank:].T @ r
    U, s, Vt = np.linalg.svd(A)
    known = int(np.sum(s > 1e-9 * s.max(initial=1e-300)))
    V, inverse = Vt[:known].T, 1.0 / s[:known]
    sigma = np.sqrt(np.square(V * inverse).sum(1))
    vague = np.square(Vt[known:]).sum(0) > 1e-9
    return Pull(0.5 * float(b @ b), -V @ (inverse * (U[:, :known].T @ b)), np.where(vague, np.nan, sigma))
