"""Mid-point IMU pre-integration (SPEC 3.1, seed 004.10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..sensors import ImuNoise, ImuSamples


@dataclass(frozen=True)
class Preintegration:
    """Relative motion from the first to the last sample, in the body frame of the first.

    Error state order of `jacobian` and `covariance`: p, theta, v, b_a, b_g.
    """

    imu: ImuSamples  # the raw samples; the first is at the earlier frame, the last at the later one
    b_a: np.ndarray  # (3,) bias it was integrated with
    b_g: np.ndarray  # (3,)
    dt_s: float
    delta_p: np.ndarray  # (3,)
    delta_q: np.ndarray  # (4,) wxyz
    delta_v: np.ndarray  # (3,)
    jacobian: np.ndarray  # (15, 6): columns b_a, b_g
    covariance: np.ndarray  # (15, 15)


def preintegrate(imu: ImuSamples, b_a: np.ndarray, b_g: np.ndarray, noise: ImuNoise) -> Preintegration:
    raise NotImplementedError
