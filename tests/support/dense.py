"""A window's factors as one dense Jacobian: the reference that needs no normal equations and no elimination."""

from __future__ import annotations

import numpy as np

from vins_core.solver.layout import Variable
from vins_core.solver.levenberg_marquardt import gauge_damping
from vins_core.solver.linearize import Linearizer
from vins_core.solver.problem import WindowProblem
from vins_core.solver.visual_rows import NumpyRows


def jacobian(problem: WindowProblem) -> tuple[np.ndarray, np.ndarray, Linearizer]:
    """J (rows, D + M) and r (rows,) at the initial states, robust weights applied; cameras first, then depths."""
    linearizer = Linearizer(problem)
    states, D = problem.initial, linearizer.layout.size
    J, r = [np.zeros((0, D + problem.n_landmarks))], [np.zeros(0)]

    def add(r_part: np.ndarray, J_part: np.ndarray, columns: np.ndarray) -> None:
        block = np.zeros((len(r_part), D + problem.n_landmarks))
        np.put_along_axis(block, np.broadcast_to(columns, J_part.shape), J_part, 1)
        J.append(block)
        r.append(r_part)

    if linearizer.prior:
        add(*linearizer.prior.rows(states), linearizer.prior.columns)
    if linearizer.inertial:
        for r_k, J_k, columns in zip(*linearizer.inertial.rows(states), linearizer.inertial.columns):
            add(r_k, J_k, columns)
    for visual in linearizer.visual:
        system, *_ = NumpyRows(visual.index).system(states)
        columns = np.column_stack([visual.columns[visual.pair], D + visual.index.table.landmark])
        for row in range(2):
            add(system[-1, row].copy(), system[:-1, row].T, columns)
    return np.concatenate(J), np.concatenate(r), linearizer


def step(problem: WindowProblem, held_slot: int) -> dict[Variable, np.ndarray]:
    """The Gauss-Newton step by orthogonal decomposition, position and yaw of one pose held."""
    J, r, linearizer = jacobian(problem)
    layout, poses = linearizer.layout, problem.initial.poses
    values, vectors = np.linalg.eigh(gauge_damping(poses[held_slot]))
    hold = np.zeros((6, J.shape[1]))
    hold[:, layout.columns("pose", [held_slot])[0]] = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
    J, r = np.concatenate([J, hold]), np.append(r, np.zeros(6))
    scale = 1 / np.linalg.norm(J, axis=0)
    d = -scale * np.linalg.lstsq(J * scale, r, rcond=1e-15)[0]
    blocks = [Variable(kind, k) for kind in ("pose", "speed_bias") for k in range(problem.n_frames)]
    blocks += [Variable("extrinsic", k) for k in range(layout.n_extrinsics)]
    blocks += [Variable("td", 0)] if layout.n_td else []
    return {block: d[layout.columns_of([block])] for block in blocks}
