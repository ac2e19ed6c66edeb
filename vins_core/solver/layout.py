"""Where the variables of the cameras are among the columns of the normal equations.

Poses come first, 6 columns each: those of the window's frames, then those of places, earlier keyframes that the window
sees again, which have no speed and bias.  Extrinsics follow, 6 each if they are free, the time offset if it is, then
speed-biases, 9 each: what a projection touches is one leading part of every matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SIZES = {"pose": 6, "extrinsic": 6, "td": 1, "speed_bias": 9}
"""Dimension of the tangent space of each kind of variable."""


@dataclass(frozen=True)
class Variable:
    """One variable of the cameras: `pose` or `speed_bias` of a slot, `extrinsic` of a camera, `td` of all (slot 0)."""

    kind: str  # "pose" | "speed_bias" | "extrinsic" | "td"
    slot: int

    @property
    def size(self) -> int:
        """Dimension of the tangent space."""
        return SIZES[self.kind]


@dataclass(frozen=True)
class Layout:
    """The columns of a window of `n_frames`."""

    n_frames: int
    n_extrinsics: int  # free ones; 0 when they are held
    n_places: int = 0
    inertial: bool = True  # whether there is an IMU; else speeds and biases are no variables
    n_td: int = 0  # 1 when the time offset is free

    @property
    def n_poses(self) -> int:
        """Frames, then places."""
        return self.n_frames + self.n_places

    @property
    def visual(self) -> int:
        """P: the columns that projections touch."""
        return 6 * (self.n_poses + self.n_extrinsics) + self.n_td

    @property
    def size(self) -> int:
        """D: all columns."""
        return self.visual + (9 * self.n_frames if self.inertial else 0)

    def is_free(self, variable: Variable) -> bool:
        return variable.slot < {"extrinsic": self.n_extrinsics, "td": self.n_td}.get(variable.kind, variable.slot + 1)

    def columns(self, kind: str, slots: np.ndarray | list[int]) -> np.ndarray:
        """(k, size): the columns of a kind of variable in each of k slots."""
        size = SIZES[kind]
        return self._start(kind) + size * np.asarray(slots)[:, None] + np.arange(size)

    def columns_of(self, variables: list[Variable]) -> np.ndarray:
        """The columns of several variables, one after the other."""
        starts = [(self._start(v.kind) + v.size * v.slot, v.size) for v in variables]
        return np.array([column for start, size in starts for column in range(start, start + size)], np.int64)

    def _start(self, kind: str) -> int:
        extrinsics = 6 * self.n_poses
        return {
            "pose": 0,
            "extrinsic": extrinsics,
            "td": extrinsics + 6 * self.n_extrinsics,
            "speed_bias": self.visual,
        }[kind]
