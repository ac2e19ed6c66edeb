"""Linearisation of a window: robustly weighted normal equations in arrow form.

    [ H   W' ] [ dc ]     [ g   ]        c: cameras, dense        (D columns)
    [ W   h  ] [ dl ] = - [ g_l ]        l: inverse depths, diagonal

Column layout of c: poses 6 each, then extrinsics 6 each if they are free, then speed-biases 9 each.  Projections
touch only the leading P = 6 n (+ 6 cameras) columns, so W is (M, P).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..factors import imu as imu_factor
from ..factors import prior as prior_factor
from ..factors import reprojection
from ..report import CostSplit
from .problem import Block, PriorFactor, States, WindowProblem, retract_poses


@dataclass(frozen=True)
class Layout:
    """Where each block's tangent starts among the camera columns."""

    n_frames: int
    n_cameras: int  # free extrinsics; 0 when they are held

    @property
    def visual(self) -> int:
        """P: columns that projections touch."""
        return 6 * (self.n_frames + self.n_cameras)

    @property
    def size(self) -> int:
        """D: all columns."""
        return self.visual + 9 * self.n_frames

    def pose(self, slot: int) -> int:
        return 6 * slot

    def extrinsic(self, camera: int) -> int:
        return 6 * (self.n_frames + camera)

    def speed_bias(self, slot: int) -> int:
        return self.visual + 9 * slot

    def columns(self, block: Block) -> np.ndarray:
        start = {"pose": self.pose, "speed_bias": self.speed_bias, "extrinsic": self.extrinsic}[block.kind]
        return start(block.slot) + np.arange(block.size)


@dataclass(frozen=True)
class NormalEquations:
    """J'J and J'r at one state.  H is symmetric and complete."""

    cost: CostSplit
    H: np.ndarray  # (D, D)
    g: np.ndarray  # (D,)
    W: np.ndarray  # (M, P)
    h: np.ndarray  # (M,) information of each inverse depth, all else held
    g_l: np.ndarray  # (M,)


@dataclass(frozen=True)
class Residuals:
    """What each factor says at one state."""

    visual: np.ndarray  # (2, N) whitened, before the robust loss
    imu: np.ndarray  # (K, 15) whitened
    prior: np.ndarray  # (n,)


class Linearizer:
    """The index structure of one problem, built once; `linearize` and `residuals` are functions of the states."""

    def __init__(self, problem: WindowProblem):
        self.problem = problem
        n = problem.n_frames
        self.layout = Layout(n, len(problem.initial.extrinsics) if problem.free_extrinsics else 0)
        self._visual = _Visual(problem, self.layout) if len(problem.projections) else None
        self._imu = _Imu(problem, self.layout) if problem.imu else None
        self._prior = _Prior(problem.prior, self.layout) if problem.prior else None

    def linearize(self, states: States) -> NormalEquations:
        layout, m = self.layout, self.problem.n_landmarks
        H, g = np.zeros((layout.size, layout.size)), np.zeros(layout.size)
        W, h, g_l = np.zeros((m, layout.visual)), np.zeros(m), np.zeros(m)
        prior = self._prior.add(states, H, g) if self._prior else 0.0
        inertial = self._imu.add(states, H, g) if self._imu else 0.0
        visual = self._visual.add(states, H, g, W, h, g_l) if self._visual else 0.0
        return NormalEquations(CostSplit(visual, inertial, prior), H, g, W, h, g_l)

    def residuals(self, states: States) -> Residuals:
        return Residuals(
            self._visual.residuals(states) if self._visual else np.zeros((2, 0)),
            self._imu.residuals(states) if self._imu else np.zeros((0, 15)),
            self._prior.residuals(states) if self._prior else np.zeros(0),
        )

    def retract(self, states: States, dc: np.ndarray, dl: np.ndarray) -> States:
        """states [+] (dc, dl)."""
        layout = self.layout
        n = layout.n_frames
        extrinsics = states.extrinsics
        if layout.n_cameras:
            extrinsics = retract_poses(extrinsics, dc[6 * n : layout.visual].reshape(-1, 6))
        return States(
            retract_poses(states.poses, dc[: 6 * n].reshape(n, 6)),
            states.speed_biases + dc[layout.visual :].reshape(n, 9),
            extrinsics,
            states.inv_depths + dl,
        )


class _Visual:
    def __init__(self, problem: WindowProblem, layout: Layout):
        self.table, self.loss = problem.projections, problem.loss
        table, n = self.table, len(problem.projections)
        factor = reprojection.FACTORS[problem.residual]
        active = (
            ("pose_i", "pose_j", "extrinsic", "inv_depth") if layout.n_cameras else ("pose_i", "pose_j", "inv_depth")
        )
        self.batch = factor.batch(n, active, uniform=("extrinsic",))
        self.residual_batch = factor.batch(n, (), uniform=("extrinsic",))
        data = reprojection.measurement(problem.residual, table.rays_i, table.rays_j, problem.sqrt_info)
        self.batch.data[:] = data
        self.residual_batch.data[:] = data
        self.columns = factor.columns(active)
        P = layout.visual
        starts = [6 * table.anchor, 6 * table.observer]
        if layout.n_cameras:
            starts.append(np.full(n, layout.extrinsic(table.camera)))
        self.n_camera_columns = 6 * len(starts)
        columns = np.concatenate([s[None] + np.arange(6)[:, None] for s in starts])  # (12 or 18, N)
        rows = np.arange(2)[:, None, None] * n + np.arange(n)  # (2, 1, N)
        self.scatter = columns[None] * (2 * n) + rows  # into At (P, 2 N)
        self.At = np.zeros((P, 2 * n))

    def _fill(self, batch, states: States) -> None:
        table = self.table
        poses = np.ascontiguousarray(states.poses.T)
        batch.inputs[0][:] = poses[:, table.anchor]
        batch.inputs[1][:] = poses[:, table.observer]
        batch.inputs[2][:] = states.extrinsics[table.camera]
        batch.inputs[3][:] = states.inv_depths[table.landmark]
        batch.evaluate()

    def add(self, states, H, g, W, h, g_l) -> float:
        self._fill(self.batch, states)
        r, J = self.batch.r, self.batch.J
        s = r[0] * r[0] + r[1] * r[1]
        weight = self.loss.weight(s)
        r, J = r * weight, J * weight
        k = self.n_camera_columns
        self.At.reshape(-1)[self.scatter] = J[:, :k]
        At, P = self.At, len(self.At)
        H[:P, :P] += At @ At.T
        g[:P] += At @ r.reshape(-1)
        Jl = J[:, k]
        rows = self.table.landmark
        m = len(h)
        h += np.bincount(rows, Jl[0] * Jl[0] + Jl[1] * Jl[1], m)
        g_l += np.bincount(rows, Jl[0] * r[0] + Jl[1] * r[1], m)
        products = J[0, :k] * Jl[0] + J[1, :k] * Jl[1]
        flat = rows[None] * P + self.scatter[0] // At.shape[1]
        W += np.bincount(flat.reshape(-1), products.reshape(-1), m * P).reshape(m, P)
        return 0.5 * float(self.loss.rho(s).sum())

    def residuals(self, states: States) -> np.ndarray:
        self._fill(self.residual_batch, states)
        return self.residual_batch.r.copy()


class _Imu:
    def __init__(self, problem: WindowProblem, layout: Layout):
        self.slots = np.array([k for k, _ in problem.imu])
        motions = [m for _, m in problem.imu]
        self.batch = imu_factor.IMU.batch(len(motions), imu_factor.ACTIVE, backend="vm")
        self.batch.data[:] = imu_factor.measurement(motions, problem.gravity_m_s2)
        self.whitening = np.stack([imu_factor.whitening(m) for m in motions])
        k = self.slots[:, None]
        six, nine = np.arange(6), np.arange(9)
        self.columns = np.concatenate(
            [6 * k + six, layout.visual + 9 * k + nine, 6 * (k + 1) + six, layout.visual + 9 * (k + 1) + nine], 1
        )

    def _whitened(self, states: States) -> tuple[np.ndarray, np.ndarray]:
        b, k = self.batch, self.slots
        b.inputs[0][:] = states.poses[k].T
        b.inputs[1][:] = states.speed_biases[k].T
        b.inputs[2][:] = states.poses[k + 1].T
        b.inputs[3][:] = states.speed_biases[k + 1].T
        b.evaluate()
        r = (self.whitening @ b.r.T[:, :, None])[:, :, 0]
        return r, self.whitening @ b.J.transpose(2, 0, 1)

    def add(self, states: States, H: np.ndarray, g: np.ndarray) -> float:
        r, J = self._whitened(states)
        JtJ = J.transpose(0, 2, 1) @ J
        Jtr = (r[:, None] @ J)[:, 0]
        for columns, A, b in zip(self.columns, JtJ, Jtr):
            H[columns[:, None], columns] += A
            g[columns] += b
        return 0.5 * float(np.vdot(r, r))

    def residuals(self, states: States) -> np.ndarray:
        return self._whitened(states)[0]


class _Prior:
    def __init__(self, factor: PriorFactor, layout: Layout):
        self.factor = factor
        offsets = np.cumsum([0] + [b.size for b in factor.blocks])
        self.local = [np.arange(o, o + b.size) for o, b in zip(offsets, factor.blocks)]
        free = [k for k, b in enumerate(factor.blocks) if b.kind != "extrinsic" or layout.n_cameras]
        self.free = np.concatenate([self.local[k] for k in free])
        self.columns = np.concatenate([layout.columns(factor.blocks[k]) for k in free])

    def _evaluate(self, states: States) -> tuple[np.ndarray, np.ndarray]:
        """Residual, and J with respect to the tangent at the current state."""
        prior = self.factor
        dx, J = np.empty(prior.J.shape[1]), prior.J.copy()
        for block, x0, local in zip(prior.blocks, prior.x0, self.local):
            d = prior_factor.difference(block.value(states), x0)
            dx[local] = d
            if block.size == 6:
                J[:, local[3:]] = J[:, local[3:]] @ prior_factor.inverse_right_jacobian(d[3:])
        return prior.r + prior.J @ dx, J

    def add(self, states: States, H: np.ndarray, g: np.ndarray) -> float:
        r, J = self._evaluate(states)
        J = J[:, self.free]
        H[self.columns[:, None], self.columns] += J.T @ J
        g[self.columns] += J.T @ r
        return 0.5 * float(r @ r)

    def residuals(self, states: States) -> np.ndarray:
        return self._evaluate(states)[0]
