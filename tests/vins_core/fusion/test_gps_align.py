import numpy as np
import pytest

from vins_core.fusion.align import align
from vins_core.geometry import heading, so3


def scene(yaw: float, n: int = 40, noise_m: float = 0.0, outliers: int = 0, seed: int = 0, length_m: float = 80.0):
    rng = np.random.default_rng(seed)
    s = np.linspace(0, length_m, n)
    a = np.stack([s, 5 * np.sin(s / 20), 0 * s], 1)
    z = so3.rotate(heading.about_gravity(yaw), a) + [100.0, -50.0, 3.0] + noise_m * rng.normal(size=(n, 3))
    wrong = rng.choice(n, outliers, replace=False)
    z[wrong, :2] += rng.uniform(10, 200, (outliers, 1)) * [1.0, 0.3]
    return a, z, np.tile(max(noise_m, 0.1) ** 2 * np.eye(3), (n, 1, 1)), wrong


@pytest.mark.parametrize("yaw_deg", [-179.0, -90.0, 0.0, 45.0, 180.0])
def test_any_heading_is_found_without_a_guess(yaw_deg):
    a, z, R, _ = scene(np.deg2rad(yaw_deg))
    found = align(a, z, R)
    assert abs(heading.wrap(found.yaw_rad - np.deg2rad(yaw_deg))) < 1e-9
    np.testing.assert_allclose(found.shift_e, [100, -50], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_third_of_outliers_on_one_side_does_not_turn_it(seed):
    a, z, R, wrong = scene(0.5, noise_m=1.0, outliers=13, seed=seed)
    found = align(a, z, R)
    assert abs(found.yaw_rad - 0.5) < 4 * found.sigma_rad
    assert not found.inlier[wrong].any()


def test_sigma_is_the_spread_of_the_heading():
    found = [align(*scene(0.5, noise_m=1.0, seed=seed)[:3]) for seed in range(100)]
    spread = np.std([f.yaw_rad for f in found])
    assert 0.7 < spread / np.mean([f.sigma_rad for f in found]) < 1.3


def test_standing_still_gives_no_heading():
    _, z, R, _ = scene(0.5, noise_m=1.0)
    assert align(np.zeros_like(z), z, R) is None
    assert align(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))) is None
