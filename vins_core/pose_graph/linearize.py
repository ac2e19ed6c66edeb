"""Cost, gradient and J'J of a pose graph, on blocks of one keyframe.

    H = J'J,  g = J'r,  with r and J scaled by v sqrt(rho') (factors/robust.py)

H has a block per free keyframe and one per pair of free keyframes that share an edge; that pattern never changes, so
it is found once and the blocks are summed by sparse products.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ..report import GraphCost
from .problem import Problem


@dataclass(frozen=True)
class NormalEquations:
    """At one point: H d = -g is the Gauss-Newton step."""

    cost: GraphCost
    g: np.ndarray  # (m, t)
    diagonal: np.ndarray  # (m, t, t) blocks of H
    off_diagonal: np.ndarray  # (k, t, t) block (pair_i, pair_j) of H


class Linearizer:
    """Evaluates one problem at different nodes.  Not for use by several threads."""

    def __init__(self, problem: Problem):
        self.problem = problem
        edges, variant = problem.edges, problem.variant
        n, m, e = len(problem.nodes), len(problem.free), len(edges)
        row = np.full(n, -1)
        row[problem.free] = np.arange(m)
        i, j = row[edges.i], row[edges.j]
        both = np.flatnonzero((i >= 0) & (j >= 0))
        pairs, which = np.unique(i[both] * max(m, 1) + j[both], return_inverse=True)
        self.pair_i, self.pair_j = pairs // max(m, 1), pairs % max(m, 1)
        self._sum_i, self._sum_j = _sum(i, m), _sum(j, m)
        pair = np.full(e, -1)
        pair[both] = which
        self._sum_pairs = _sum(pair, len(pairs))
        self._batch = variant.factor.batch(e, variant.active)
        self._batch.data[:] = problem.data

    def residuals(self, nodes: np.ndarray) -> np.ndarray:
        """w r of every edge without robust weight, (rows, e); valid until the next evaluation."""
        self._evaluate(nodes)
        return self._batch.system[-1]

    def weights(self, r: np.ndarray) -> np.ndarray:
        """rho' of every edge, (e,): 1 = counts in full."""
        s = np.sum(r * r, 0)
        return np.where(self.problem.robust, self.problem.loss.weight(s) ** 2, 1.0)

    def cost(self, r: np.ndarray) -> GraphCost:
        s, is_loop = np.sum(r * r, 0), self.problem.edges.is_loop
        rho = 0.5 * self.problem.outer**2 * np.where(self.problem.robust, self.problem.loss.rho(s), s)
        return GraphCost(float(rho[~is_loop].sum()), float(rho[is_loop].sum()))

    def linearize(self, nodes: np.ndarray) -> NormalEquations:
        r = self.residuals(nodes)
        cost = self.cost(r)
        system = self._batch.system
        system *= self.problem.outer * np.sqrt(self.weights(r))
        t = self.problem.variant.dof
        J_i, J_j, r = system[:t], system[t : 2 * t], system[-1]
        g = self._sum_i @ _product(J_i, r[None]) + self._sum_j @ _product(J_j, r[None])
        diagonal = self._sum_i @ _product(J_i, J_i) + self._sum_j @ _product(J_j, J_j)
        off_diagonal = self._sum_pairs @ _product(J_i, J_j)
        return NormalEquations(cost, g, diagonal.reshape(-1, t, t), off_diagonal.reshape(-1, t, t))

    def _evaluate(self, nodes: np.ndarray) -> None:
        edges = self.problem.edges
        self._batch.inputs[0][:] = nodes[edges.i].T
        self._batch.inputs[1][:] = nodes[edges.j].T
        self._batch.evaluate()


def _product(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """A'B per edge: (a, rows, e) and (b, rows, e) -> (e, a b)."""
    product = np.einsum("ake,bke->abe", A, B)
    return np.ascontiguousarray(product.reshape(-1, A.shape[-1]).T)


def _sum(target: np.ndarray, size: int) -> sp.csr_matrix:
    """(size, e): adds the row of edge k to row target[k], nowhere if that is negative."""
    used = np.flatnonzero(target >= 0)
    return sp.csr_matrix((np.ones(len(used)), (target[used], used)), shape=(size, len(target)))
