import numpy as np
import pytest

from vins_core.factors.prior import difference_poses, inverse_right_jacobian
from vins_core.geometry import so3


@pytest.mark.parametrize("angle", [0.0, 1e-6, 5e-3, 1.1e-2, 0.3, 2.0])
def test_jacobian_of_the_pose_difference_matches_differences(angle):
    rng = np.random.default_rng(1)
    axis = rng.normal(size=3)
    x0 = np.append(rng.normal(size=3), so3.exp(rng.normal(size=3)))
    phi = angle * axis / np.linalg.norm(axis)
    x = np.append(x0[:3] + 0.1, so3.retract(x0[3:], phi))
    h = 1e-6

    def moved(d):
        return difference_poses(np.append(x[:3], so3.retract(x[3:], d))[None], x0[None])[0, 3:]

    numeric = np.stack([(moved(h * e) - moved(-h * e)) / (2 * h) for e in np.eye(3)], 1)
    np.testing.assert_allclose(inverse_right_jacobian(phi[None])[0], numeric, atol=1e-8)


def test_difference_undoes_retraction():
    rng = np.random.default_rng(2)
    x0 = np.concatenate([rng.normal(size=(5, 3)), so3.exp(rng.normal(size=(5, 3)))], 1)
    d = rng.normal(0, 0.4, (5, 6))
    x = np.concatenate([x0[:, :3] + d[:, :3], so3.retract(x0[:, 3:], d[:, 3:])], 1)
    np.testing.assert_allclose(difference_poses(x, x0), d, atol=1e-12)
