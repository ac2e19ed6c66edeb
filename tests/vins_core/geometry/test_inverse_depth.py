import numpy as np
import pytest

from vins_core.geometry import inverse_depth
from vins_core.geometry.inverse_depth import MIN_RAY_Z

ANGLES_DEG = [0.0, 30.0, 86.9, 87.3, 90.0, 95.0, 150.0, 180.0]


def ray(angle_deg: float) -> np.ndarray:
    a = np.radians(angle_deg)
    return np.array([[0.6 * np.sin(a), 0.8 * np.sin(a), np.cos(a)]])


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_a_point_lies_along_its_ray_at_its_depth_in_every_direction(angle_deg):
    f = ray(angle_deg)
    point = inverse_depth.point(f, np.array([0.25]))
    np.testing.assert_allclose(np.cross(point, f), 0, atol=1e-12)
    assert np.sum(point * f) > 0
    np.testing.assert_allclose(inverse_depth.depth(f, point), 4.0)
    np.testing.assert_allclose(inverse_depth.bearing(f) / 0.25, point)
    np.testing.assert_allclose(inverse_depth.depth(f, -point), -4.0)


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_it_is_the_depth_along_z_where_there_is_a_plane_and_the_distance_elsewhere(angle_deg):
    f = ray(angle_deg)
    point = inverse_depth.point(f, np.array([0.5]))[0]
    assert (point[2] if f[0, 2] > MIN_RAY_Z else np.linalg.norm(point)) == pytest.approx(2.0)
