"""What a keyframe may change: four degrees of freedom or six, behind one interface.

A variant says which numbers describe a keyframe (its node), how they become a pose, and which factor ties two nodes.
`groups` are the components of a node's tangent that never meet in J'J: with four degrees of freedom the height is a
problem of its own, so the large one has three instead of four columns a keyframe.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..factors.factor import Factor
from ..factors.relative_pose import (
    ACTIVE_4,
    ACTIVE_6,
    FOUR_DOF,
    SIX_DOF,
    measurement_4dof,
    measurement_6dof,
)
from ..geometry import heading, so3
from .edges import Edges


class Variant(Protocol):
    @property
    def dof(self) -> int: ...
    @property
    def factor(self) -> Factor: ...
    @property
    def active(self) -> tuple[str, ...]: ...
    @property
    def groups(self) -> tuple[tuple[int, ...], ...]: ...

    def nodes(self, T_g_b: np.ndarray, T_o_b: np.ndarray) -> np.ndarray:
        """(n, 7) poses in the graph and in the odometry -> (n, size)."""
        ...

    def poses(self, nodes: np.ndarray, T_o_b: np.ndarray) -> np.ndarray:
        """(n, size) -> (n, 7) poses in the graph."""
        ...

    def retract(self, nodes: np.ndarray, d: np.ndarray) -> np.ndarray:
        """nodes [+] d with d (n, dof)."""
        ...

    def measurement(
        self, edges: Edges, nodes: np.ndarray, T_o_b: np.ndarray, w_p: np.ndarray, w_r: np.ndarray
    ) -> np.ndarray:
        """Data of the factor, (n_data, e), for an optimisation that begins at `nodes`."""
        ...


@dataclass(frozen=True)
class _FourDof:
    """Node (x, y, z, psi): T_g_b = (p, Rz(psi) R_o_b).  Roll and pitch stay those of the odometry."""

    dof = 4
    factor = FOUR_DOF
    active = ACTIVE_4
    groups = ((0, 1, 3), (2,))

    def nodes(self, T_g_b: np.ndarray, T_o_b: np.ndarray) -> np.ndarray:
        return np.concatenate([T_g_b[:, :3], heading.difference(T_g_b[:, 3:], T_o_b[:, 3:])[:, None]], 1)

    def poses(self, nodes: np.ndarray, T_o_b: np.ndarray) -> np.ndarray:
        q = so3.multiply(heading.about_gravity(nodes[:, 3]), T_o_b[:, 3:])
        return np.concatenate([nodes[:, :3], so3.normalize(q)], 1)

    def retract(self, nodes: np.ndarray, d: np.ndarray) -> np.ndarray:
        return nodes + d

    def measurement(
        self, edges: Edges, nodes: np.ndarray, T_o_b: np.ndarray, w_p: np.ndarray, w_r: np.ndarray
    ) -> np.ndarray:
        """The measured turn is taken on the side of +-180 degrees on which the residual is short at the start."""
        q = T_o_b[:, 3:]
        data = measurement_4dof(q[edges.i], q[edges.j], edges.T_i_j, w_p, w_r)
        turned = nodes[edges.j, 3] - nodes[edges.i, 3]
        data[3] = turned - heading.wrap(turned - data[3])
        return data


@dataclass(frozen=True)
class _SixDof:
    """Node (p, q wxyz) = T_g_b with the tangent (dp, dtheta) of factors/symbolic.py."""

    dof = 6
    factor = SIX_DOF
    active = ACTIVE_6
    groups = ((0, 1, 2, 3, 4, 5),)

    def nodes(self, T_g_b: np.ndarray, T_o_b: np.ndarray) -> np.ndarray:
        return T_g_b

    def poses(self, nodes: np.ndarray, T_o_b: np.ndarray) -> np.ndarray:
        return nodes

    def retract(self, nodes: np.ndarray, d: np.ndarray) -> np.ndarray:
        return np.concatenate([nodes[:, :3] + d[:, :3], so3.retract(nodes[:, 3:], d[:, 3:])], 1)

    def measurement(
        self, edges: Edges, nodes: np.ndarray, T_o_b: np.ndarray, w_p: np.ndarray, w_r: np.ndarray
    ) -> np.ndarray:
        return measurement_6dof(edges.T_i_j, w_p, w_r)


VARIANTS: dict[str, Variant] = {"4": _FourDof(), "6": _SixDof()}
