import numpy as np
import pytest

from vins_core.fusion.geodesy import EnuFrame
from vins_core.sensors import GpsFix

PLACES = [(0.0, 0.0, 0.0), (48.137, 11.575, 519.0), (-33.9, 151.2, 30.0), (78.2, 15.6, 10.0), (51.0, 179.9999, 0.0)]


@pytest.mark.parametrize("place", PLACES)
def test_there_and_back_again(place):
    frame = EnuFrame(*place)
    p = np.random.default_rng(0).normal(size=(20, 3)) * [2000.0, 2000.0, 100.0]
    np.testing.assert_allclose(frame.from_geodetic(*frame.to_geodetic(p)), p, atol=1e-6)


@pytest.mark.parametrize("place", PLACES)
def test_axes_point_east_north_and_up(place):
    frame, (lat, lon, alt) = EnuFrame(*place), place
    fix = GpsFix(0, lat, lon, alt, np.eye(3), 0)
    np.testing.assert_allclose(frame.position(fix), 0, atol=1e-8)
    small = 1e-5
    for k, moved in enumerate([(lat, lon + small, alt), (lat + small, lon, alt), (lat, lon, alt + 1.0)]):
        p = frame.from_geodetic(*moved)
        np.testing.assert_allclose(p / np.linalg.norm(p), np.eye(3)[k], atol=1e-5)


def test_a_degree_of_the_equator_is_as_long_as_wgs84_says():
    """pi / 180 of the semi-major axis, 6378137 m, seen as a chord."""
    p = EnuFrame(0.0, 0.0, 0.0).from_geodetic(0.0, 1.0, 0.0)
    assert np.linalg.norm(p) == pytest.approx(2 * 6378137.0 * np.sin(np.deg2rad(0.5)), abs=1e-3)
