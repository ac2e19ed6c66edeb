"""Parameters of pre-integration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from .declaration import Doc, Range


@dataclass(frozen=True)
class Imu:
    """Pre-integration (REFERENCE 6)."""

    acc_n_scale: Annotated[float, Range(0.01, 100), Doc("factor on the calibrated accelerometer noise")] = 1.0
    gyr_n_scale: Annotated[float, Range(0.01, 100), Doc("factor on the calibrated gyroscope noise")] = 1.0
    acc_w_scale: Annotated[float, Range(0.01, 100), Doc("factor on the calibrated accelerometer bias random walk")] = (
        1.0
    )
    gyr_w_scale: Annotated[float, Range(0.01, 100), Doc("factor on the calibrated gyroscope bias random walk")] = 1.0
    repropagate: Annotated[
        bool, Doc("integrate again when the bias has moved further than the limits (parity: off)")
    ] = True
    repropagate_ba: Annotated[float, Range(0.001, 1), Doc("accelerometer bias change that triggers it", "m/s^2")] = 0.1
    repropagate_bg: Annotated[float, Range(0.0001, 0.1), Doc("gyroscope bias change that triggers it", "rad/s")] = 0.01
    gap_s: Annotated[
        float, Range(0.005, 10), Doc("between samples further apart the motion counts as unknown (parity: 10)", "s")
    ] = 0.05
    gap_acc: Annotated[float, Range(0, 50), Doc("deviation of the mean acceleration over such a gap", "m/s^2")] = 2.0
    gap_gyr: Annotated[float, Range(0, 10), Doc("deviation of the mean angular rate over such a gap", "rad/s")] = 0.5
    max_interval_s: Annotated[float, Range(1, 60), Doc("IMU factors over longer intervals are left out", "s")] = 10.0
