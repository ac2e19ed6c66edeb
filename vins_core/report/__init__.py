"""How every stage explains itself: gates, outcomes, and the report of one frame; a file for each part of the system.

A `Gate` is one comparison that decided something.  A `FrameReport` holds all that the estimator knew at one
frame; it is what the record stores and what every panel of the interface draws.  Reports contain no times
measured on a clock (those are `Timings`, kept beside the report), so that equal runs give equal reports.
"""

from .frame import FrameReport, Status, Timings
from .gate import Gate, all_pass
from .gps import FixReport, FixRevision, FixVerdict, GpsReport, GpsStatus
from .initialization import HandEyeReport, InitReport, InitStage
from .loops import (
    LOOP_OUTCOMES,
    MATCH_STAGES,
    ClosureReport,
    GraphCost,
    KeyframeEntry,
    LoopCandidate,
    LoopEdge,
    LoopMatches,
    LoopOutcome,
    LoopReport,
    MatchStage,
    PoseGraphReport,
    RelocalizationReport,
)
from .solve import CostSplit, IterationReport, SolveReport
from .summary import ClosureSummary, FixSummary, FrameSummary, GpsSummary, HandEyeSummary, summarize
from .tracks import (
    DEPTH_LOSSES,
    DEPTH_USES,
    LOSS_REASONS,
    RIGHT_LOSSES,
    DepthLoss,
    DepthUse,
    LossReason,
    RightLoss,
    TrackReport,
)
from .window import (
    LANDMARK_STATUSES,
    BlockReport,
    CalibrationReport,
    DepthReport,
    HealthReport,
    KeyframeReport,
    LandmarkReport,
    LandmarkStatus,
    MarginalizationReport,
    PoseEstimate,
    WindowReport,
)

__all__ = [
    "DEPTH_LOSSES",
    "DEPTH_USES",
    "LANDMARK_STATUSES",
    "LOOP_OUTCOMES",
    "LOSS_REASONS",
    "MATCH_STAGES",
    "RIGHT_LOSSES",
    "BlockReport",
    "CalibrationReport",
    "ClosureReport",
    "ClosureSummary",
    "CostSplit",
    "DepthLoss",
    "DepthReport",
    "DepthUse",
    "FixReport",
    "FixRevision",
    "FixSummary",
    "FixVerdict",
    "FrameReport",
    "FrameSummary",
    "Gate",
    "GpsReport",
    "GpsStatus",
    "GpsSummary",
    "GraphCost",
    "HandEyeReport",
    "HandEyeSummary",
    "HealthReport",
    "InitReport",
    "InitStage",
    "IterationReport",
    "KeyframeEntry",
    "KeyframeReport",
    "LandmarkReport",
    "LandmarkStatus",
    "LoopCandidate",
    "LoopEdge",
    "LoopMatches",
    "LoopOutcome",
    "LoopReport",
    "LossReason",
    "MarginalizationReport",
    "MatchStage",
    "PoseEstimate",
    "PoseGraphReport",
    "RelocalizationReport",
    "RightLoss",
    "SolveReport",
    "Status",
    "Timings",
    "TrackReport",
    "WindowReport",
    "all_pass",
    "summarize",
]
