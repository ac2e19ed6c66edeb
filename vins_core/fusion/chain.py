"""Moments, the odometry between them and the fixes at them, as one least-squares problem on a chain.

    cost(x) = d_0' L d_0 / 2 + g_0' d_0  +  sum_k |r_k,k+1|^2_Q / 2  +  sum_m rho(|r_m|^2_R) / 2

over nodes x = (p_e_b, q_e_o, s), rows of eight numbers, and the fixes m that are used, with the residuals of
factors/gps.py and d_0 = x_0 [-] the point at which the prior on the first node was linearised.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .. import params
from ..factors.factor import Batch
from ..factors.gps import ACTIVE_ANTENNA, ACTIVE_DRIFT, ANTENNA, DRIFT
from ..factors.robust import Loss
from ..geometry import heading, so3
from .drift import SCALE, SIZE, Increment


@dataclass(frozen=True)
class Prior:
    """What is known of the first node: g'd + d'L d / 2 with d = x [-] at, in the free components."""

    at: np.ndarray  # (8,)
    gradient: np.ndarray  # (t,)
    information: np.ndarray  # (t, t)


@dataclass(frozen=True)
class Fixes:
    """m fixes in frame `e`, each at a node."""

    node: np.ndarray  # (m,) int64
    lever_o: np.ndarray  # (m, 3) from the node's body to the antenna when the fix was taken
    z_e: np.ndarray  # (m, 3)
    covariance: np.ndarray  # (m, 3, 3)

    def __len__(self) -> int:
        return len(self.node)


@dataclass(frozen=True)
class Chain:
    """n nodes in order of time."""

    free: np.ndarray  # (t,) components of a node's tangent (dp, dtheta, ds) that are estimated
    increments: Increment  # (n - 1,)
    fixes: Fixes
    prior: Prior
    loss: Loss

    def __len__(self) -> int:
        return len(self.increments.kept) + 1

    @cached_property
    def increment_information(self) -> np.ndarray:
        """Q^-1 of the free components, (n - 1, t, t)."""
        return np.linalg.inv(self.increments.covariance[:, self.free[:, None], self.free])

    @cached_property
    def fix_information(self) -> np.ndarray:
        """R^-1, (m, 3, 3)."""
        return np.linalg.inv(self.fixes.covariance)

    @property
    def increment_data(self) -> np.ndarray:
        """(7, n - 1) data of `DRIFT`."""
        i = self.increments
        return np.concatenate([i.moved_o.T, i.stretched_o.T, i.kept[None]])

    @property
    def fix_data(self) -> np.ndarray:
        """(6, m) data of `ANTENNA`."""
        return np.concatenate([self.fixes.lever_o.T, self.fixes.z_e.T])


def free_components(settings: params.Gps) -> np.ndarray:
    """Which of (dp, dtheta, ds) are estimated: with 4 DoF no inclination, with a certain scale no scale."""
    tilt = (3, 4) if settings.dof == "6" else ()
    return np.array([0, 1, 2, *tilt, 5, *((SCALE,) if settings.scale_sigma > 0 else ())])


def first_prior(settings: params.Gps, at: np.ndarray) -> Prior:
    """Nothing is known but how far inclination and scale can be off."""
    free = free_components(settings)
    information = np.zeros(SIZE)
    information[3:5] = np.deg2rad(settings.tilt_sigma_deg) ** -2
    information[SCALE] = max(settings.scale_sigma, 1e-9) ** -2
    return Prior(at, np.zeros(len(free)), np.diag(information[free]))


def retract(free: np.ndarray, x: np.ndarray, d: np.ndarray) -> np.ndarray:
    """x [+] d for nodes (n, 8) and d (n, t)."""
    full = np.zeros((*d.shape[:-1], SIZE))
    full[..., free] = d
    q = so3.retract(x[..., 3:7], full[..., 3:6])
    return np.concatenate([x[..., :3] + full[..., :3], q, x[..., 7:] + full[..., 6:]], -1)


def difference(free: np.ndarray, x: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """d with x = reference [+] d."""
    turned = so3.difference(x[..., 3:7], reference[..., 3:7])
    d = np.concatenate([x[..., :3] - reference[..., :3], turned, x[..., 7:] - reference[..., 7:]], -1)
    return d[..., free]


def predict(x: np.ndarray, increment: Increment) -> np.ndarray:
    """Where the odometry says that a node (8,) went."""
    way_o = increment.moved_o + x[7] * increment.stretched_o
    return np.concatenate([x[:3] + so3.rotate(x[3:7], way_o), x[3:7], [increment.kept * x[7]]])


def predict_covariance(x: np.ndarray, increment: Increment, covariance: np.ndarray) -> np.ndarray:
    """Covariance (7, 7) of `predict`, dp in the axes of `e`, from that of x."""
    A = to_e(x)
    Q = increment.covariance
    F = A @ increment.transition @ A.T
    return F @ covariance @ F.T + A @ Q @ A.T


def to_e(x: np.ndarray) -> np.ndarray:
    """(7, 7) that turns dp of an error state from the axes of `o` to those of `e`."""
    A = np.eye(SIZE)
    A[:3, :3] = so3.to_matrix(x[3:7])
    return A


def full_covariance(free: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(..., t, t) -> (..., 7, 7), zero where nothing is estimated."""
    full = np.zeros((*covariance.shape[:-2], SIZE, SIZE))
    full[..., free[:, None], free] = covariance
    return full


@dataclass(frozen=True)
class NormalEquations:
    """At one point: H d = -g is the Gauss-Newton step."""

    cost: float
    g: np.ndarray  # (n, t)
    diagonal: np.ndarray  # (n, t, t)
    above: np.ndarray  # (n - 1, t, t) block (k, k + 1)


class Linearizer:
    """Evaluates one chain at different nodes and with different fixes in use.  Not for use by several threads."""

    def __init__(self, chain: Chain):
        self.chain = chain
        n, m, free = len(chain), len(chain.fixes), chain.free
        self._drift = DRIFT.batch(n - 1, ACTIVE_DRIFT) if n > 1 else None
        self._antenna = ANTENNA.batch(m, ACTIVE_ANTENNA) if m else None
        if self._drift:
            self._drift.data[:] = chain.increment_data
        if self._antenna:
            self._antenna.data[:] = chain.fix_data
        self._rotation = free[free < SCALE]  # columns of a pose's tangent
        self._n_pose = len(self._rotation)

    def antenna(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual (m, 3) and Jacobian (m, 3, t) of every fix, used or not."""
        m, t = len(self.chain.fixes), len(self.chain.free)
        J = np.zeros((m, 3, t))
        if not self._antenna:
            return np.zeros((0, 3)), J
        self._antenna.inputs[0][:] = x[self.chain.fixes.node, :7].T
        self._antenna.evaluate()
        system = self._antenna.system
        J[:, :, : self._n_pose] = system[self._rotation].transpose(2, 1, 0)
        return system[-1].T.copy(), J

    def weights(self, r: np.ndarray, used: np.ndarray) -> np.ndarray:
        """rho' of every fix, (m,): 1 = counts in full, 0 = not used."""
        return np.where(used, self.chain.loss.weight(self.squared(r)) ** 2, 0.0)

    def squared(self, r: np.ndarray) -> np.ndarray:
        """|r|^2_R, (m,)."""
        return np.einsum("ma,mab,mb->m", r, self.chain.fix_information, r)

    def linearize(self, x: np.ndarray, used: np.ndarray) -> NormalEquations:
        """Normal equations at nodes (n, 8) with the fixes of the mask (m,)."""
        chain, free = self.chain, self.chain.free
        n, t = len(chain), len(free)
        g, diagonal = np.zeros((n, t)), np.zeros((n, t, t))

        d = difference(free, x[0], chain.prior.at)
        Ld = chain.prior.information @ d
        g[0], diagonal[0] = chain.prior.gradient + Ld, chain.prior.information
        cost = float(chain.prior.gradient @ d + 0.5 * d @ Ld)

        r, J = self.antenna(x)
        W = self.weights(r, used)[:, None, None] * chain.fix_information
        JW = np.einsum("mrt,mrs->mts", J, W)
        np.add.at(g, chain.fixes.node, np.einsum("mts,ms->mt", JW, r))
        np.add.at(diagonal, chain.fixes.node, JW @ J)
        cost += 0.5 * float(np.sum(chain.loss.rho(self.squared(r))[used]))

        above = np.zeros((n - 1, t, t))
        if self._drift:
            J_i, J_j, r = self._increments(self._drift, x)
            W = chain.increment_information
            WJ_i, WJ_j, Wr = W @ J_i, W @ J_j, np.einsum("ers,es->er", W, r)
            g[:-1] += np.einsum("ert,er->et", J_i, Wr)
            g[1:] += np.einsum("ert,er->et", J_j, Wr)
            diagonal[:-1] += np.swapaxes(J_i, 1, 2) @ WJ_i
            diagonal[1:] += np.swapaxes(J_j, 1, 2) @ WJ_j
            above = np.swapaxes(J_i, 1, 2) @ WJ_j
            cost += 0.5 * float(np.sum(r * Wr))
        return NormalEquations(cost, g, diagonal, above)

    def _increments(self, batch: Batch, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """J_i and J_j (n - 1, t, t) and r (n - 1, t): rows and columns of the free components."""
        for k, part in enumerate((x[:-1, :7], x[:-1, 7:], x[1:, :7], x[1:, 7:])):
            batch.inputs[k][:] = part.T
        batch.evaluate()
        free = self.chain.free
        system = batch.system[:, free]
        J = system[:-1].transpose(2, 1, 0)
        return J[:, :, free], J[:, :, SIZE + free], system[-1].T


def marginalize_first(chain: Chain, x: np.ndarray, used: np.ndarray) -> Prior:
    """The prior that the first node leaves on the second: its prior, its fixes and the odometry between them."""
    first = np.flatnonzero(chain.fixes.node == 0)
    f = chain.fixes
    pair = Chain(
        chain.free,
        chain.increments[:1],
        Fixes(f.node[first], f.lever_o[first], f.z_e[first], f.covariance[first]),
        chain.prior,
        chain.loss,
    )
    at = Linearizer(pair).linearize(x[:2], used[first])
    gain = np.linalg.solve(at.diagonal[0], np.column_stack([at.g[0], at.above[0]]))
    g = at.g[1] - at.above[0].T @ gain[:, 0]
    information = at.diagonal[1] - at.above[0].T @ gain[:, 1:]
    return Prior(x[1].copy(), g, 0.5 * (information + information.T))


def node_at(p_e_b: np.ndarray, yaw_rad: float) -> np.ndarray:
    """A node (8,) whose odometry is turned about the vertical by yaw, and right about the scale."""
    return np.concatenate([p_e_b, heading.about_gravity(yaw_rad), [0.0]])
