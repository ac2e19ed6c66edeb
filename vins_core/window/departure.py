"""What leaves a window, and the factors that touch it: the problem that marginalisation solves (REFERENCE G1, G2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..factors.prior import difference_poses
from ..params import Params
from ..report import BlockReport, CostSplit
from ..solver.depth_term import DepthTerm
from ..solver.inertial_term import InertialTerm
from ..solver.layout import Layout, Variable
from ..solver.linearize import Linearizer, NormalEquations, Residuals
from ..solver.prior_term import PriorTerm
from ..solver.problem import Projections, States, WindowProblem
from ..solver.visual_rows import NumpyRows
from ..solver.visual_term import VisualTerm
from .assemble import assemble
from .state import BlockKey, WindowState


@dataclass(frozen=True)
class Departure:
    """Leaving variables and landmarks, and the part of the window's problem that touches them.

    The factors are linearised at `at`: at the current states, or with *first estimates* where the prior has been
    linearised before.  A gauge direction (solver/spectrum.py) depends on the states, and J n = 0 holds only for J and
    n of the same states.  The prior's J is of the states x0 at which a variable first entered it, and stays.  A new
    factor with J at the current x adds its own, different n: yaw is then known in the sum though in neither part.
    Evaluated at x0 as well, it shares n(x0), and the prior stays free of yaw for ever.  The price is an older
    linearisation; the residual is still that of the current states, carried to x0 by the same J:

        r(x) = r(x_now) + J(x0) ((x [-] x0) - (x_now [-] x0))
    """

    kind: str  # "MARGIN_OLD" | "MARGIN_SECOND_NEW"
    problem: WindowProblem  # only the factors that take part; its landmarks all leave
    leaving: tuple[Variable, ...]
    landmark_ids: np.ndarray
    frames: tuple[int, ...]  # number of each slot's frame
    first_estimate: bool

    @cached_property
    def layout(self) -> Layout:
        problem = self.problem
        return Layout(
            problem.n_frames, len(problem.initial.extrinsics), inertial=problem.inertial, n_td=int(problem.free_td)
        )

    @cached_property
    def touched(self) -> tuple[Variable, ...]:
        """The variables that some factor touches: poses, speed-biases, extrinsics, td."""
        problem = self.problem
        touched = set(problem.prior.blocks) if problem.prior else set()
        for k, _ in problem.imu:
            touched |= {Variable(kind, slot) for kind in ("pose", "speed_bias") for slot in (k, k + 1)}
        for table in problem.tables:
            touched |= {Variable("pose", int(slot)) for slot in np.union1d(table.anchor, table.observer)}
            touched |= {Variable("extrinsic", camera) for camera in (table.camera, table.seen_by)}
            touched |= {Variable("td", 0)} if problem.free_td else set()
        order = ("pose", "speed_bias", "extrinsic", "td")
        return tuple(sorted(touched, key=lambda block: (order.index(block.kind), block.slot)))

    @property
    def dropped(self) -> list[Variable]:
        return [b for b in self.leaving if b in self.touched]

    @property
    def kept(self) -> list[Variable]:
        return [b for b in self.touched if b not in self.leaving]

    @cached_property
    def at(self) -> States:
        """Where Jacobians are evaluated."""
        states, prior = self.problem.initial, self.problem.prior
        if not self.first_estimate or prior is None:
            return states
        tables = {kind: table.copy() for kind, table in states.tables().items()}
        for block, x0 in zip(prior.blocks, prior.x0):
            tables[block.kind][block.slot] = x0
        poses, speed_biases, extrinsics = (tables[kind] for kind in ("pose", "speed_bias", "extrinsic"))
        return States(poses, speed_biases, extrinsics, states.inv_depths, tables["td"][0])

    @cached_property
    def _moved(self) -> np.ndarray:
        """(D,) current states [-] `at`."""
        states, at, d = self.problem.initial, self.at, np.zeros(self.layout.size)
        n, P, n_td = len(at.poses), self.layout.visual, self.layout.n_td
        d[: 6 * n] = difference_poses(states.poses, at.poses).ravel()
        d[6 * n : P - n_td] = difference_poses(states.extrinsics, at.extrinsics).ravel()
        d[P - n_td : P] = (states.td_s - at.td_s)[:n_td]
        if self.layout.inertial:
            d[P:] = (states.speed_biases - at.speed_biases).ravel()
        return d

    def square_roots(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """(r, J, columns) of the prior and the IMU factor, J with respect to the tangent at `at`."""
        problem, layout = self.problem, self.layout
        if problem.prior:
            prior = PriorTerm(problem.prior, layout)
            yield (*prior.rows(self.at), prior.columns[0])
        if problem.imu:
            inertial = InertialTerm(problem, layout)
            columns = inertial.columns[0]
            r, J = (a[0] for a in inertial.rows(problem.initial))
            if self.at is not problem.initial:
                J = inertial.rows(self.at)[1][0]
                r = r - J @ self._moved[columns]
            yield r, J, columns

    def projections(self) -> NormalEquations | None:
        """All projections, with the depths of their landmarks; None when there are none."""
        problem = replace(self.problem, imu=(), prior=None)
        if not problem.tables:
            return None
        if self.at is problem.initial:
            return Linearizer(problem).linearize(problem.initial)
        return self._projections_at_first_estimates(problem)

    def _projections_at_first_estimates(self, problem: WindowProblem) -> NormalEquations:
        """J at `at`, robust weights and residuals at the current states; dense, because it is rarely asked for."""
        P, M, size = self.layout.visual, problem.n_landmarks, self.layout.size
        H, g, (W, h, g_l), residuals = np.zeros((size, size)), np.zeros(size), _zeros(M, P), []
        for table in problem.tables:
            term = VisualTerm(problem, self.layout, table)
            rows = NumpyRows(term.index)
            now, unweighted, _ = (a.copy() for a in rows.system(problem.initial))
            first, _, squared = rows.system(self.at)
            weight = problem.loss.weight((unweighted**2).sum(0)) / problem.loss.weight(squared)
            J = (first[:-1] * weight).transpose(1, 2, 0)  # (2, N, c + 1), the last column is the inverse depth
            columns = np.broadcast_to(term.columns[term.pair], (2, *term.columns[term.pair].shape))
            camera, depth = np.zeros((*J.shape[:2], P)), J[:, :, -1:]
            np.put_along_axis(camera, columns, J[:, :, :-1], 2)
            r = now[-1] - camera @ self._moved[:P]

            flat = camera.reshape(-1, P)
            H[:P, :P] += flat.T @ flat
            g[:P] += r.reshape(-1) @ flat
            landmark = np.broadcast_to(term.index.table.landmark, r.shape)
            np.add.at(W, landmark, depth * camera)
            np.add.at(h, landmark, depth[:, :, 0] ** 2)
            np.add.at(g_l, landmark, depth[:, :, 0] * r)
            residuals.append(unweighted)
        if problem.depths:
            _, _, (W, h, g_l) = DepthTerm(problem.depths, problem.loss).linearize(problem.initial, (W, h, g_l))
        nothing = Residuals(np.concatenate(residuals, 1), np.zeros((0, 15)), np.zeros(0))
        return NormalEquations(CostSplit(), H, g, W, h, g_l, nothing)

    def blocks(self) -> tuple[BlockReport, ...]:
        """Every block in the order of the marginalisation's H: dropped cameras, landmarks, then what is kept."""
        rows = [(self._name(block), block.size, True) for block in self.dropped]
        rows += [(f"inv_depth of {i}", 1, True) for i in self.landmark_ids]
        rows += [(self._name(block), block.size, False) for block in self.kept]
        index = np.cumsum([0] + [size for _, size, _ in rows]).tolist()
        return tuple(BlockReport(label, size, start, gone) for (label, size, gone), start in zip(rows, index))

    def key(self, block: Variable) -> BlockKey:
        of_frame = block.kind in ("pose", "speed_bias")
        return BlockKey(block.kind, self.frames[block.slot] if of_frame else block.slot)

    def _name(self, block: Variable) -> str:
        if block.kind == "extrinsic":
            return f"extrinsic cam{block.slot}"
        if block.kind == "td":
            return "td"
        return f"{block.kind} {block.slot} (frame {self.frames[block.slot]})"


def oldest_leaves(params: Params, window: WindowState, gravity_m_s2: float) -> Departure:
    """MARGIN_OLD (REFERENCE G1): pose and speed-bias of slot 0 and the landmarks anchored there leave.

    Factors: the prior, IMU (0, 1), projections and depths of landmarks anchored in slot 0.
    """
    assembly = assemble(params, window, gravity_m_s2)
    problem = assembly.problem
    leaving = assembly.anchor == 0

    def of_leaving(table: Projections) -> Projections:
        table = table[leaving[table.landmark]]
        return replace(table, landmark=(np.cumsum(leaving) - 1)[table.landmark])

    part = replace(
        problem,
        initial=replace(problem.initial, inv_depths=problem.initial.inv_depths[leaving]),
        projections=of_leaving(problem.projections),
        stereo=tuple(of_leaving(table) for table in problem.stereo),
        depths=problem.depths.among(leaving) if problem.depths else None,
        imu=tuple((k, m) for k, m in problem.imu if k == 0),
        free_extrinsics=True,
        free_td=window.knows_td,
    )
    variables = (Variable("pose", 0), Variable("speed_bias", 0))
    return _departure("MARGIN_OLD", params, window, part, variables, assembly.ids[leaving])


def second_newest_leaves(params: Params, window: WindowState, gravity_m_s2: float) -> Departure | None:
    """MARGIN_SECOND_NEW (REFERENCE G2): the pose of the second newest frame leaves the prior; None if it is not there.

    No other factor takes part: its projections are forgotten and its IMU samples go to the next interval.
    """
    slot = len(window.frames) - 2
    if window.prior is None or BlockKey("pose", window.frames[slot].frame) not in window.prior.blocks:
        return None
    problem = assemble(params, window, gravity_m_s2).problem
    part = replace(
        problem,
        initial=replace(problem.initial, inv_depths=np.zeros(0)),
        projections=problem.projections[:0],
        stereo=(),
        depths=None,
        imu=(),
        free_extrinsics=True,
        free_td=window.knows_td,
    )
    return _departure("MARGIN_SECOND_NEW", params, window, part, (Variable("pose", slot),), np.zeros(0, np.int64))


def _departure(
    kind: str,
    params: Params,
    window: WindowState,
    problem: WindowProblem,
    leaving: tuple[Variable, ...],
    landmark_ids: np.ndarray,
) -> Departure:
    frames = tuple(f.frame for f in window.frames)
    return Departure(kind, problem, leaving, landmark_ids, frames, params.marginalization.first_estimates)


def _zeros(M: int, P: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros((M, P)), np.zeros(M), np.zeros(M)
