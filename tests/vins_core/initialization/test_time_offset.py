"""The time offset from rotations alone."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import synthetic_window as sw

from vins_core.factors.preintegration import preintegrate
from vins_core.geometry import so3
from vins_core.initialization.time_offset import estimate
from vins_core.params import Online
from vins_core.sensors import ImuSamples


def flight(td_s: float, noise_deg: float, seed: int = 0):
    """Rotations that a camera sees `td_s` later than the pre-integrations are cut, of a gyroscope with a bias."""
    rng, t = np.random.default_rng(seed), 1.0 + 0.1 * np.arange(12)
    imu = []
    for a, b in pairwise(t):
        s = np.linspace(a, b, 21)
        gyro, accel = sw.imu_truth(s)
        gyro = gyro + sw.B_G + 1e-3 * rng.normal(size=gyro.shape)
        samples = ImuSamples(np.round(s * 1e9).astype(np.int64), gyro, accel)
        imu.append(preintegrate(samples, np.zeros(3), np.zeros(3), sw.NOISE))
    q = so3.retract(sw.attitude(t + td_s), np.radians(noise_deg) * rng.normal(size=(len(t), 3)))
    return so3.to_matrix(q), imu


@pytest.mark.parametrize("td_s", [-0.03, 0.0, 0.02])
def test_it_is_found_within_a_few_milliseconds_beside_the_bias(td_s: float) -> None:
    found, stage = estimate(Online(), 0.004, *flight(td_s - 0.004, 0.005))
    assert found == pytest.approx(td_s, abs=3e-3)
    assert stage.passed and stage.values["sigma_s"] < 3e-3
    assert stage.values["td_s"] == found


def test_rotations_that_tell_nothing_leave_what_is_given() -> None:
    """Noise of a degree a frame drowns the offset: the given one counts, with its standard deviation."""
    found, stage = estimate(Online(td_sigma_s=0.002), 0.004, *flight(0.02, 1.0))
    assert abs(found - 0.004) < 0.002
    assert stage.values["sigma_s"] <= 0.002
