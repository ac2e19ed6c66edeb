"""One window as a least-squares problem: what is estimated, what was measured.  Pure data.

    min  1/2 |r_prior|^2 + 1/2 sum |L^-1 r_imu|^2 + 1/2 sum rho(|r_visual|^2) + 1/2 sum rho(r_depth^2)

Frames are numbered by slot, oldest 0; the factors are tables of slots and rows.  Poses may go on after those of the
frames: places, earlier keyframes that see landmarks of the window, tied to nothing else (REFERENCE R2).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..factors.preintegration import Preintegration
from ..factors.reprojection import Kind
from ..factors.robust import Loss
from ..geometry import so3
from .layout import Variable


@dataclass(frozen=True)
class States:
    """The variables.  Tangent of a pose or extrinsic: (dp, dtheta), q = q0 * Exp(dtheta)."""

    poses: np.ndarray  # (n + places, 7) p_w_b, q_w_b wxyz
    speed_biases: np.ndarray  # (n, 9) v_w_b, b_a, b_g
    extrinsics: np.ndarray  # (cameras, 7) p_b_c, q_b_c
    inv_depths: np.ndarray  # (M,) 1/m in the anchor camera (geometry/inverse_depth.py)
    td_s: np.ndarray = field(default_factory=lambda: np.zeros(1))  # (1,) t_imu = t_image + td

    def value(self, variable: Variable) -> np.ndarray:
        return self.tables()[variable.kind][variable.slot]

    def tables(self) -> dict[str, np.ndarray]:
        """Per kind of variable its values, a row a slot."""
        return {
            "pose": self.poses,
            "speed_bias": self.speed_biases,
            "extrinsic": self.extrinsics,
            "td": self.td_s[None],
        }


@dataclass(frozen=True)
class RayMotion:
    """How fast the rays of projections move in their images: what the time offset does to them (REFERENCE O7)."""

    velocity_i: np.ndarray  # (N, 2) d(x/z, y/z)/dt in the anchor camera, 1/s
    velocity_j: np.ndarray  # (N, 2) in the observing camera
    td_s: float  # the time offset at which the rays of the table are those at the time of the poses

    def __getitem__(self, rows: np.ndarray | slice) -> RayMotion:
        return replace(self, velocity_i=self.velocity_i[rows], velocity_j=self.velocity_j[rows])


@dataclass(frozen=True)
class Projections:
    """One row per reprojection factor, all of one kind and one pair of cameras (factors/reprojection.py).

    mono: each observation of a landmark by the camera of its anchor but the anchor's own; cross: by another camera in
    another frame; same: by another camera in the frame of the anchor, where `observer` equals `anchor`.
    """

    anchor: np.ndarray  # (N,) slot whose camera holds the inverse depth
    observer: np.ndarray  # (N,) slot that sees the landmark again, not lower than the anchor
    landmark: np.ndarray  # (N,) row of States.inv_depths
    rays_i: np.ndarray  # (N, 3) unit ray in the anchor camera
    rays_j: np.ndarray  # (N, 3) unit ray in the observing camera
    camera: int = 0  # of the anchor
    seen_by: int = 0  # camera that sees the landmark again
    kind: Kind = "mono"
    motion: RayMotion | None = None
    """How the rays move, where the time offset is estimated."""

    def __len__(self) -> int:
        return len(self.anchor)

    def __getitem__(self, rows: np.ndarray | slice) -> Projections:
        return replace(
            self,
            anchor=self.anchor[rows],
            observer=self.observer[rows],
            landmark=self.landmark[rows],
            rays_i=self.rays_i[rows],
            rays_j=self.rays_j[rows],
            motion=self.motion and self.motion[rows],
        )


@dataclass(frozen=True)
class Depths:
    """What a depth camera says of the landmarks: factors (factors/depth.py), and landmarks that are no variables."""

    landmark: np.ndarray  # (K,) row of States.inv_depths, each at most once
    depth_m: np.ndarray  # (K,) along z of the anchor
    sigma: float  # standard deviation, as a share of the depth
    held: np.ndarray  # (H,) rows of States.inv_depths that stay as they are; no row is in both

    def among(self, chosen: np.ndarray) -> Depths:
        """Of the landmarks in `chosen` (M,) bool, which become rows 0, 1, ..."""
        renumber, kept = np.cumsum(chosen) - 1, chosen[self.landmark]
        held = renumber[self.held[chosen[self.held]]]
        return Depths(renumber[self.landmark[kept]], self.depth_m[kept], self.sigma, held)


@dataclass(frozen=True)
class PriorFactor:
    """r + J (x [-] x0) over `blocks`, whose tangents are the columns of J in this order."""

    blocks: tuple[Variable, ...]
    x0: tuple[np.ndarray, ...]  # per block, (7,), (9,) or (1,)
    J: np.ndarray  # (n, n)
    r: np.ndarray  # (n,)


@dataclass(frozen=True)
class WindowProblem:
    """The whole problem; see the top of this file."""

    initial: States
    projections: Projections
    imu: tuple[tuple[int, Preintegration], ...]  # (k, motion from slot k to slot k + 1)
    prior: PriorFactor | None
    gravity_m_s2: float
    residual: str  # "plane" | "sphere"
    sqrt_info: float  # 1/sigma of a normalised coordinate
    loss: Loss
    free_extrinsics: bool = False
    """Whether the extrinsics are variables; held ones cost nothing."""
    free_td: bool = False
    """Whether the time offset is a variable; all tables have a `motion` then."""
    stereo: tuple[Projections, ...] = ()
    """What a second camera sees of the same landmarks, a table for each kind."""
    depths: Depths | None = None
    """What a depth camera says of them; None without one."""
    inertial: bool = True
    """Whether there is an IMU.  Without, speeds and biases are no variables and nothing shows where down is: the whole
    pose of the oldest frame is held."""

    @property
    def tables(self) -> tuple[Projections, ...]:
        """All tables of projections that have rows."""
        return tuple(table for table in (self.projections, *self.stereo) if len(table))

    @property
    def n_frames(self) -> int:
        return len(self.initial.speed_biases)

    @property
    def n_places(self) -> int:
        return len(self.initial.poses) - self.n_frames

    @property
    def n_landmarks(self) -> int:
        return len(self.initial.inv_depths)


def retract_poses(x: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(k, 7) [+] (k, 6)."""
    return np.concatenate([x[:, :3] + d[:, :3], so3.retract(x[:, 3:], d[:, 3:])], 1)


def hold_oldest(states: States, pose: np.ndarray, whole: bool = False) -> States:
    """`states` moved as a whole so that the oldest frame has position and yaw of `pose` (7,)  (REFERENCE O9).

    The problem cannot see these four directions; the move is the rotation about gravity that undoes the twist of
    the oldest frame, which unlike a difference of Euler angles exists for any attitude.  `whole`: so that it has all of
    that pose, for a problem without IMU.
    """
    q_change = so3.multiply(pose[3:], so3.inverse(states.poses[0, 3:]))
    twist = q_change if whole else np.array([q_change[0], 0.0, 0.0, q_change[3]])
    norm = np.linalg.norm(twist)
    twist = twist / norm if norm > 1e-9 else np.array([1.0, 0.0, 0.0, 0.0])
    p = pose[:3] + so3.rotate(twist, states.poses[:, :3] - states.poses[0, :3])
    q = so3.normalize(so3.multiply(twist, states.poses[:, 3:]))
    v = so3.rotate(twist, states.speed_biases[:, :3])
    return replace(
        states,
        poses=np.concatenate([p, q], 1),
        speed_biases=np.concatenate([v, states.speed_biases[:, 3:]], 1),
    )
