"""The window after its turn: keyframe decision, states, landmarks, what left, health, calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from .gate import Gate


class LandmarkStatus(StrEnum):
    CANDIDATE = "candidate"
    TRIANGULATED = "triangulated"
    OUTLIER = "outlier"
    MARGINALIZED = "marginalized"


LANDMARK_STATUSES = tuple(LandmarkStatus)
"""`LandmarkReport.status` holds indices into this tuple."""


@dataclass(frozen=True)
class KeyframeReport:
    """The keyframe decision about the second newest frame (REFERENCE W2, W3).  Any failed gate makes a keyframe.

    Gates are stated so that *passing all of them* means "not a keyframe": tracked >= min, parallax < min.
    """

    is_keyframe: bool
    reason: str  # one sentence
    parallax_px: float  # mean, px460, rotation compensated
    parallax_raw_px: float  # mean, px460, uncompensated
    tracked: int
    long_tracks: int
    new_tracks: int
    gates: tuple[Gate, ...]


@dataclass(frozen=True)
class WindowReport:
    """The window after this frame's solve, before the slide.  Slot 0 is the oldest."""

    frames: np.ndarray  # (n,) int64 frame indices
    t_ns: np.ndarray  # (n,) int64
    keyframe: np.ndarray  # (n,) bool
    p_w_b: np.ndarray  # (n, 3) m
    q_w_b: np.ndarray  # (n, 4) wxyz
    v_w_b: np.ndarray  # (n, 3) m/s
    b_a: np.ndarray  # (n, 3) m/s^2
    b_g: np.ndarray  # (n, 3) rad/s
    shared: np.ndarray  # (n,) int32, tracks shared with the newest frame
    error_px: np.ndarray  # (n,) float32, rms reprojection error of the observations in this frame, px460
    motion: np.ndarray | None = None
    """(6, 6) covariance of the motion from the keyframe before to the second newest frame when that is one, tangent
    (dp, dtheta): p + dp, q * Exp(dtheta); None unless loops are closed."""


@dataclass(frozen=True)
class LandmarkReport:
    """Every landmark the window knows after the solve."""

    ids: np.ndarray  # (m,) int64
    xyz_w: np.ndarray  # (m, 3) float32, NaN for candidates without depth
    inv_depth: np.ndarray  # (m,) float32, in the anchor camera; NaN without depth
    sigma_inv_depth: np.ndarray  # (m,) float32, from the visual information alone (poses held); NaN unknown
    anchor_slot: np.ndarray  # (m,) uint8
    n_obs: np.ndarray  # (m,) uint8
    error_px: np.ndarray  # (m,) float32 mean reprojection error, px460; NaN unknown
    status: np.ndarray  # (m,) uint8, index into LANDMARK_STATUSES


@dataclass(frozen=True)
class DepthReport:
    """What a depth camera says beside what the solve says (docs/depth.md).

    Errors are (measured / estimated - 1) / sigma.
    """

    sigma: float  # of a measured depth, as a share of it
    # one row per landmark of the window whose anchor has a depth
    ids: np.ndarray  # (m,) int64
    measured_m: np.ndarray  # (m,) float32 along z of the anchor; of `confirm` and `hold` the mean of the frames
    estimated_m: np.ndarray  # (m,) float32, after the solve; NaN without an estimate
    disagreement: np.ndarray  # (m,) float32 sigma between the frames that were compared; NaN where none were
    use: np.ndarray  # (m,) uint8, index into DEPTH_USES
    # one row per track of the newest frame that has a depth
    seen_ids: np.ndarray  # (k,) int64
    seen_m: np.ndarray  # (k,) float32 measured along z of the newest camera
    seen_estimated_m: np.ndarray  # (k,) float32, of its landmark after the solve; NaN without one
    gates: tuple[Gate, ...]  # advisory: shares of the landmarks and tracks that agree

    @property
    def error_sigma(self) -> np.ndarray:
        """(m,) of the landmarks at their anchors."""
        return (self.measured_m / self.estimated_m - 1.0) / self.sigma

    @property
    def seen_error_sigma(self) -> np.ndarray:
        """(k,) of the tracks in the newest frame."""
        return (self.seen_m / self.seen_estimated_m - 1.0) / self.sigma


@dataclass(frozen=True)
class BlockReport:
    """A named block of the marginalisation: `pose 3 (frame 120)`, `inv_depth of 57`, `extrinsic cam0` ..."""

    name: str
    size: int
    index: int  # first column in H of the marginalisation (dropped blocks first)
    dropped: bool


@dataclass(frozen=True)
class MarginalizationReport:
    """What left the window and what it left behind (SPEC 6.1, seed 003)."""

    kind: str  # "MARGIN_OLD", "MARGIN_SECOND_NEW" or "none"
    m: int
    n: int
    blocks: tuple[BlockReport, ...]
    rank: int
    eigenvalues: np.ndarray  # (n,) float64 of the new prior's information, ascending
    gauge_information: np.ndarray = field(default_factory=lambda: np.zeros(4))
    """(4,) what the new prior claims to know of x, y, z (1/m^2) and yaw (1/rad^2); see solver/spectrum.py."""


@dataclass(frozen=True)
class HealthReport:
    """Failure detection F1-F6 after the solve.  A failed deciding gate restarts the estimator."""

    gates: tuple[Gate, ...]
    outcome: str  # "" when healthy, else one sentence
    degeneracy: str = ""  # "" while the window sees motion, else which motion is missing: one sentence


@dataclass(frozen=True)
class CalibrationReport:
    """What a solve knows of the calibration (window/online.py); sigmas are NaN where it was held."""

    td_s: float  # t_imu = t_image + td
    td_sigma_s: float
    td_gates: tuple[Gate, ...]  # that let it be estimated; none where td is not
    T_b_c: np.ndarray  # (cameras, 4, 4)
    extrinsic_sigma: np.ndarray  # (cameras, 6) of the position in body axes in m, of the rotation in camera axes in rad
    extrinsic_gates: tuple[Gate, ...]  # likewise


@dataclass(frozen=True)
class PoseEstimate:
    """The newest frame's state right after its own solve; never revised afterwards."""

    p_w_b: np.ndarray
    q_w_b: np.ndarray  # wxyz
    v_w_b: np.ndarray
    b_a: np.ndarray
    b_g: np.ndarray
    late_s: float = 0.0  # its time on the IMU's clock minus the stamp of its image: td, and half of a readout
