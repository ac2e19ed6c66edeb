import numpy as np
import pytest
from factor_laws import assert_jacobian_matches_differences, random_pose, residual

from vins_core.factors.reprojection import KINDS, measurement
from vins_core.geometry import so3

SIGMA = 1.5 / 460
FORMS = ("plane", "sphere")


def near(rng: np.random.Generator, pose: np.ndarray) -> np.ndarray:
    return np.concatenate([pose[:3] + rng.normal(0, 0.2, 3), so3.retract(pose[3:], rng.normal(0, 0.1, 3))])


def point_in_camera(kind: str, values: list[np.ndarray], ray: np.ndarray) -> np.ndarray:
    """By matrices, the chain of the module's docstring."""
    *poses, inv_depth = values
    extrinsic_i, extrinsic_j = poses[-2:] if kind != "mono" else (poses[2], poses[2])
    point = so3.to_matrix(extrinsic_i[3:]) @ (ray / ray[2] / inv_depth[0]) + extrinsic_i[:3]
    if kind != "same":
        pose_i, pose_j = poses[:2]
        point = so3.to_matrix(pose_i[3:]) @ point + pose_i[:3]
        point = so3.to_matrix(pose_j[3:]).T @ (point - pose_j[:3])
    return so3.to_matrix(extrinsic_j[3:]).T @ (point - extrinsic_j[:3])


def scene(kind: str, seed: int) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Values of the blocks, and unit rays of a landmark in both cameras: the second one exact."""
    rng = np.random.default_rng(seed)
    pose_i, extrinsic_i = random_pose(rng), random_pose(rng, 0.1)
    poses = {
        "mono": [pose_i, near(rng, pose_i), extrinsic_i],
        "cross": [pose_i, near(rng, pose_i), extrinsic_i, near(rng, extrinsic_i)],
        "same": [extrinsic_i, near(rng, extrinsic_i)],
    }[kind]
    values = [*poses, np.array([rng.uniform(0.1, 0.5)])]
    ray_i = np.array([*rng.uniform(-0.4, 0.4, 2), 1.0])
    point = point_in_camera(kind, values, ray_i)
    assert point[2] > 0.1
    return values, ray_i / np.linalg.norm(ray_i), point / np.linalg.norm(point)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["cross", "same"])
def test_jacobian_matches_differences(kind: str, form: str, seed: int) -> None:
    values, ray_i, ray_j = scene(kind, seed)
    off = ray_j + np.random.default_rng(seed).normal(0, 2e-3, 3)
    data = measurement(form, ray_i[None], (off / np.linalg.norm(off))[None], 1 / SIGMA)[:, 0]
    assert_jacobian_matches_differences(KINDS[kind][form], values, data)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", list(KINDS))
def test_residual_is_zero_where_the_landmark_is_seen_exactly(kind: str, form: str) -> None:
    values, ray_i, ray_j = scene(kind, 5)
    data = measurement(form, ray_i[None], ray_j[None], 1 / SIGMA)[:, 0]
    np.testing.assert_allclose(residual(KINDS[kind][form], values, data), 0, atol=1e-9)


@pytest.mark.parametrize("form", FORMS)
def test_two_cameras_of_one_mounting_are_one_and_one_frame_twice_is_one(form: str) -> None:
    (pose_i, pose_j, first, second, inv_depth), ray_i, ray_j = scene("cross", 6)
    data = measurement(form, ray_i[None], ray_j[None], 1 / SIGMA)[:, 0]
    cross, mono, same = (KINDS[kind][form] for kind in ("cross", "mono", "same"))
    np.testing.assert_allclose(
        residual(cross, [pose_i, pose_j, first, first, inv_depth], data),
        residual(mono, [pose_i, pose_j, first, inv_depth], data),
        atol=1e-9,
    )
    np.testing.assert_allclose(
        residual(cross, [pose_i, pose_i, first, second, inv_depth], data),
        residual(same, [first, second, inv_depth], data),
        atol=1e-9,
    )


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["cross", "same"])
def test_at_and_beyond_infinity_everything_stays_finite(kind: str, form: str) -> None:
    values, ray_i, ray_j = scene(kind, 7)
    data = measurement(form, ray_i[None], ray_j[None], 1 / SIGMA)[:, 0]
    for inv_depth in (0.0, -1e-9, -0.02):
        assert np.isfinite(
            np.array(KINDS[kind][form].function(("extrinsic_j", "inv_depth"))(*values[:-1], [inv_depth], data))
        ).all()
