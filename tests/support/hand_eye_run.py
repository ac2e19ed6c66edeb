"""A run without an estimator that does not know how its camera is mounted, and finds it before its first solve."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from itertools import pairwise

import numpy as np
import synthetic_flight as flight
from fake_run import FIRST_SOLVE, FakeRun, fake_run

from vins_core.initialization.hand_eye import HandEye, calibrate, stage
from vins_core.params import Params
from vins_core.report import HandEyeReport, InitReport, summarize

FIRST = 2
"""Frame with the first attempt; the one before the first solve has the last."""


@lru_cache(maxsize=1)
def attempts() -> tuple[HandEyeReport, ...]:
    """Of a lively flight, every so often, until the rotation is found."""
    frames = flight.fly(flight.lively(0), 0, pixel_sigma=0.3, imu_noise=True, n_window=56).history
    state, reports = HandEye(), []
    for a, b in pairwise(frames):
        state, report = calibrate(Params().init, state, a, b)
        reports.append(report)
    return tuple(reports[k] for k in np.linspace(4, len(reports) - 1, FIRST_SOLVE - FIRST + 1).astype(int))


@lru_cache(maxsize=2)
def hand_eye_run(given: bool = False) -> FakeRun:
    """`given`: whether the calibration has a rotation all the same."""
    run = fake_run(30)
    camera = run.header.calibration.cameras[0]
    T_b_c = camera.T_b_c if given else np.eye(4)
    calibration = dataclasses.replace(
        run.header.calibration, cameras=(dataclasses.replace(camera, T_b_c=T_b_c),), extrinsics="unknown"
    )
    reports = list(run.reports)
    for k, attempt in enumerate(attempts(), FIRST):
        said = stage(attempt)
        before = reports[k].initialization
        stages = (said, *before.stages) if said.passed and before else (said,)
        initialization = (
            dataclasses.replace(before, stages=stages)
            if before
            else InitReport(stages, False, -1, None, None, attempt.b_g)
        )
        reports[k] = dataclasses.replace(reports[k], hand_eye=attempt, initialization=initialization)
    summaries = [summarize(r, s.ms) for r, s in zip(reports, run.summaries)]
    header = dataclasses.replace(run.header, calibration=calibration)
    return dataclasses.replace(run, header=header, reports=reports, summaries=summaries)
