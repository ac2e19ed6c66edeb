"""The same walk through lenses of every model: what an estimator makes of it may depend little on the lens."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from vins_core.evaluation.evaluate import evaluate, run_trajectory
from vins_core.io.own_yaml import write
from vins_core.io.write import write_recording
from vins_core.record.reader import RunReader
from vins_core.runner import run_recording
from vins_core.simulation.simulate import simulate

SEEDS = (1, 2, 3)
DURATION_S = 15.0

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def ates_m(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], list[float]]:
    @cache
    def of_all_seeds(scenario: str) -> list[float]:
        found = []
        for seed in SEEDS:
            folder = tmp_path_factory.mktemp(scenario)
            simulation = simulate(scenario, seed, DURATION_S)
            write_recording(simulation.messages(), folder / "recording", "asl", settings=simulation.settings)
            write(folder / "settings.yaml", simulation.calibration, simulation.settings.overrides)
            run_recording(
                folder / "recording",
                [folder / "settings.yaml"],
                out=folder / "run",
                settings=("loop.enabled=false",),
            )
            run = RunReader(folder / "run")
            ate = evaluate(run_trajectory(run.summaries), run.truth, 0.006).ate_rmse_m
            found.append(np.inf if ate is None else ate)
        return found

    return of_all_seeds


@pytest.mark.parametrize("scenario", ["kb190_camera", "mei_camera", "scaramuzza_camera", "rational_camera"])
def test_the_error_through_a_lens_is_at_most_one_and_a_half_times_that_of_the_pinhole(
    ates_m: Callable[[str], list[float]], scenario: str
) -> None:
    assert np.median(ates_m(scenario)) <= 1.5 * np.median(ates_m("room_loop"))
    assert max(ates_m(scenario)) < 0.03
