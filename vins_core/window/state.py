"""The estimator's state: what crosses a `step`.  Frozen values; arrays are never written after construction.

A window is a tuple of frames, oldest first; the last one is the newest.  Tracks live in the frames that saw them:
`Observations` of a frame are shared by every window that contains it, so history costs one copy per frame.
Blocks of the prior are named by frame number, not by slot, so that sliding renames nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..factors.preintegration import Preintegration
from ..report import LANDMARK_STATUSES, LandmarkStatus
from ..solver.layout import SIZES

CANDIDATE, TRIANGULATED, OUTLIER, MARGINALIZED = (
    LANDMARK_STATUSES.index(s)
    for s in (
        LandmarkStatus.CANDIDATE,
        LandmarkStatus.TRIANGULATED,
        LandmarkStatus.OUTLIER,
        LandmarkStatus.MARGINALIZED,
    )
)


@dataclass(frozen=True)
class Observations:
    """The tracks of one image as the estimator sees them, sorted by id."""

    ids: np.ndarray  # (n,) int64, increasing
    rays: np.ndarray  # (n, 3) float64, unit rays in the camera frame
    uv_px: np.ndarray  # (n, 2) float32
    velocity: np.ndarray  # (n, 2) float32, d(x/z, y/z)/dt, 1/s
    right: Observations | None = None
    """Those of these tracks that the second camera sees as well, in its image and its frame; None without one."""
    depth_m: np.ndarray | None = None
    """(n,) float32, along z of the camera, NaN where the depth camera says nothing; None without one."""

    def __len__(self) -> int:
        return len(self.ids)

    def among(self, ids: np.ndarray) -> Observations:
        """Those of the tracks `ids`, without what the second camera sees."""
        rows = np.isin(self.ids, ids)
        return Observations(self.ids[rows], self.rays[rows], self.uv_px[rows], self.velocity[rows])


@dataclass(frozen=True)
class WindowFrame:
    """One frame of the window: its measurements and its estimated state."""

    frame: int
    t_ns: int
    is_keyframe: bool
    observations: Observations
    imu: Preintegration | None  # from the previous frame of the window to this one; None for the oldest
    p_w_b: np.ndarray  # (3,)
    q_w_b: np.ndarray  # (4,) wxyz
    v_w_b: np.ndarray  # (3,)
    b_a: np.ndarray  # (3,)
    b_g: np.ndarray  # (3,)
    td_s: float = 0.0
    """The time offset at which the rays are those at the time of the pose: that by which its IMU samples were cut."""


@dataclass(frozen=True)
class Landmarks:
    """Inverse depths of tracks in the first frame of the window that sees them (their anchor)."""

    ids: np.ndarray  # (m,) int64, increasing
    inv_depth: np.ndarray  # (m,) float64, 1/m in the anchor camera (geometry/inverse_depth.py); NaN when unknown
    status: np.ndarray  # (m,) uint8, index into LANDMARK_STATUSES

    def __len__(self) -> int:
        return len(self.ids)

    @staticmethod
    def empty() -> Landmarks:
        return Landmarks(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.uint8))


@dataclass(frozen=True)
class BlockKey:
    """`pose` and `speed_bias` of a frame number, `extrinsic` of a camera, `td` of all (0)."""

    kind: str  # "pose" | "speed_bias" | "extrinsic" | "td"
    id: int

    @property
    def size(self) -> int:
        """Dimension of the tangent space."""
        return SIZES[self.kind]

    @property
    def of_frame(self) -> bool:
        """Whether `id` is the number of a frame."""
        return self.kind in ("pose", "speed_bias")


@dataclass(frozen=True)
class Prior:
    """What marginalised frames left: the residual r + J (x [-] x0), seed 000.3.3.4.

    Pose and extrinsic blocks of `x0` are (p, q wxyz) with tangent (dp, dtheta), q = q0 * Exp(dtheta);
    speed-bias blocks are (v, b_a, b_g), the time offset is (td,) in s.
    """

    blocks: tuple[BlockKey, ...]
    x0: tuple[np.ndarray, ...]  # per block, (7,), (9,) or (1,)
    J: np.ndarray  # (n, n)
    r: np.ndarray  # (n,)


@dataclass(frozen=True)
class Calibrates:
    """What of the calibration is estimated along with the window (online.py)."""

    td: bool = False
    extrinsics: bool = False


@dataclass(frozen=True)
class WindowState:
    frames: tuple[WindowFrame, ...]
    landmarks: Landmarks
    prior: Prior | None
    T_b_c: np.ndarray  # (cameras, 4, 4)
    inertial: bool = True
    """Whether there is an IMU; without, the world hangs on the oldest frame, and velocities and biases mean nothing."""
    td_s: float = 0.0
    """t_imu = t_image + td, as given or as estimated last."""
    calibrates: Calibrates = Calibrates()

    @property
    def knows_td(self) -> bool:
        """Whether the time offset is a variable of its prior, or will be."""
        return self.calibrates.td or bool(self.prior and any(key.kind == "td" for key in self.prior.blocks))
