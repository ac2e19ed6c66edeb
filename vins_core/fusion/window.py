"""The window of moments with fixes: how it begins, takes in new fixes, and lets go of the oldest.

Without a prior its nodes are laid out by the robust alignment (align.py) each time.  Once it has slid, or fixes count,
the prior on its first node stands for everything before, and each solve starts from the last one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import params
from ..factors.robust import Loss
from ..geometry import heading, so3
from .align import align
from .chain import (
    Chain,
    Fixes,
    Linearizer,
    Prior,
    first_prior,
    free_components,
    marginalize_first,
    node_at,
)
from .drift import compose, stack
from .judge import Judgement, judge
from .state import GpsState, Node

LINEAR_YAW_DEG = 5.0
"""With a heading known that well the oldest node may leave a prior; before, its Jacobians would be wrong for good."""

NEWEST = 2
"""So many fixes out in a row put the ones before them in question."""


@dataclass(frozen=True)
class Found:
    """A solved window."""

    chain: Chain
    judgement: Judgement


def assemble(settings: params.Gps, nodes: tuple[Node, ...], prior: Prior) -> Chain:
    """The least-squares problem of the window."""
    anchors = [(k, a) for k, n in enumerate(nodes) for a in n.anchors]
    fixes = Fixes(
        np.array([k for k, _ in anchors], np.int64),
        np.array([a.lever_o for _, a in anchors]).reshape(-1, 3),
        np.array([a.z_e for _, a in anchors]).reshape(-1, 3),
        np.array([a.covariance for _, a in anchors]).reshape(-1, 3, 3),
    )
    increments = stack([n.increment for n in nodes[1:]])
    return Chain(free_components(settings), increments, fixes, prior, Loss(settings.loss, settings.loss_scale))


def begin(settings: params.Gps, nodes: tuple[Node, ...]) -> Found | None:
    """The window from nothing; None where the odometry did not move enough or the fixes contradict each other."""
    p_o_b = np.array([n.p_o_b for n in nodes])
    first = first_prior(settings, node_at(np.zeros(3), 0.0))
    fixes = assemble(settings, nodes, first).fixes
    found = align(p_o_b[fixes.node] + fixes.lever_o, fixes.z_e, fixes.covariance)
    if found is None:
        return None
    x = lay_out(p_o_b, found.yaw_rad, found.shift_e, fixes)
    chain = assemble(settings, nodes, first_prior(settings, x[0]))
    return _judged(settings, chain, x, found.inlier)


def _judged(settings: params.Gps, chain: Chain, x: np.ndarray, used: np.ndarray) -> Found | None:
    try:
        return Found(chain, judge(settings, Linearizer(chain), x, used))
    except np.linalg.LinAlgError:
        return None  # nothing holds the chain


def lay_out(p_o_b: np.ndarray, yaw_rad: float, shift_e: np.ndarray, fixes: Fixes) -> np.ndarray:
    """Nodes (n, 8) of an odometry (n, 3) that is turned by yaw and moved by (east, north)."""
    p_e_b = so3.rotate(heading.about_gravity(yaw_rad), p_o_b)
    p_e_b[:, :2] += shift_e
    p_e_b[:, 2] += np.median(fixes.z_e[:, 2] - p_o_b[fixes.node, 2] - fixes.lever_o[:, 2])
    return np.array([node_at(p, yaw_rad) for p in p_e_b])


def extend(settings: params.Gps, state: GpsState, node: Node, predicted: np.ndarray) -> Found | None:
    """The window with one more node, predicted at (8,), from where it was last.

    If the newest fixes are all out, it may be that one before them is wrong and they are right, as after an outage.  So
    the window is judged a second time with all its fixes as equals, and the cheaper of the two stands.
    """
    assert state.prior is not None
    chain = assemble(settings, (*state.nodes, node), state.prior)
    x, new = np.concatenate([state.x, predicted[None]]), np.ones(len(node.anchors), bool)
    found = _judged(settings, chain, x, np.concatenate([state.used, new]))
    if found is None or found.judgement.used[-NEWEST:].any():
        return found
    other = _judged(settings, chain, x, np.ones(len(chain.fixes), bool))
    return min(found, other or found, key=lambda f: _price(settings, f.judgement))


def _price(settings: params.Gps, judgement: Judgement) -> float:
    """The cost, with what it takes for a fix to be out for each that is: truncated least squares."""
    return judgement.solution.cost + 0.5 * settings.max_chi2 * float(np.sum(~judgement.used))


def slide(settings: params.Gps, state: GpsState) -> GpsState:
    """The state with room for one more node."""
    while len(state.nodes) >= settings.window:
        state = thin(state) if state.prior is None else _marginalize(settings, state)
    return state


def _marginalize(settings: params.Gps, state: GpsState) -> GpsState:
    assert state.prior is not None
    chain = assemble(settings, state.nodes, state.prior)
    gone = len(state.nodes[0].anchors)
    return replace(
        state,
        nodes=state.nodes[1:],
        prior=marginalize_first(chain, state.x, state.used),
        x=state.x[1:],
        used=state.used[gone:],
    )


def thin(state: GpsState) -> GpsState:
    """Every second node: half the fixes over the same way, so that the way gets longer until its heading is seen."""
    kept = [state.nodes[0]]
    for passed, node in zip(state.nodes[1::2], state.nodes[2::2]):
        kept.append(replace(node, increment=compose(passed.increment, node.increment)))
    ahead = state.ahead
    if len(state.nodes) % 2 == 0:
        ahead = compose(state.nodes[-1].increment, ahead)
    return replace(state, nodes=tuple(kept), ahead=ahead)
