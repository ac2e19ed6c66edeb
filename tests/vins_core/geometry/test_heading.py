import numpy as np
import pytest

from vins_core.geometry import heading, so3


@pytest.mark.parametrize("pitch_deg", [-90, -89.99, -70, 0, 45, 90])
def test_a_turn_about_gravity_is_found_whatever_the_attitude(pitch_deg):
    rng = np.random.default_rng(0)
    q = so3.multiply(so3.exp(np.array([0, np.deg2rad(pitch_deg), 0])), so3.exp(0.1 * rng.normal(size=3)))
    for angle in (-3.0, -0.5, 0.0, 0.2, 3.1):
        turned = so3.multiply(heading.about_gravity(angle), q)
        assert heading.difference(turned, q) == pytest.approx(angle, abs=1e-12)


def test_the_turn_is_that_of_the_nearest_rotation_about_gravity():
    rng = np.random.default_rng(1)
    q = so3.exp(rng.normal(size=(50, 3)))
    angles = np.linspace(-np.pi, np.pi, 20001)
    candidates = so3.to_matrix(heading.about_gravity(angles))
    for one in q:
        trace = np.einsum("kij,ij->k", candidates, so3.to_matrix(one))
        assert heading.wrap(heading.turn(one) - angles[trace.argmax()]) == pytest.approx(0, abs=1e-3)


def test_the_sign_of_a_quaternion_means_nothing():
    q = so3.exp(np.array([0.1, -0.2, 2.9]))
    assert heading.turn(-q) == pytest.approx(heading.turn(q), abs=1e-12)
