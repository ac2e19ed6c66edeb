"""Linearisation of a window: robustly weighted normal equations in arrow form.

    [ H   W' ] [ dc ]     [ g   ]        c: cameras, dense        (D columns, see layout.py)
    [ W   h  ] [ dl ] = - [ g_l ]        l: inverse depths, diagonal

Every term yields dense blocks [J r]' [J r] on given columns, r being one column more; one scatter-add makes H and g
of all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..report import CostSplit
from .depth_term import DepthTerm
from .inertial_term import InertialTerm
from .layout import Layout
from .prior_term import PriorTerm
from .problem import States, WindowProblem, retract_poses
from .visual_term import VisualResult, VisualTerm


@dataclass(frozen=True)
class Residuals:
    """What each factor says at one state."""

    visual: np.ndarray  # (2, N) whitened, before the robust loss, in the order of the problem's tables
    imu: np.ndarray  # (K, 15) whitened
    prior: np.ndarray  # (n,)
    depth: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (K,) whitened, before the robust loss


@dataclass(frozen=True)
class NormalEquations:
    """J'J and J'r at one state, and the residuals they come from."""

    cost: CostSplit
    H: np.ndarray  # (D, D) symmetric
    g: np.ndarray  # (D,)
    W: np.ndarray  # (M, P)
    h: np.ndarray  # (M,) information of each inverse depth, all else held
    g_l: np.ndarray  # (M,)
    residuals: Residuals


class Linearizer:
    """The index structure of one problem, built once; its methods are functions of the states."""

    def __init__(self, problem: WindowProblem):
        self.problem = problem
        self.layout = layout = layout_of(problem)
        self.visual = tuple(VisualTerm(problem, layout, table) for table in problem.tables)
        self.inertial = InertialTerm(problem, layout) if problem.imu else None
        self.prior = PriorTerm(problem.prior, layout) if problem.prior else None
        self.depth = DepthTerm(problem.depths, problem.loss) if problem.depths else None
        self._scatter = _Scatter([t for t in (*self.visual, self.inertial, self.prior) if t], layout.size)

    def linearize(self, states: States, curved: bool = False) -> NormalEquations:
        """`curved`: H with the curvature of the robust loss (factors/robust.py); cost and gradient are the same."""
        m, P = self.problem.n_landmarks, self.layout.visual
        landmarks = np.zeros((m, P)), np.zeros(m), np.zeros(m)
        visual = inertial = prior = depth = 0.0
        r_visual, r_imu, r_prior, r_depth = np.zeros((2, 0)), np.zeros((0, 15)), np.zeros(0), np.zeros(0)
        blocks = iter(self._scatter.blocks)
        if self.visual:
            terms = [term.linearize(states, next(blocks), curved) for term in self.visual]
            visual, r_visual, landmarks = terms[0] if len(terms) == 1 else _sum(terms)
        if self.depth:
            depth, r_depth, landmarks = self.depth.linearize(states, landmarks, curved)
        if self.inertial:
            inertial, r_imu = self.inertial.linearize(states, next(blocks))
        if self.prior:
            prior, r_prior = self.prior.linearize(states, next(blocks))
        H, g = self._scatter.add()
        cost = CostSplit(visual, inertial, prior, depth)
        return NormalEquations(cost, H, g, *landmarks, Residuals(r_visual, r_imu, r_prior, r_depth))

    def retract(self, states: States, dc: np.ndarray, dl: np.ndarray) -> States:
        """states [+] (dc, dl)."""
        n, P, n_td = self.layout.n_poses, self.layout.visual, self.layout.n_td
        extrinsics = states.extrinsics
        if self.layout.n_extrinsics:
            extrinsics = retract_poses(extrinsics, dc[6 * n : P - n_td].reshape(-1, 6))
        return States(
            retract_poses(states.poses, dc[: 6 * n].reshape(n, 6)),
            states.speed_biases + dc[P:].reshape(-1, 9) if self.layout.inertial else states.speed_biases,
            extrinsics,
            states.inv_depths + dl,
            states.td_s + dc[P - 1 : P] if n_td else states.td_s,
        )


def layout_of(problem: WindowProblem) -> Layout:
    """The columns of its variables."""
    n_extrinsics = len(problem.initial.extrinsics) if problem.free_extrinsics else 0
    return Layout(problem.n_frames, n_extrinsics, problem.n_places, problem.inertial, int(problem.free_td))


def _sum(terms: list[VisualResult]) -> VisualResult:
    """Of several tables of projections on the same landmarks."""
    costs, residuals, landmarks = zip(*terms)
    W, h, g_l = (np.sum(parts, axis=0) for parts in zip(*landmarks))
    return sum(costs), np.concatenate(residuals, 1), (W, h, g_l)


class _Term(Protocol):
    columns: np.ndarray  # (blocks, k)


class _Scatter:
    """Room for the blocks of all terms, and where their entries belong in H and g."""

    def __init__(self, terms: list[_Term], size: int):
        self._size = size
        columns = [np.insert(t.columns, t.columns.shape[1], size, 1) for t in terms]  # the last one is r
        places = [(c[:, :, None] * (size + 1) + c[:, None, :]).reshape(-1) for c in columns]
        self._place = np.concatenate(places) if places else np.zeros(0, np.int64)
        self._entries = np.zeros(len(self._place))
        parts = np.split(self._entries, np.cumsum([len(p) for p in places])[:-1])
        self.blocks = [part.reshape(*c.shape, -1) for part, c in zip(parts, columns)]
        """Per term: [J r]' [J r] of each of its blocks (blocks, k + 1, k + 1), to be filled."""

    def add(self) -> tuple[np.ndarray, np.ndarray]:
        n = self._size + 1
        if not len(self._place):  # bincount would count then, in integers
            return np.zeros((n - 1, n - 1)), np.zeros(n - 1)
        H = np.bincount(self._place, self._entries, n * n).reshape(n, n)
        return H[:-1, :-1], H[:-1, -1]
