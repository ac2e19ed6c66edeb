"""Does a loop fit what odometry allows?  Two rooms that look the same can be told apart by nothing else.

Every keyframe is a node with a pose and the covariance accumulated on the way to it, in SE(3) to first order
(Barfoot and Furgale 2014): T = Exp(xi) T_mean with twists xi = (rho, phi) in the axes of the map, so that

    along a way from i to j:    W_ij = W_j + W_i - 2 W_k        k the last node that both ways from the root share

Two ways lead to a node: by odometry alone, and by odometry and the loops accepted so far.  A loop that others agree
with ties its later keyframe to the earlier one when that way is the surer; from there on only the drift since counts.
A loop then has

    drift       d / f with d^2 = e' (W_ij + W_loop)^-1 e,  e = Log(T_loop T_predicted^-1),  6 degrees of freedom
    agreement   how many keyframes shortly before ask for a correction that is the same within the same bound

f is `drift_inflation`: the covariances are the estimator's claims, which are too small.  Increments of a fixed-lag
smoother are added as if they were independent, but biases, scale and landmarks are common to those within a window:
were they wholly so over a window of n keyframes, deviations would grow n^(1/2) times as fast, 3.2 for ten.  And one
increment is about twice as wrong as it claims even where all noise is as modelled, mostly because the ray by which an
anchor first saw its landmark counts as exact.

Beyond `max_drift` a loop is refused, however many agree: candidates in a wrong room agree with each other.  Between
`sure_drift` and that, or where no odometry joins two sessions, it waits until `min_agreement` other keyframes have
asked for the same.

Everything here is a function of values that the record keeps: poses, covariances, earlier decisions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..geometry import poses, so3
from ..params import Loop
from ..report import Gate, LoopCandidate, LoopOutcome, LoopReport
from . import gates


@dataclass(frozen=True)
class Motion:
    """A relative pose that is not known exactly: Exp(xi) T_a_b, xi a twist in the axes of a."""

    T_a_b: np.ndarray  # (7,) p and q wxyz
    covariance: np.ndarray  # (6, 6) of xi = (rho in m, phi in rad)

    def then(self, after: Motion) -> Motion:
        """T_a_c of T_a_b and T_b_c, whose errors are independent."""
        A = adjoint(self.T_a_b)
        covariance = self.covariance + A @ after.covariance @ A.T
        return Motion(poses.compose(self.T_a_b, after.T_a_b), covariance)

    @property
    def spread_m2(self) -> float:
        """Sum of the variances of the position of b."""
        S = np.hstack([np.eye(3), -so3.skew(self.T_a_b[:3])])
        return float(np.sum((S @ self.covariance) * S))


@dataclass(frozen=True)
class Way:
    """How a keyframe is reached from the root of its tree: after the keyframe before it, or by a loop."""

    motion: Motion  # from the map of the tree to the body
    tree: int  # the keyframe that is the root
    chain: int  # the first of the keyframes that follow one after the other up to this one
    tie: int  # the keyframe that a loop ties that first one to; -1: it is the root


@dataclass(frozen=True)
class Ask:
    """A loop that passes every gate but agreement: what it says of its two keyframes."""

    match: int
    loop: Motion  # T_match_query


@dataclass(frozen=True)
class Node:
    """A keyframe as consistency knows it."""

    odometry: Way
    tied: Way  # by odometry and loops
    asks: tuple[Ask, ...] = ()


Nodes = Callable[[int], Node]
"""Nodes by the number of their keyframe."""


@dataclass(frozen=True)
class Arrived:
    """Nodes and one more, that of keyframe k."""

    earlier: Nodes
    k: int
    node: Node

    def __call__(self, k: int) -> Node:
        return self.node if k == self.k else self.earlier(k)


def adjoint(T: np.ndarray) -> np.ndarray:
    """(6, 6) of T (7,): T Exp(xi) = Exp(Ad xi) T."""
    R = so3.to_matrix(T[3:])
    A = np.zeros((6, 6))
    A[:3, :3] = A[3:, 3:] = R
    A[:3, 3:] = so3.skew(T[:3]) @ R
    return A


def from_tangent(T_a_b: np.ndarray, covariance: np.ndarray) -> Motion:
    """From a covariance (6, 6) in the tangent (dp, dtheta): p + dp, q * Exp(dtheta)."""
    R, B = so3.to_matrix(T_a_b[3:]), np.eye(6)
    B[3:, 3:], B[:3, 3:] = R, so3.skew(T_a_b[:3]) @ R
    return Motion(T_a_b, B @ covariance @ B.T)


def tangent_covariance(motion: Motion) -> np.ndarray:
    """(6, 6) in the tangent (dp, dtheta)."""
    R, B = so3.to_matrix(motion.T_a_b[3:]), np.eye(6)
    B[3:, 3:], B[:3, 3:] = R.T, -so3.skew(motion.T_a_b[:3])
    return B @ motion.covariance @ B.T


def distance(a: Motion, b: Motion) -> float:
    """Mahalanobis distance between two independent statements about one relative pose, 6 degrees of freedom."""
    phi = so3.log(so3.multiply(a.T_a_b[3:], so3.inverse(b.T_a_b[3:])))
    rho = a.T_a_b[:3] - so3.rotate(so3.exp(phi), b.T_a_b[:3])
    P = a.covariance + b.covariance
    scale = 1.0 / np.sqrt(np.maximum(P.diagonal(), 1e-30))
    values, axes = np.linalg.eigh(P * np.outer(scale, scale))
    e = axes.T @ (np.concatenate([rho, phi]) * scale)
    return float(np.sqrt(np.sum(np.square(e) / np.maximum(values, 1e-12))))


def arrive(nodes: Nodes, k: int, T_w_b: np.ndarray, before: np.ndarray | None, odometry: np.ndarray | None) -> Arrived:
    """The nodes with that of keyframe k, about which nothing is decided yet.

    T_w_b (7,) and `before`, the pose of keyframe k - 1, in the odometry's world; `odometry` (6, 6) is the covariance
    of the motion between them, tangent (dp, dtheta).  Without it, k is the root of a tree.
    """
    if before is None or odometry is None:
        root = Way(Motion(T_w_b, np.zeros((6, 6))), k, k, -1)
        return Arrived(nodes, k, Node(root, root))
    moved, last = from_tangent(poses.between(before, T_w_b), odometry), nodes(k - 1)
    return Arrived(nodes, k, Node(_onwards(last.odometry, moved), _onwards(last.tied, moved)))


def judge(params: Loop, nodes: Arrived, candidate: LoopCandidate) -> LoopCandidate:
    """A candidate of the newest keyframe with its gates of consistency, and what was predicted of its pose."""
    if not params.consistency:
        return candidate
    if candidate.T_match_query is None or candidate.covariance is None:
        return _gated(candidate, gates.drift(params, None), gates.agreement(params, None))
    ask = Ask(candidate.match, from_tangent(candidate.T_match_query, candidate.covariance))
    predicted = relation(nodes, candidate.match, nodes.k)
    agreeing = _agreeing(params, nodes, ask)
    if predicted is None:
        bound = gates.drift(params, None, decides=False)
        return _gated(candidate, bound, gates.agreement(params, agreeing))
    drift = distance(ask.loop, predicted) / params.drift_inflation
    candidate = replace(candidate, T_predicted=predicted.T_a_b, predicted_covariance=tangent_covariance(predicted))
    confirmed = gates.agreement(params, agreeing, decides=drift > params.sure_drift)
    return _gated(candidate, gates.drift(params, drift), confirmed)


def settle(nodes: Arrived, report: LoopReport) -> Node:
    """The node of the newest keyframe once `report` has decided: what it asks for, and what it is tied to."""
    node = nodes.node
    if not all(g.passed for g in report.gates if g.decides):
        return node  # its candidates are not asked
    asks: list[Ask] = []
    for c in report.candidates:
        agreement = next((g for g in c.gates if g.name == "agreement"), None)
        if agreement is None or c.outcome not in (LoopOutcome.UNCONFIRMED, LoopOutcome.ACCEPTED):
            continue
        assert c.T_match_query is not None and c.covariance is not None
        asks.append(Ask(c.match, from_tangent(c.T_match_query, c.covariance)))
        if c.accepted:
            node = _tied(nodes, asks[-1]) if agreement.passed else node
            break
    return replace(node, asks=tuple(asks))


def relation(nodes: Nodes, i: int, j: int) -> Motion | None:
    """T_i_j by the surer of the ways that join two keyframes; None when none does."""
    a, b = nodes(i), nodes(j)
    by_odometry = _between(a.odometry, b.odometry, _shared(nodes, i, j, tied=False))
    by_loops = _between(a.tied, b.tied, _shared(nodes, i, j, tied=True))
    if by_odometry is None or by_loops is None:
        return by_odometry or by_loops
    return min(by_odometry, by_loops, key=lambda motion: motion.spread_m2)


def _gated(candidate: LoopCandidate, *judged: Gate) -> LoopCandidate:
    judged = candidate.gates + judged
    return replace(candidate, gates=judged, outcome=gates.outcome(judged))


def _agreeing(params: Loop, nodes: Arrived, ask: Ask) -> int:
    """How many keyframes shortly before ask for the same correction."""
    recent = range(max(nodes.k - params.agreement_span, 0), nodes.k)
    return sum(any(_same(params, nodes, ask, k, other) for other in nodes(k).asks) for k in recent)


def _same(params: Loop, nodes: Arrived, ask: Ask, k: int, other: Ask) -> bool:
    """Is the loop of keyframe k what the newest and the motion between them predict?"""
    queries = _between(nodes(nodes.k).odometry, nodes(k).odometry, _shared(nodes, nodes.k, k, tied=False))
    matches = relation(nodes, other.match, ask.match) if queries else None
    if matches is None or queries is None:
        return False
    return distance(other.loop, matches.then(ask.loop).then(queries)) <= params.drift_inflation * params.sure_drift


def _onwards(way: Way, moved: Motion) -> Way:
    return replace(way, motion=way.motion.then(moved))


def _tied(nodes: Arrived, ask: Ask) -> Node:
    """The newest node reached by a loop, if that is the surer way or leads to an older tree (an earlier session)."""
    node, earlier = nodes.node, nodes(ask.match).tied
    way = Way(earlier.motion.then(ask.loop), earlier.tree, nodes.k, ask.match)
    surer = way.tree == node.tied.tree and way.motion.spread_m2 < node.tied.motion.spread_m2
    return replace(node, tied=way) if surer or way.tree < node.tied.tree else node


def _shared(nodes: Nodes, i: int, j: int, tied: bool) -> Way | None:
    """The last keyframe on both ways from the root; a chain that begins later hangs on one that begins earlier."""
    a, b = ((n.tied if tied else n.odometry) for n in (nodes(i), nodes(j)))
    if a.tree != b.tree:
        return None
    while a.chain != b.chain:
        if a.chain > b.chain:
            i, a = a.tie, nodes(a.tie).tied
        else:
            j, b = b.tie, nodes(b.tie).tied
    return a if i <= j else b


def _between(a: Way, b: Way, shared: Way | None) -> Motion | None:
    if shared is None:
        return None
    A = adjoint(poses.inverse(a.motion.T_a_b))
    W = a.motion.covariance + b.motion.covariance - 2.0 * shared.motion.covariance
    return Motion(poses.between(a.motion.T_a_b, b.motion.T_a_b), A @ W @ A.T)
