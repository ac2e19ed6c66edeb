"""A solve of the window."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


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
