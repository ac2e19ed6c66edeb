"""How every stage explains itself: gates, outcomes, and the report of one frame.

A `Gate` is one comparison that decided something.  A `FrameReport` holds all that the estimator knew at one
frame; it is what the record stores and what every panel of the interface draws.  Reports contain no times
measured on a clock (those are `Timings`, kept beside the report), so that equal runs give equal reports.
"""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from .sensors import Anomaly, GpsFix, ImageRef


@dataclass(frozen=True)
class Gate:
    """One comparison `value op limit` and the parameter (`section.name`) that sets the limit.

    `value` is None when it could not be computed; such a gate has not passed.
    An advisory gate (`decides=False`) is shown but changes nothing.
    """

    name: str
    value: float | None
    op: str  # ">=", ">", "<=", "<"
    limit: float
    knob: str = ""
    unit: str = ""
    decides: bool = True

    def __post_init__(self) -> None:
        """Counts become floats here, as they would when written and read, so that equal gates stay equal."""
        object.__setattr__(self, "value", None if self.value is None else float(self.value))
        object.__setattr__(self, "limit", float(self.limit))

    @property
    def passed(self) -> bool:
        if self.value is None or not np.isfinite(self.value):
            return False
        match self.op:
            case ">=":
                return self.value >= self.limit
            case ">":
                return self.value > self.limit
            case "<=":
                return self.value <= self.limit
            case "<":
                return self.value < self.limit
        raise ValueError(f"unknown comparison {self.op!r} in gate {self.name!r}")

    @property
    def margin(self) -> float | None:
        """How far the value is on the passing side (negative: what is missing), in the gate's unit."""
        if self.value is None:
            return None
        return self.value - self.limit if self.op.startswith(">") else self.limit - self.value


def all_pass(gates: "tuple[Gate, ...] | list[Gate]") -> bool:
    """True when every deciding gate has passed."""
    return all(g.passed for g in gates if g.decides)


class Status(StrEnum):
    """What the estimator is doing after a frame."""

    FILLING = "filling the window"
    INITIALIZING = "initializing"
    TRACKING = "tracking"
    FAILED = "failed, restarting"


class LossReason(StrEnum):
    """Why a track ended (SPEC 2.2)."""

    FLOW = "flow failed"
    FLOW_BACK = "flow-back"
    BORDER = "border"
    RANSAC = "F-RANSAC"
    MASK = "mask"
    OUTLIER = "estimator outlier"
    DEPTH = "negative depth"
    RESET = "tracker reset"


class RightLoss(StrEnum):
    """Why a track has no match in the image of the second camera."""

    FLOW = "flow failed"
    FLOW_BACK = "flow-back"
    BORDER = "border"
    EPIPOLAR = "epipolar line"
    NO_IMAGE = "no image"


class DepthLoss(StrEnum):
    """Why the depth image says nothing of a track."""

    NO_IMAGE = "no image"
    MISSING = "no depth"
    NEAR = "too near"
    FAR = "too far"
    EDGE = "at an edge"


class DepthUse(StrEnum):
    """What the estimator makes of a depth at a landmark's anchor."""

    FACTOR = "pulls at its depth"
    HELD = "held there"
    WAITING = "waiting for more frames"
    UNSTEADY = "frames disagree"
    GATED = "disagrees with the estimate"


class LandmarkStatus(StrEnum):
    CANDIDATE = "candidate"
    TRIANGULATED = "triangulated"
    OUTLIER = "outlier"
    MARGINALIZED = "marginalized"


LOSS_REASONS = tuple(LossReason)
"""`TrackReport.lost_reason` holds indices into this tuple."""
RIGHT_LOSSES = tuple(RightLoss)  # begins as LOSS_REASONS does
"""`TrackReport.right_loss` holds indices into this tuple."""
DEPTH_LOSSES = tuple(DepthLoss)
"""`TrackReport.depth_loss` holds indices into this tuple."""
DEPTH_USES = tuple(DepthUse)
"""`DepthReport.use` holds indices into this tuple."""
LANDMARK_STATUSES = tuple(LandmarkStatus)
"""`LandmarkReport.status` holds indices into this tuple."""


@dataclass(frozen=True)
class TrackReport:
    """What the front end did between the previous frame and this one (all images in between)."""

    ids: np.ndarray  # (n,) int64, tracks alive in this frame, new ones last
    uv_px: np.ndarray  # (n, 2) float32
    age: np.ndarray  # (n,) int32, number of images the track has been seen in, 1 = new
    velocity: np.ndarray  # (n, 2) float32, d(x/z, y/z)/dt on the normalised plane, 1/s; 0 for new tracks
    lost_ids: np.ndarray  # (k,) int64
    lost_uv_px: np.ndarray  # (k, 2) float32, last position where it was seen
    lost_age: np.ndarray  # (k,) int32
    lost_reason: np.ndarray  # (k,) uint8, index into LOSS_REASONS
    n_new: int
    gates: tuple[Gate, ...]  # e.g. F-RANSAC inlier ratio, share surviving flow
    # with a second camera, else empty; one row per track alive
    right_uv_px: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    """(n, 2) float32, where the second camera sees each track, or seemed to before flow-back or the epipolar line
    refused it; NaN where it was not found at all."""
    right_loss: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint8))
    """(n,) uint8, index into RIGHT_LOSSES; 255 where there is a match."""
    # with a depth camera, else empty; one row per track alive
    depth_m: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(n,) float32 m, as flow sees it around each track; NaN where too few pixels have one."""
    depth_variation: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(n,) float32, by how much a tenth of the depths around it differ from their median, as a share."""
    depth_share: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(n,) float32, share of the pixels around it that have a depth."""
    depth_loss: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint8))
    """(n,) uint8, index into DEPTH_LOSSES; 255 where the estimator gets the depth."""

    @property
    def usable_depth_m(self) -> np.ndarray:
        """(n,) float32, NaN where the estimator gets none."""
        return np.where(self.depth_loss == 255, self.depth_m, np.float32(np.nan))


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
class InitStage:
    """One stage of the initialisation: relative pose, structure, gyro bias, alignment, gravity ..."""

    name: str
    gates: tuple[Gate, ...]
    outcome: str  # "" when it passed, else one sentence
    values: dict[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        return self.outcome == ""


@dataclass(frozen=True)
class InitReport:
    """One attempt to initialise (REFERENCE 8), kept whether it succeeded or not."""

    stages: tuple[InitStage, ...]
    succeeded: bool
    reference_slot: int  # l: window slot paired with the newest frame, -1 if none
    scale: float | None
    gravity: np.ndarray | None  # (3,) in the frame of the reference camera, before alignment
    b_g: np.ndarray | None
    td_s: float | None = None  # what the rotations say of the time offset; None where it is not estimated


@dataclass(frozen=True)
class HandEyeReport:
    """One attempt to find the rotation between camera and IMU (REFERENCE N14); None where nothing is solved yet."""

    n_pairs: int  # of frames
    q_b_c: np.ndarray | None  # (4,) wxyz
    sigma_deg: np.ndarray | None  # (3,) standard deviations about the axes of the camera
    singular_values: np.ndarray  # (4,) of the stacked quaternions, descending
    b_g: np.ndarray | None  # (3,) rad/s, found with it
    td_s: float | None  # likewise, beside the one of the calibration
    gates: tuple[Gate, ...]
    accepted: bool  # every deciding gate has passed
    found: bool  # in this attempt or in an earlier one: initialisation may use it


@dataclass(frozen=True)
class IterationReport:
    cost: float
    accepted: bool
    step_norm: float
    gain_ratio: float
    damping: float  # trust-region radius
    leg: str = ""  # of the dogleg path on which the step ended: "gauss-newton", "dogleg" or "gradient"


@dataclass(frozen=True)
class CostSplit:
    """Robust costs 1/2 sum rho(|r|^2) per factor type."""

    visual: float = 0.0
    imu: float = 0.0
    prior: float = 0.0
    depth: float = 0.0

    @property
    def total(self) -> float:
        return self.visual + self.imu + self.prior + self.depth


@dataclass(frozen=True)
class SolveReport:
    """One window solve: what went in, how it converged, what each factor says afterwards."""

    before: CostSplit
    after: CostSplit
    iterations: tuple[IterationReport, ...]
    termination: str
    n_landmarks: int
    # one row per projection factor
    visual_ids: np.ndarray  # (N,) int64 track id
    visual_slots: np.ndarray  # (N, 2) uint8: anchor slot, observing slot
    visual_error_px: np.ndarray  # (N,) float32, unweighted norm in px460, after the solve
    # one row per IMU factor (slot k to k + 1)
    imu_sigma: np.ndarray  # (n - 1, 5) norm of the whitened residual of p, q, v, ba, bg
    visual_camera: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint8))
    """(N,) uint8, which camera saw each projection; empty when camera 0 saw all.  Rows of camera 1 in the frame of the
    anchor have the same slot twice."""


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


class LoopOutcome(StrEnum):
    """How far a keyframe, or a pair of keyframes, came: the funnel in order (REFERENCE 16)."""

    LEFT_OUT = "left out"  # at the start, or by thinning
    TOO_RECENT = "nothing earlier"
    FEW_LANDMARKS = "too few landmarks"
    NOT_DISTINCTIVE = "not distinctive"
    NOT_SIMILAR = "not similar"
    NOT_CHOSEN = "others were preferred"
    FEW_MATCHES = "too few matches"
    EPIPOLAR = "epipolar geometry"
    PNP = "pose"
    UNCERTAIN = "pose uncertain"
    TILT = "gravity"
    HEADING = "heading"
    DISTANCE = "distance"
    INCONSISTENT = "odometry"
    UNCONFIRMED = "waiting for others to agree"
    ACCEPTED = "accepted"


LOOP_OUTCOMES = tuple(LoopOutcome)


class MatchStage(StrEnum):
    """What became of a landmark on its way to a loop: what dropped its match, or that it supports the pose."""

    FAR = "descriptor"
    AMBIGUOUS = "ratio"
    ONE_SIDED = "cross check"
    EPIPOLAR = "epipolar"
    PNP = "pose"
    INLIER = "inlier"
    GUIDED = "found by the pose"  # an inlier that was searched for where the pose sees it
    MATCHED = "matched"  # and not looked at further


MATCH_STAGES = tuple(MatchStage)
"""`LoopMatches.stage` holds indices into this tuple."""


@dataclass(frozen=True)
class LoopMatches:
    """One row per landmark of the later keyframe: the most similar point of the earlier one, and its fate."""

    row: np.ndarray  # (n,) int32 of the earlier keyframe's points
    hamming: np.ndarray  # (n,) uint16 bits that differ
    ratio: np.ndarray  # (n,) float32 over the bits of the best match elsewhere; NaN when found by the pose
    stage: np.ndarray  # (n,) uint8, index into MATCH_STAGES
    error_px: np.ndarray  # (n,) float32 reprojection error at the final pose, px460; NaN without pose


@dataclass(frozen=True)
class LoopCandidate:
    """A pair of keyframes that may show the same place: every gate it met, and what is known of their pose."""

    query: int  # the later keyframe, counted over the session
    match: int  # the earlier one
    score: float
    gates: tuple[Gate, ...]
    outcome: LoopOutcome
    matches: LoopMatches | None = None
    T_match_query: np.ndarray | None = None  # (7,) p and q wxyz: the later body in the earlier one
    covariance: np.ndarray | None = None  # (6, 6) of it, tangent (dp, dtheta): p + dp, q * Exp(dtheta)
    T_predicted: np.ndarray | None = None  # (7,) the same by odometry and earlier loops; None where nothing joins them
    predicted_covariance: np.ndarray | None = None  # (6, 6) of it as claimed, before `loop.drift_inflation`

    @property
    def accepted(self) -> bool:
        return self.outcome is LoopOutcome.ACCEPTED


@dataclass(frozen=True)
class LoopReport:
    """What the loop stage made of one keyframe."""

    keyframe: int  # counted over the session
    frame: int
    t_ns: int
    n_landmarks: int
    n_points: int
    neighbour_score: float | None  # with the previous keyframe
    gates: tuple[Gate, ...]  # about this keyframe alone
    candidates: tuple[LoopCandidate, ...]  # in the order of verification
    outcome: LoopOutcome  # the furthest that it came
    T_w_b: np.ndarray | None = None  # (7,) p and q wxyz of the body in the odometry's world
    odometry: np.ndarray | None = None  # (6, 6) as in LoopKeyframe

    @property
    def accepted(self) -> LoopCandidate | None:
        return next((c for c in self.candidates if c.accepted), None)


@dataclass(frozen=True)
class RelocalizationReport:
    """An earlier keyframe as one window solve placed it (REFERENCE 12), and whether that may become an edge.

    One row per landmark of the request that took part in the solve; errors in px460.
    """

    query: int  # the later keyframe, counted over the session
    match: int  # the earlier one
    frame: int  # frame number of the later keyframe
    ids: np.ndarray  # (n,) int64 track ids
    error_px: np.ndarray  # (2, n) float32, before and after the solve
    T_w_match: np.ndarray  # (7,) p and q wxyz: the earlier body, refined, in the odometry's world
    T_match_query: np.ndarray  # (7,) the later body in the earlier one, both refined
    covariance: np.ndarray | None  # (6, 6) of T_match_query, tangent (dp, dtheta): p + dp, q * Exp(dtheta)
    gates: tuple[Gate, ...] = ()  # of loop/relocalize.py
    drift: np.ndarray | None = None  # (7,) T_g_w, what moves the odometry's world to the graph's; None until known

    @property
    def n_factors(self) -> int:
        return len(self.ids)

    @property
    def error_px_before(self) -> float:
        """rms, NaN without factors."""
        return _rms(self.error_px[0])

    @property
    def error_px_after(self) -> float:
        return _rms(self.error_px[1])

    @property
    def accepted(self) -> bool:
        """It has been judged, and passed every gate."""
        return bool(self.gates) and all_pass(self.gates)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values.astype(float))))) if len(values) else float("nan")


@dataclass(frozen=True)
class GraphCost:
    """Robust costs 1/2 sum rho(|r|^2) per kind of edge."""

    sequential: float = 0.0
    loop: float = 0.0

    @property
    def total(self) -> float:
        return self.sequential + self.loop


@dataclass(frozen=True)
class PoseGraphReport:
    """One optimisation of the pose graph (SPEC 7.3): what moved, how it converged, what each loop says.

    Columns 0 and 1 of the loop arrays are before and after.  Keyframes are counted from 0 over all sessions.
    """

    dof: int  # 4 or 6
    n_keyframes: int
    n_free: int  # keyframes that could move
    first_free: int  # the earliest of them, -1 if none
    n_sequential: int  # odometry edges at free keyframes
    loops: np.ndarray  # (l, 2) int64: earlier and later keyframe
    forced: np.ndarray  # (l,) bool: counted without robust loss because the user asked for it
    loop_error_m: np.ndarray  # (l, 2) distance between measured and estimated relative position
    loop_error_deg: np.ndarray  # (l, 2) same of the rotation; about gravity with 4 DoF
    loop_weight: np.ndarray  # (l, 2) rho': 1 = counts in full, 0 = ignored
    before: GraphCost
    after: GraphCost
    iterations: tuple[IterationReport, ...]
    termination: str
    session: int  # of the newest keyframe
    drift: np.ndarray  # (7,) T_graph_odometry of that session after the optimisation: (p, q wxyz)


@dataclass(frozen=True)
class KeyframeEntry:
    """A keyframe as it entered the pose graph."""

    number: int  # counted over all sessions
    session: int
    frame: int
    t_ns: int
    T_vio: np.ndarray  # (7,) p and q wxyz of the body in the odometry's world


@dataclass(frozen=True)
class LoopEdge:
    """An accepted loop as it entered the pose graph, once its keyframe had left the window."""

    earlier: int
    later: int
    T_i_j: np.ndarray  # (7,) the later body in the earlier one
    refined: bool  # by the window; else as PnP left it


@dataclass(frozen=True)
class ClosureReport:
    """What loop closing made of one frame (SPEC 7)."""

    keyframe: KeyframeEntry | None  # that this frame made
    loop: LoopReport | None  # of a keyframe that this frame made, used or left out
    edges: tuple[LoopEdge, ...]  # that entered the graph in this frame, before its keyframe
    graph: PoseGraphReport | None  # of an optimisation whose result is used from this frame on
    drift: np.ndarray  # (7,) T_g_o of this session by the graph: accurate, late (seed 000.3.3.5)
    fast_drift: np.ndarray  # (7,) the same by the newest loop: at once


class FixVerdict(StrEnum):
    """What became of a GPS fix.  Only `USED` ones pull at the trajectory."""

    USED = "used"
    GATED = "gated"
    OPEN = "kept for the alignment"


class GpsStatus(StrEnum):
    """What the GPS fusion is doing after a frame."""

    WAITING = "waiting for a fix"
    ALIGNING = "aligning"
    FUSING = "fusing"


@dataclass(frozen=True)
class FixReport:
    """One GPS fix as it was judged when it came (SPEC 8.2).  The antenna, not the body, is at `z_e`."""

    t_ns: int
    verdict: FixVerdict
    gates: tuple[Gate, ...]  # status, position, standard deviation, age, gap between frames, chi-square
    z_e: np.ndarray | None  # (3,) m, east, north, up; None without an origin or a finite position
    covariance: np.ndarray | None  # (3, 3) as it is weighted
    innovation_m: np.ndarray | None  # (3,) fix minus prediction; None before the alignment
    innovation_covariance: np.ndarray | None  # (3, 3)


@dataclass(frozen=True)
class FixRevision:
    """A fix whose verdict changed, because later ones agree or disagree with it."""

    t_ns: int
    verdict: FixVerdict


@dataclass(frozen=True)
class GpsReport:
    """What GPS fusion made of one frame.  `e` is east-north-up at the origin, `o` the odometry's world."""

    status: GpsStatus
    fixes: tuple[FixReport, ...]  # judged in this frame
    revised: tuple[FixRevision, ...]
    gates: tuple[Gate, ...]  # of the alignment, and how long the outage lasts (advisory)
    outcome: str  # "" or one sentence: why fixes do not count yet, or that the alignment was lost
    origin: np.ndarray | None  # (3,) latitude, longitude in degrees, altitude in metres
    T_e_o: np.ndarray | None  # (7,) drift correction of the newest frame; None before the alignment
    T_e_b: np.ndarray | None  # (7,) newest frame
    covariance: np.ndarray | None  # (6, 6) of p_e_b in m and of R_e_o, turned on the side of o, in rad
    yaw_deg: float | None  # of T_e_o; also while aligning
    yaw_sigma_deg: float | None
    scale: float | None  # by how much the odometry is too short, as a share
    scale_sigma: float | None
    n_window: int  # moments with fixes that are still open
    iterations: int  # of the last solve; 0 without one
    arrived: tuple[GpsFix, ...] = ()  # what came with the frame, judged in it or, when it is ahead, in a later one


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


@dataclass(frozen=True)
class FrameReport:
    """All the estimator knew at one frame."""

    frame: int
    t_ns: int
    images: tuple[ImageRef, ...]  # every image tracked for this frame, as in its packet
    n_imu: int
    status: Status
    anomalies: tuple[Anomaly, ...]
    tracks: TrackReport
    keyframe: KeyframeReport | None = None
    initialization: InitReport | None = None
    solve: SolveReport | None = None
    window: WindowReport | None = None
    landmarks: LandmarkReport | None = None
    marginalization: MarginalizationReport | None = None
    health: HealthReport | None = None
    pose: PoseEstimate | None = None
    relocalizations: tuple[RelocalizationReport, ...] = ()  # earlier keyframes that the window saw again
    closure: ClosureReport | None = None  # None before the first keyframe, and where loops are not closed
    gps: GpsReport | None = None  # None before the first pose, and where no fixes are fused
    hand_eye: HandEyeReport | None = None  # while initialising with unknown extrinsics
    calibration: CalibrationReport | None = None  # None where nothing of it is estimated
    depth: DepthReport | None = None  # None without a depth camera, and before the window is solved

    @property
    def image(self) -> ImageRef:
        """The frame itself: the newest image of camera 0."""
        return next(ref for ref in reversed(self.images) if ref.camera == 0)

    @property
    def second_image(self) -> ImageRef | None:
        """What a second camera took with it."""
        return self.images[-1] if self.images[-1].camera == 1 else None


Timings = dict[str, float]
"""Milliseconds per stage of one frame: decode, track, depth, preintegrate, initialize, solve, marginalize, slide,
describe, loop, graph, gps, record."""


@dataclass(frozen=True)
class ClosureSummary:
    """What a frame added to the pose graph, and what loop closing said."""

    keyframe: KeyframeEntry | None
    outcome: LoopOutcome | None  # of a keyframe that this frame made
    match: int  # the keyframe that it closes a loop with, -1 for none
    edges: tuple[LoopEdge, ...]
    optimized: bool
    drift: np.ndarray  # (7,) by the graph
    fast_drift: np.ndarray | None = None  # (7,) by the newest loop
    n_candidates: int = 0  # earlier keyframes that were looked at


@dataclass(frozen=True)
class FixSummary:
    """A fix as it was judged when it came."""

    t_ns: int
    verdict: FixVerdict
    failed: tuple[str, ...]  # names of the gates that it did not pass
    z_e: np.ndarray | None  # (3,)
    covariance: np.ndarray | None  # (3, 3)


@dataclass(frozen=True)
class GpsSummary:
    """What a frame said of GPS: enough to draw the whole run, and to smooth it (fusion/conclusion.py)."""

    status: GpsStatus
    arrived: tuple[GpsFix, ...]
    fixes: tuple[FixSummary, ...]
    revised: tuple[FixRevision, ...]
    origin: np.ndarray | None  # (3,)
    T_e_b: np.ndarray | None  # (7,)
    T_e_o: np.ndarray | None  # (7,)
    yaw_deg: float | None
    yaw_sigma_deg: float | None
    outage_s: float | None  # since the last fix that counted; None before the first


@dataclass(frozen=True)
class HandEyeSummary:
    """How the rotation between camera and IMU converges."""

    n_pairs: int
    q_b_c: np.ndarray | None  # (4,) wxyz
    sigma_deg: np.ndarray | None  # (3,)
    singular_value: float  # the second smallest
    found: bool


@dataclass(frozen=True)
class FrameSummary:
    """One row per frame for timelines and tables over a whole run, kept small so that opening a run is fast."""

    frame: int
    t_ns: int
    status: Status
    is_keyframe: bool | None  # decision about the second newest frame; None while the window fills
    n_tracks: int
    n_new: int
    n_lost: int
    parallax_px: float | None
    before: CostSplit | None
    after: CostSplit | None
    n_iterations: int
    n_landmarks: int
    marginalized: str
    initialization: str | None  # None: not attempted; "": succeeded; else why it failed
    health: str  # "" or why the estimator restarted
    failed_gates: tuple[str, ...]  # names of deciding gates of initialisation and health that failed
    n_anomalies: int
    pose: PoseEstimate | None
    ms: Timings
    degeneracy: str = ""  # "" or which motion the window is missing
    yaw_information: float | None = None  # what the prior made in this frame claims to know of yaw, 1/rad^2
    closure: ClosureSummary | None = None
    gps: GpsSummary | None = None
    hand_eye: HandEyeSummary | None = None
    calibration: CalibrationReport | None = None

    @property
    def t_imu_ns(self) -> int:
        """When its pose was, on the IMU's clock: the stamp of the image where there is no pose."""
        return self.t_ns + (round(self.pose.late_s * 1e9) if self.pose else 0)


def summarize(report: FrameReport, ms: Timings) -> FrameSummary:
    tracks, solve, init, margin = report.tracks, report.solve, report.initialization, report.marginalization
    failed = [g.name for s in init.stages for g in s.gates if g.decides and not g.passed] if init else []
    failed += [g.name for g in report.health.gates if g.decides and not g.passed] if report.health else []
    why = next((s.outcome for s in init.stages if not s.passed), "") if init else None
    return FrameSummary(
        frame=report.frame,
        t_ns=report.t_ns,
        status=report.status,
        is_keyframe=report.keyframe.is_keyframe if report.keyframe else None,
        n_tracks=len(tracks.ids),
        n_new=tracks.n_new,
        n_lost=len(tracks.lost_ids),
        parallax_px=report.keyframe.parallax_px if report.keyframe else None,
        before=solve.before if solve else None,
        after=solve.after if solve else None,
        n_iterations=len(solve.iterations) if solve else 0,
        n_landmarks=solve.n_landmarks if solve else 0,
        marginalized=margin.kind if margin else "none",
        initialization=why,
        health=report.health.outcome if report.health else "",
        failed_gates=tuple(failed),
        n_anomalies=len(report.anomalies),
        pose=report.pose,
        ms=ms,
        degeneracy=report.health.degeneracy if report.health else "",
        yaw_information=float(margin.gauge_information[3]) if margin and margin.kind != "none" else None,
        closure=_summarize_closure(report.closure) if report.closure else None,
        gps=_summarize_gps(report.gps) if report.gps else None,
        hand_eye=_summarize_hand_eye(report.hand_eye) if report.hand_eye else None,
        calibration=report.calibration,
    )


def _summarize_gps(report: GpsReport) -> GpsSummary:
    return GpsSummary(
        status=report.status,
        arrived=report.arrived,
        fixes=tuple(
            FixSummary(f.t_ns, f.verdict, tuple(g.name for g in f.gates if not g.passed), f.z_e, f.covariance)
            for f in report.fixes
        ),
        revised=report.revised,
        origin=report.origin,
        T_e_b=report.T_e_b,
        T_e_o=report.T_e_o,
        yaw_deg=report.yaw_deg,
        yaw_sigma_deg=report.yaw_sigma_deg,
        outage_s=next((g.value for g in report.gates if g.name == "outage_s"), None),
    )


def _summarize_hand_eye(report: HandEyeReport) -> HandEyeSummary:
    smallest = float(report.singular_values[2])
    return HandEyeSummary(report.n_pairs, report.q_b_c, report.sigma_deg, smallest, report.found)


def _summarize_closure(report: ClosureReport) -> ClosureSummary:
    loop = report.loop
    return ClosureSummary(
        keyframe=report.keyframe,
        outcome=loop.outcome if loop else None,
        match=loop.accepted.match if loop and loop.accepted else -1,
        edges=report.edges,
        optimized=report.graph is not None,
        drift=report.drift,
        fast_drift=report.fast_drift,
        n_candidates=len(loop.candidates) if loop else 0,
    )
