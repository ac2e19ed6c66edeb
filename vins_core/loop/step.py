"""The loop stage on a page: admit, retrieve, verify, decide, remember (REFERENCE 15, 16).

The state is immutable: a store of keyframes that only grows, an index, and how many keyframes were offered so far.
On-line a keyframe costs the gates up to its decision; `evaluate_all` computes every value there is, to say what would
have accepted it.  Both give the same decision.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from ..geometry import poses
from ..params import Loop
from ..report import LOOP_OUTCOMES, Gate, LoopCandidate, LoopOutcome, LoopReport, all_pass
from . import consistency, gates
from .consistency import Arrived, Motion, Node, from_tangent, tangent_covariance
from .index import InvertedIndex
from .keyframe import Keyframes, LoopKeyframe
from .verify import Pair, verify
from .vocabulary import ScoreLimits


@dataclass(frozen=True)
class Moved:
    """The motion since the last keyframe used, to the last one offered."""

    T_w_b: np.ndarray  # (7,) of that one
    motion: Motion | None  # None where no odometry joins them, or none has been used

    def on(self, T_w_b: np.ndarray, covariance: np.ndarray | None) -> Moved:
        if self.motion is None or covariance is None:
            return Moved(T_w_b, None)
        return Moved(T_w_b, self.motion.then(from_tangent(poses.between(self.T_w_b, T_w_b), covariance)))


@dataclass(frozen=True)
class LoopState:
    """What the loop stage carries from keyframe to keyframe."""

    keyframes: Keyframes = field(compare=False)  # shared by all states of a run; the first `n` belong to this one
    limits: ScoreLimits  # of the vocabulary
    n: int = 0
    seen: int = 0  # keyframes offered so far, used or not
    since: int = 0  # of them from the last one used on
    moved: Moved | None = None  # None before the first is offered

    def __len__(self) -> int:
        return self.n

    @property
    def index(self) -> InvertedIndex:
        return self.keyframes.inverted(self.n)

    def node(self, k: int) -> Node:
        """What consistency knows of keyframe k."""
        node = self.keyframes[k].node
        assert node is not None  # every keyframe has one once it is remembered
        return node


@dataclass(frozen=True)
class Retrieved:
    """An earlier keyframe that the scores say something about."""

    match: int
    score: float
    gates: tuple[Gate, ...]

    def pair(self, query: int, later: LoopKeyframe, earlier: LoopKeyframe) -> Pair:
        return Pair(query, self.match, later, earlier, self.score, self.gates)


def begin(limits: ScoreLimits) -> LoopState:
    """The state before the first keyframe."""
    return LoopState(Keyframes(), limits)


def admit(
    params: Loop, state: LoopState, T_w_b: np.ndarray, motion: np.ndarray | None = None
) -> tuple[LoopState, tuple[Gate, ...]]:
    """Is a keyframe at this pose (7,) used at all?  Asked before it is described (L3, L4).

    `motion` (6, 6): covariance of the motion since the last keyframe offered; None at the start of a session.
    """
    judged: tuple[Gate, ...] = (gates.start(params, state.seen),)
    if len(state):
        moved_m = float(np.linalg.norm(T_w_b[:3] - state.keyframes[len(state) - 1].T_w_b[:3]))
        judged += (gates.every(params, state.since), gates.spacing(params, moved_m))
    moved = state.moved.on(T_w_b, motion) if state.moved else Moved(T_w_b, None)
    return replace(state, seen=state.seen + 1, since=state.since + 1, moved=moved), judged


def odometry(state: LoopState) -> np.ndarray | None:
    """`LoopKeyframe.odometry` of the keyframe that was just admitted."""
    moved = state.moved.motion if state.moved else None
    return tangent_covariance(moved) if moved else None


def detect(params: Loop, state: LoopState, keyframe: LoopKeyframe, evaluate_all: bool = False) -> LoopReport:
    """The loops of a keyframe that is about to be remembered.  Pure."""
    return _detect(params, state, keyframe, state.index.scores(keyframe.bag), evaluate_all)


def detect_again(params: Loop, state: LoopState, query: int) -> LoopReport:
    """`detect(..., evaluate_all=True)` of a keyframe that has been remembered, as of then: 0 <= query < len(state)."""
    keyframe = state.keyframes[query]
    return _detect(params, state, keyframe, state.index.scores(keyframe.bag)[:query], evaluate_all=True)


def examine(params: Loop, state: LoopState, query: int, match: int) -> LoopReport:
    """Why are these two keyframes no loop?  Every gate of the pair, whether retrieval proposed it or not.

    Raises IndexError unless 0 <= match < query < len(state).
    """
    if not 0 <= match < query < len(state):
        raise IndexError(f"keyframes {match} and {query}: expected 0 <= match < query < {len(state)}")
    keyframe = state.keyframes[query]
    scores = state.index.scores(keyframe.bag)[:query]
    own = _own_gates(params, state.limits, keyframe.n_landmarks, scores)
    pair = _retrieved(params, state.limits, scores, match).pair(query, keyframe, state.keyframes[match])
    nodes = _arrived(state, query, keyframe)
    return decide(_report(query, keyframe, scores, own), [_verified(params, pair, nodes, evaluate_all=True)])


def remember(state: LoopState, keyframe: LoopKeyframe, report: LoopReport | None = None) -> LoopState:
    """The state with the keyframe in it, about which `report` has decided."""
    nodes = _arrived(state, len(state), keyframe)
    node = consistency.settle(nodes, report) if report else nodes.node
    keyframes = state.keyframes.extended(len(state), replace(keyframe, node=node))
    here = Moved(keyframe.T_w_b, Motion(poses.IDENTITY, np.zeros((6, 6))))
    return replace(state, keyframes=keyframes, n=state.n + 1, since=1, moved=here)


def decide(report: LoopReport, candidates: Iterable[LoopCandidate]) -> LoopReport:
    """The verdicts that follow from the gates: the first candidate that passes all of them is the loop."""
    own = gates.outcome(report.gates)
    judged: list[LoopCandidate] = []
    for candidate in candidates:
        verdict = gates.outcome(candidate.gates)
        if verdict is LoopOutcome.ACCEPTED:
            if own is not LoopOutcome.ACCEPTED:
                verdict = own
            elif any(c.accepted for c in judged):
                verdict = LoopOutcome.NOT_CHOSEN
        judged.append(replace(candidate, outcome=verdict))
    if own is LoopOutcome.ACCEPTED:
        own = max((c.outcome for c in judged), key=LOOP_OUTCOMES.index, default=LoopOutcome.TOO_RECENT)
    return replace(report, candidates=tuple(judged), outcome=own)


def retrieval_gates(
    params: Loop,
    limits: ScoreLimits,
    neighbour: float | None,
    between: int,
    score: float,
    rank: int,
    rivals: Iterable[float] = (),
) -> tuple[Gate, ...]:
    """What retrieval says of a candidate; `rivals` are the scores of earlier keyframes that are candidates too."""
    judged: tuple[Gate, ...] = (
        gates.between(params, between),
        gates.score(params, score, neighbour, limits),
        gates.rank(params, rank),
    )
    if params.order == "oldest":
        ahead = sum(gates.score(params, rival, neighbour, limits).passed for rival in rivals)
        judged += (gates.earlier_candidates(ahead),)
    return judged


def retrieve(
    params: Loop, limits: ScoreLimits, n_landmarks: int, scores: np.ndarray
) -> tuple[tuple[Gate, ...], tuple[Retrieved, ...]]:
    """What is told from the scores (n,) of a keyframe with all earlier ones: its own gates, and its candidates."""
    eligible = scores[: _eligible(params, len(scores))]
    order = _best(params, eligible)
    if params.order == "oldest":
        order = np.sort(order)
    found = tuple(_retrieved(params, limits, scores, match) for match in order.tolist())
    return _own_gates(params, limits, n_landmarks, scores), found


def _detect(
    params: Loop, state: LoopState, keyframe: LoopKeyframe, scores: np.ndarray, evaluate_all: bool
) -> LoopReport:
    query = len(scores)
    own, found = retrieve(params, state.limits, keyframe.n_landmarks, scores)
    nodes = _arrived(state, query, keyframe)
    candidates: list[LoopCandidate] = []
    for retrieved in found if evaluate_all or all_pass(own) else ():
        if any(c.accepted for c in candidates) and not evaluate_all:
            candidates.append(_unverified(query, retrieved))
        else:
            pair = retrieved.pair(query, keyframe, state.keyframes[retrieved.match])
            candidates.append(_verified(params, pair, nodes, evaluate_all))
    return decide(_report(query, keyframe, scores, own), candidates)


def _eligible(params: Loop, query: int) -> int:
    """How many keyframes, from the first on, lie far enough before this one."""
    return max(query - params.min_gap, 0)


def _best(params: Loop, eligible: np.ndarray) -> np.ndarray:
    """The candidates, the highest score first, the earlier among equals."""
    return np.argsort(-eligible, kind="stable")[: params.candidates]


def _retrieved(params: Loop, limits: ScoreLimits, scores: np.ndarray, match: int) -> Retrieved:
    query, mine = len(scores), scores[match]
    eligible = scores[: _eligible(params, query)]
    rank = 1 + np.count_nonzero(eligible > mine) + np.count_nonzero(eligible[:match] == mine)
    others = _best(params, eligible) if params.order == "oldest" else np.zeros(0, int)
    neighbour, rivals = neighbour_score(scores), scores[others[others < match]]
    judged = retrieval_gates(params, limits, neighbour, query - match - 1, float(mine), int(rank), rivals)
    return Retrieved(match, float(mine), judged)


def _arrived(state: LoopState, k: int, keyframe: LoopKeyframe) -> Arrived:
    """The nodes of all keyframes up to number k, which is this one."""
    before = state.keyframes[k - 1].T_w_b if k else None
    return consistency.arrive(state.node, k, keyframe.T_w_b, before, keyframe.odometry)


def _verified(params: Loop, pair: Pair, nodes: Arrived, evaluate_all: bool) -> LoopCandidate:
    candidate = verify(params, pair, evaluate_all)
    return consistency.judge(params, nodes, candidate) if evaluate_all or all_pass(candidate.gates) else candidate


def neighbour_score(scores: np.ndarray) -> float | None:
    """With the previous keyframe; None for the first."""
    return float(scores[-1]) if len(scores) else None


def _own_gates(params: Loop, limits: ScoreLimits, n_landmarks: int, scores: np.ndarray) -> tuple[Gate, ...]:
    known = np.append(scores[: _eligible(params, len(scores))], scores[-1:])
    return (
        gates.landmarks(params, n_landmarks),
        gates.between(params, len(scores) - 1),
        gates.distinctive(params, float(known.max()) if len(known) else None, limits),
    )


def _report(query: int, keyframe: LoopKeyframe, scores: np.ndarray, own: tuple[Gate, ...]) -> LoopReport:
    return LoopReport(
        query,
        keyframe.frame,
        keyframe.t_ns,
        keyframe.n_landmarks,
        len(keyframe.uv_px),
        neighbour_score(scores),
        own,
        (),
        LoopOutcome.TOO_RECENT,
        keyframe.T_w_b,
        keyframe.odometry,
    )


def _unverified(query: int, found: Retrieved) -> LoopCandidate:
    return LoopCandidate(query, found.match, found.score, found.gates, gates.outcome(found.gates))
