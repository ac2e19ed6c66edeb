"""Fixes, and what fusion made of them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ..sensors import GpsFix
from .gate import Gate


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
