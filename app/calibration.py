"""The calibration over a run that estimates it, as arrays: what it came to, how sure it is, when it was free."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vins_core.report import CalibrationReport, all_pass
from vins_core.window.online import moved

from .context import RunView


@dataclass(frozen=True)
class CalibrationSeries:
    """(n,) arrays over the frames of a run; NaN where nothing is estimated, sigmas also where it is held."""

    known: np.ndarray  # bool: some of it is estimated
    td_s: np.ndarray
    td_sigma_s: np.ndarray
    td_free: np.ndarray  # bool
    shift_m: np.ndarray  # (n, cameras, 3) from the given position, in body axes
    shift_sigma_m: np.ndarray
    turn_rad: np.ndarray  # (n, cameras, 3) from the given rotation, in camera axes
    turn_sigma_rad: np.ndarray
    extrinsics_free: np.ndarray  # bool

    @property
    def estimates_td(self) -> bool:
        return bool(np.isfinite(self.td_s).any())

    @property
    def estimates_extrinsics(self) -> bool:
        return bool(np.isfinite(self.shift_m).any())


def calibration_series(run: RunView) -> CalibrationSeries:
    """Of the frames read so far."""
    return _series(run, len(run))


@lru_cache(maxsize=4)
def _series(run: RunView, n: int) -> CalibrationSeries:
    given = [camera.T_b_c for camera in run.header.calibration.cameras]
    reports = [summary.calibration for summary in run.summaries[:n]]
    td, td_sigma = np.full(n, np.nan), np.full(n, np.nan)
    td_free, extrinsics_free = np.zeros(n, bool), np.zeros(n, bool)
    shift, shift_sigma, turn, turn_sigma = (np.full((n, len(given), 3), np.nan) for _ in range(4))
    for k, report in enumerate(reports):
        if report is None:
            continue
        if report.td_gates:
            td[k], td_sigma[k], td_free[k] = report.td_s, report.td_sigma_s, all_pass(report.td_gates)
        if report.extrinsic_gates:
            extrinsics_free[k] = all_pass(report.extrinsic_gates)
            for camera, T_b_c in enumerate(given):
                shift[k, camera], turn[k, camera] = moved(report.T_b_c[camera], T_b_c)
            shift_sigma[k], turn_sigma[k] = report.extrinsic_sigma[:, :3], report.extrinsic_sigma[:, 3:]
    known = np.array([report is not None for report in reports], bool)
    return CalibrationSeries(known, td, td_sigma, td_free, shift, shift_sigma, turn, turn_sigma, extrinsics_free)


def of_frame(run: RunView, frame: int) -> CalibrationReport | None:
    return run.summaries[frame].calibration
