"""Is this the optimum?  The same window through IPOPT, a solver that shares no step rule with ours (SPEC 5.3).

IPOPT minimises the true robust cost of a `WindowProblem` over local coordinates around its initial states,

    f(y) = cost(x_0 [+] T y),     T: standard deviations, diag(J'J)^-1/2 at x_0,

through three CasADi callbacks on our own `Linearizer`: cost, gradient, Hessian.  `linearize` differentiates at
x = x_0 [+] T y with respect to a further x [+] d; that d relates to y through the right Jacobian of SO(3), which is
chained into the gradient, so f and its gradient are exact.  The Hessian is that of Gauss-Newton with
the curvature of the robust loss: a descent direction is all that IPOPT's line search needs of it.

A prior that leaks (spectrum.py) makes the cost depend on position and yaw of the whole window, where it means nothing.
Held, T gives the oldest pose only the two rotations that tilt it; free, all six, as VINS has it.

The interior-point machinery is built once for a number of frames and a largest number of landmarks, 8-45 ms; the
topology of a window is only in the callbacks.  Coordinates that nothing depends on stay where they are.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..clock import stopwatch
from ..factors.prior import difference_poses
from ..geometry import so3
from ..report import CostSplit, IterationReport, Timings
from .layout import Layout
from .linearize import Linearizer, NormalEquations
from .problem import States, WindowProblem, hold_oldest
from .trust_region import Solution, gauge_damping

LANDMARK_STEP = 64
"""Machines are built for multiples of so many landmarks."""


@dataclass(frozen=True)
class Comparison:
    """A solution beside the optimum that IPOPT found from it; differences after both were put at the same
    position and yaw of the oldest frame."""

    cost: CostSplit  # of the solution
    optimum: CostSplit
    p_m: np.ndarray  # (n,) distance per slot
    rotation_deg: np.ndarray  # (n,)
    v_m_s: np.ndarray  # (n,)
    b_a: np.ndarray  # (n,) m/s^2
    b_g: np.ndarray  # (n,) rad/s
    inv_depth: np.ndarray  # (M,) 1/m, in the order of the problem's landmarks
    iterations: int
    termination: str
    ms: float

    @property
    def excess(self) -> float:
        """By which share of the optimum the solution costs more; negative when IPOPT stopped above it."""
        return (self.cost.total - self.optimum.total) / max(self.optimum.total, 1e-300)

    def largest(self) -> tuple[tuple[str, float, str, int], ...]:
        """Per block the largest difference: (name, value, unit, slot or row of the landmark)."""
        rows = (
            ("p", self.p_m, "m"),
            ("theta", self.rotation_deg, "deg"),
            ("v", self.v_m_s, "m/s"),
            ("b_a", self.b_a, "m/s^2"),
            ("b_g", self.b_g, "rad/s"),
            ("inverse depth", self.inv_depth, "1/m"),
        )
        return tuple((name, float(d.max()), unit, int(d.argmax())) for name, d, unit in rows if len(d))


def solve_ipopt(
    problem: WindowProblem,
    hold_gauge: bool = True,
    gauge: np.ndarray | None = None,
    max_iterations: int = 100,
    tolerance: float = 1e-8,
) -> Solution:
    """The minimum of `problem` from its initial states.

    `hold_gauge`: position and yaw of the oldest pose stay where `gauge` (7,) has them, by default where they are.  A
    solver that holds them by damping turns a little about gravity when it tilts the window to and fro, which a prior
    that leaks notices: two answers are comparable at the same gauge.  `tolerance`: largest component of the gradient,
    per standard deviation, at which IPOPT is content; a thousand times as much will do once the cost stands still.
    """
    linearizer = Linearizer(problem)
    size, largest = linearizer.layout, -(-max(problem.n_landmarks, 1) // LANDMARK_STEP) * LANDMARK_STEP
    start = problem.initial if gauge is None else hold_oldest(problem.initial, gauge, not problem.inertial)
    return _machine(size, largest, max_iterations, tolerance).solve(linearizer, start, hold_gauge)


def compare_optimum(problem: WindowProblem, solution: Solution, hold_gauge: bool = True) -> Comparison:
    """Solve `problem` again with IPOPT and put its answer beside `solution`.

    `hold_gauge` as the solver in question does: `trust_region.rules(params.solver).holds_gauge`.
    """
    ms: Timings = {}
    with stopwatch(ms, "ipopt"):
        optimum = solve_ipopt(problem, hold_gauge, solution.states.poses[0])
    ours, best = (hold_oldest(s.states, problem.initial.poses[0], not problem.inertial) for s in (solution, optimum))
    pose = difference_poses(ours.poses, best.poses)
    speed_bias = (ours.speed_biases - best.speed_biases).reshape(-1, 3, 3)
    v, b_a, b_g = np.linalg.norm(speed_bias, axis=2).T
    return Comparison(
        cost=solution.after,
        optimum=optimum.after,
        p_m=np.linalg.norm(pose[:, :3], axis=1),
        rotation_deg=np.rad2deg(np.linalg.norm(pose[:, 3:], axis=1)),
        v_m_s=v,
        b_a=b_a,
        b_g=b_g,
        inv_depth=np.abs(ours.inv_depths - best.inv_depths),
        iterations=len(optimum.iterations),
        termination=optimum.termination,
        ms=ms["ipopt"],
    )


@lru_cache(maxsize=8)
def _machine(layout: Layout, landmarks: int, max_iterations: int, tolerance: float) -> _Machine:
    return _Machine(layout, landmarks, max_iterations, tolerance)


class _Machine:
    """IPOPT for any window of one layout with at most so many landmarks."""

    def __init__(self, layout: Layout, landmarks: int, max_iterations: int, tolerance: float):
        self._layout = layout
        self._size = size = layout.size + landmarks
        self._pattern = pattern = _arrow(layout.size, layout.visual, landmarks)
        column, scalar = ca.Sparsity.dense(size, 1), ca.Sparsity.dense(1, 1)
        self._callbacks = [
            _Callback("nlp_f", column, ["f"], [scalar], lambda a: [self._evaluate(a[0]).cost]),
            _Callback("nlp_grad_f", column, ["f", "grad_f_x"], [scalar, column],
                      lambda a: [self._evaluate(a[0]).cost, self._evaluate(a[0]).gradient]),
            _Callback("nlp_hess_l", column, ["triu_hess_gamma_x_x"], [pattern],
                      lambda a: [ca.DM(pattern, float(a[2]) * self._evaluate(a[0]).hessian)]),
        ]  # fmt: skip
        cost, gradient, hessian = self._callbacks
        y = ca.MX.sym("y", size)
        options: dict[str, Any] = {
            "grad_f": gradient, "hess_lag": hessian, "no_nlp_grad": True, "calc_f": False, "calc_lam_p": False,
            "calc_lam_x": False, "print_time": False, "show_eval_warnings": False, "error_on_fail": False,
            "ipopt": {
                "print_level": 0, "sb": "yes", "nlp_scaling_method": "none", "max_iter": max_iterations,
                "tol": tolerance, "acceptable_tol": 1e3 * tolerance, "acceptable_iter": 3,
                "acceptable_obj_change_tol": 1e-9,
            },
        }  # fmt: skip
        objective: dict[str, Any] = {"x": y, "f": cost(y, ca.DM(0, 0))}
        self._ipopt: Any = ca.nlpsol("window", "ipopt", objective, options)
        self._at: np.ndarray | None = None
        self._busy = threading.Lock()

    def solve(self, linearizer: Linearizer, start: States, hold_gauge: bool) -> Solution:
        with self._busy:
            self._linearizer, self._start, self._at = linearizer, start, None
            first = linearizer.linearize(start)
            self._landmarks = len(first.h)
            whole = not self._layout.inertial
            self.coordinates = _Coordinates(first, start.poses[0], self._size, hold_gauge, whole)
            y = np.array(self._ipopt(x0=np.zeros(self._size))["x"]).ravel()
            stats = self._ipopt.stats()
            states = self._retract(y)
            system = linearizer.linearize(states)
        return Solution(states, system, first.cost, system.cost, _reports(stats), _termination(stats))

    def _evaluate(self, y: ca.DM) -> _Evaluation:
        """At y; the callbacks ask for cost, gradient and Hessian of the same point one after the other."""
        key = np.array(y).ravel()
        if self._at is None or not np.array_equal(key, self._at):
            self._at = key
            states = self._retract(key)
            system = self._linearizer.linearize(states, curved=True)
            self._evaluation = _Evaluation(self._layout, self.coordinates, key, system)
        return self._evaluation

    def _retract(self, y: np.ndarray) -> States:
        d, D = self.coordinates.to_tangent(y), self._layout.size
        return self._linearizer.retract(self._start, d[:D], d[D : D + self._landmarks])


class _Coordinates:
    """d = T y with T = diag(B, 1, 1, ...) diag(scale): B turns the axes of the oldest pose, to hold four of them."""

    def __init__(self, system: NormalEquations, oldest: np.ndarray, size: int, hold_gauge: bool, whole: bool = False):
        information = np.zeros(size)
        D, m = len(system.g), len(system.h)
        information[:D], information[D : D + m] = system.H.diagonal(), system.h
        B = np.eye(6)
        if hold_gauge:
            values, vectors = np.linalg.eigh(gauge_damping(oldest, whole))
            B = vectors * (values < 0.5 * values[-1])  # what is held becomes a column of zeros
        information[:6] = (B.T @ system.H[:6, :6] @ B).diagonal()
        self._B = B
        self.idle = information <= 0  # nothing depends on this coordinate
        self.scale = 1.0 / np.sqrt(np.where(self.idle, 1.0, information))

    def to_tangent(self, y: np.ndarray) -> np.ndarray:
        d = self.scale * y
        d[:6] = self._B @ d[:6]
        return d

    def from_tangent(self, g: np.ndarray) -> np.ndarray:
        """T' g along the first axis; g may end early."""
        g = g.copy()
        g[:6] = self._B.T @ g[:6]
        return g * self.scale[: len(g)].reshape(-1, *[1] * (g.ndim - 1))


class _Evaluation:
    """f, its gradient and Gauss-Newton Hessian at one y."""

    def __init__(self, layout: Layout, coordinates: _Coordinates, y: np.ndarray, system: NormalEquations):
        self._layout, self._coordinates, self._system = layout, coordinates, system
        self._d = coordinates.to_tangent(y)
        self.cost = system.cost.total

    @property
    def gradient(self) -> np.ndarray:
        system = self._system
        g = np.zeros(len(self._d))
        D, m = len(system.g), len(system.h)
        g[:D], g[D : D + m] = self._chain(system.g), system.g_l
        return self._coordinates.from_tangent(g)

    @property
    def hessian(self) -> np.ndarray:
        """Entries of the upper triangle in the order of the pattern (columns)."""
        system, T = self._system, self._coordinates.from_tangent
        D, P, m, landmarks = self._layout.size, self._layout.visual, len(system.h), len(self._d) - self._layout.size
        H = T(T(self._chain(self._chain(system.H).T)).T)
        H[np.diag_indices(D)] += self._coordinates.idle[:D]
        W, h = np.zeros((landmarks, P)), np.zeros(landmarks)
        W[:m], h[:m] = T(self._chain(system.W.T)).T, system.h
        scale = self._coordinates.scale[D:]
        arrow = np.column_stack([W * scale[:, None], h * scale**2 + self._coordinates.idle[D:]])
        return np.concatenate([H.T[np.tril_indices(D)], arrow.ravel()])

    def _chain(self, g: np.ndarray) -> np.ndarray:
        """K' g along the first axis, K = d(tangent at x) / d(tangent at x_0): right Jacobians of the rotations."""
        layout = self._layout
        turns = layout.columns("pose", np.arange(layout.n_poses))[:, 3:]
        if layout.n_extrinsics:
            turns = np.concatenate([turns, layout.columns("extrinsic", np.arange(layout.n_extrinsics))[:, 3:]])
        g = g.copy()
        K = so3.right_jacobian(self._d[turns])
        g[turns] = np.einsum("kji,kj...->ki...", K, g[turns])
        return g


class _Callback(ca.Callback):
    def __init__(self, name: str, column: ca.Sparsity, names: list[str], shapes: list[ca.Sparsity], function: Any):
        ca.Callback.__init__(self)
        self._column, self._names, self._shapes, self._function = column, names, shapes, function
        self._inputs = ["x", "p"] if name != "nlp_hess_l" else ["x", "p", "lam_f", "lam_g"]
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._names)

    def get_name_in(self, i: int) -> str:
        return self._inputs[i]

    def get_name_out(self, i: int) -> str:
        return self._names[i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return {"x": self._column, "lam_f": ca.Sparsity.dense(1, 1)}.get(self._inputs[i], ca.Sparsity(0, 0))

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._shapes[i]

    def eval(self, arguments: Sequence[ca.DM]) -> list[Any]:
        return self._function(arguments)


def _arrow(cameras: int, visual: int, landmarks: int) -> ca.Sparsity:
    """Upper triangle: dense cameras, dense visual rows above each landmark, the landmarks' diagonal."""
    columns = [np.arange(k + 1) for k in range(cameras)]
    columns += [np.append(np.arange(visual), cameras + k) for k in range(landmarks)]
    start = np.cumsum([0] + [len(c) for c in columns])
    size = cameras + landmarks
    return ca.Sparsity(size, size, start.tolist(), np.concatenate(columns).tolist())


def _reports(stats: dict[str, Any]) -> tuple[IterationReport, ...]:
    """One per step: IPOPT reports the point before the first step too, accepts every step and damps by adding to H."""
    rows = stats.get("iterations", {})
    columns = (rows.get(k, [])[1:] for k in ("obj", "d_norm", "regularization_size"))
    return tuple(IterationReport(cost, True, norm, float("nan"), added) for cost, norm, added in zip(*columns))


def _termination(stats: dict[str, Any]) -> str:
    status = str(stats["return_status"])
    known = {
        "Solve_Succeeded": "converged: the gradient is zero",
        "Solved_To_Acceptable_Level": "converged: the cost stands still",
        "Search_Direction_Becomes_Too_Small": "converged: the step is zero",
        "Maximum_Iterations_Exceeded": f"stopped after {stats['iter_count']} iterations",
    }
    return known.get(status, f"stopped: {status.replace('_', ' ').lower()}")
