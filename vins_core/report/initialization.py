"""An attempt to initialise."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .gate import Gate


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
