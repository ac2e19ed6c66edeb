import numpy as np
import pytest
from factor_laws import assert_jacobian_matches_differences, random_pose, residual, retract

from vins_core.factors.reprojection import FACTORS, measurement, tangent_basis
from vins_core.geometry import so3

FORMS = tuple(FACTORS)
SIGMA = 1.5 / 460


def scene(seed: int, form: str, behind: bool = False) -> tuple[list[np.ndarray], np.ndarray, np.ndarray, np.ndarray]:
    """Two poses, an extrinsic and a landmark in front of camera i and in front of (or behind) camera j."""
    rng = np.random.default_rng(seed)
    extrinsic = random_pose(rng, 0.1)
    pose_i = random_pose(rng)
    pose_j = retract(FACTORS[form].blocks[0], pose_i, np.append(rng.normal(0, 0.2, 3), rng.normal(0, 0.15, 3)))
    if behind:
        pose_j[3:] = so3.multiply(pose_j[3:], so3.multiply(extrinsic[3:], so3.multiply(
            so3.exp(np.array([0.0, 2.4, 0.0])), so3.inverse(extrinsic[3:]))))  # fmt: skip
    inv_depth = rng.uniform(0.1, 0.6)
    ray_i = np.array([*rng.uniform(-0.5, 0.5, 2), 1.0])
    point = in_camera_j([pose_i, pose_j, extrinsic, np.array([inv_depth])], ray_i)
    ray_j = point / np.linalg.norm(point) + rng.normal(0, 2e-3, 3)
    return (
        [pose_i, pose_j, extrinsic, np.array([inv_depth])],
        ray_i / np.linalg.norm(ray_i),
        ray_j / np.linalg.norm(ray_j),
        point,
    )


def in_camera_j(values: list[np.ndarray], ray_i: np.ndarray) -> np.ndarray:
    pose_i, pose_j, extrinsic, inv_depth = values
    R_i, R_j, R_c = (so3.to_matrix(x[3:]) for x in (pose_i, pose_j, extrinsic))
    body_i = R_c @ (ray_i / ray_i[2] / inv_depth[0]) + extrinsic[:3]
    body_j = R_j.T @ (R_i @ body_i + pose_i[:3] - pose_j[:3])
    return R_c.T @ (body_j - extrinsic[:3])


def analytic_jacobian(values: list[np.ndarray], reduce: np.ndarray, ray_i: np.ndarray) -> np.ndarray:
    """The chain rule by hand (seed 000.3.3.3): d r / d p_c = `reduce`, then p_c by each block, q = q0 * Exp(theta)."""
    pose_i, pose_j, extrinsic, inv_depth = values
    R_i, R_j, R_c = (so3.to_matrix(x[3:]) for x in (pose_i, pose_j, extrinsic))
    point_i = ray_i / ray_i[2] / inv_depth[0]
    body_i = R_c @ point_i + extrinsic[:3]
    body_j = R_j.T @ (R_i @ body_i + pose_i[:3] - pose_j[:3])
    to_c = R_c.T @ R_j.T
    R_ji = R_j.T @ R_i
    d_point = [
        to_c,
        -to_c @ R_i @ so3.skew(body_i),
        -to_c,
        R_c.T @ so3.skew(body_j),
        R_c.T @ (R_ji - np.eye(3)),
        so3.skew(R_c.T @ (body_j - extrinsic[:3])) - R_c.T @ R_ji @ R_c @ so3.skew(point_i),
        (-to_c @ R_i @ R_c @ point_i / inv_depth[0])[:, None],
    ]
    return reduce @ np.concatenate(d_point, 1)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("seed", range(5))
def test_jacobian_matches_differences(form, seed):
    values, ray_i, ray_j, _ = scene(seed, form)
    data = measurement(form, ray_i[None], ray_j[None], 1 / SIGMA)[:, 0]
    assert_jacobian_matches_differences(FACTORS[form], values, data)


@pytest.mark.parametrize("seed", range(5))
def test_ad_equals_the_analytic_jacobian_on_the_plane(seed):
    values, ray_i, ray_j, p = scene(seed, "plane")
    data = measurement("plane", ray_i[None], ray_j[None], 1 / SIGMA)[:, 0]
    reduce = np.array([[1, 0, -p[0] / p[2]], [0, 1, -p[1] / p[2]]]) / p[2] / SIGMA
    system = np.array(FACTORS["plane"].function(("pose_i", "pose_j", "extrinsic", "inv_depth"))(*values, data))
    np.testing.assert_allclose(system[:, :-1], analytic_jacobian(values, reduce, ray_i), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(system[:, -1], (p[:2] / p[2] - ray_j[:2] / ray_j[2]) / SIGMA, atol=1e-9)


@pytest.mark.parametrize("behind", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_ad_equals_the_analytic_jacobian_on_the_sphere(seed, behind):
    values, ray_i, ray_j, p = scene(seed, "sphere", behind)
    data = measurement("sphere", ray_i[None], ray_j[None], 1 / SIGMA)[:, 0]
    norm = np.linalg.norm(p)
    basis = tangent_basis(ray_j[None])[0]
    reduce = basis @ (np.eye(3) / norm - np.outer(p, p) / norm**3) / SIGMA
    system = np.array(FACTORS["sphere"].function(("pose_i", "pose_j", "extrinsic", "inv_depth"))(*values, data))
    np.testing.assert_allclose(system[:, :-1], analytic_jacobian(values, reduce, ray_i), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(system[:, -1], basis @ (p / norm - ray_j) / SIGMA, atol=1e-9)


@pytest.mark.parametrize("form", FORMS)
def test_residual_is_zero_where_the_landmark_is_seen_exactly(form):
    values, ray_i, _, point = scene(3, form)
    data = measurement(form, ray_i[None], point[None] / np.linalg.norm(point), 1 / SIGMA)[:, 0]
    np.testing.assert_allclose(residual(FACTORS[form], values, data), 0, atol=1e-9)


def test_both_forms_agree_to_first_order_on_the_optical_axis():
    values, ray_i, _, point = scene(4, "plane")
    extrinsic = values[2]
    turn = so3.from_two_vectors(point, np.array([0.0, 0.0, 1.0]))  # turn camera j towards the landmark
    pose_j = values[1].copy()
    q_c = so3.multiply(so3.multiply(pose_j[3:], extrinsic[3:]), so3.inverse(turn))
    origin = pose_j[:3] + so3.rotate(pose_j[3:], extrinsic[:3])
    pose_j[3:] = so3.multiply(q_c, so3.inverse(extrinsic[3:]))
    pose_j[:3] = origin - so3.rotate(pose_j[3:], extrinsic[:3])
    values[1] = pose_j
    ray_j = np.array([2e-3, -1e-3, 1.0]) / np.linalg.norm([2e-3, -1e-3, 1.0])
    norms = [
        np.linalg.norm(residual(FACTORS[f], values, measurement(f, ray_i[None], ray_j[None], 1 / SIGMA)[:, 0]))
        for f in FORMS
    ]
    assert norms[0] == pytest.approx(norms[1], rel=1e-4)
    assert norms[0] == pytest.approx(np.hypot(2e-3, 1e-3) / SIGMA, rel=1e-3)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("inv_depth", [0.0, -1e-9, -0.02])
def test_at_and_beyond_infinity_everything_stays_finite(form, inv_depth):
    values, ray_i, ray_j, _ = scene(1, form)
    values[3] = np.array([inv_depth])
    data = measurement(form, ray_i[None], ray_j[None], 1 / SIGMA)[:, 0]
    assert np.isfinite(np.array(FACTORS[form].function(("pose_i", "inv_depth"))(*values, data))).all()


@pytest.mark.parametrize("form", FORMS)
def test_residual_is_continuous_through_infinity(form):
    values, ray_i, ray_j, _ = scene(2, form)
    data = measurement(form, ray_i[None], ray_j[None], 1 / SIGMA)[:, 0]
    near, far = (residual(FACTORS[form], [*values[:3], np.array([x])], data) for x in (1e-8, -1e-8))
    np.testing.assert_allclose(near, far, atol=1e-4)


@pytest.mark.parametrize("form", FORMS)
def test_uniform_and_inactive_blocks_change_nothing_but_the_cost(form):
    scenes = [scene(seed, form) for seed in range(7)]
    data = measurement(form, *(np.array([s[k] for s in scenes]) for k in (1, 2)), 1 / SIGMA)
    extrinsic = scenes[0][0][2]
    active = ("pose_i", "pose_j", "inv_depth")
    batches = [
        FACTORS[form].batch(7, active, uniform=("extrinsic",)),
        FACTORS[form].batch(7, active),
        FACTORS[form].batch(7, active, backend="vm"),
        FACTORS[form].batch(7, ("pose_i", "pose_j", "extrinsic", "inv_depth")),
    ]
    systems = []
    for batch in batches:
        for k in (0, 1, 3):
            batch.inputs[k][:] = np.array([s[0][k] for s in scenes]).T
        batch.inputs[2][:] = extrinsic if batch.inputs[2].ndim == 1 else extrinsic[:, None]
        batch.data[:] = data
        batch.evaluate()
        systems.append(batch.system.copy())
    systems[3] = np.delete(systems[3], np.s_[12:18], 0)
    for system in systems[1:]:
        np.testing.assert_allclose(system, systems[0], rtol=1e-11, atol=1e-8)


def test_tangent_basis_is_orthonormal_everywhere():
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(200, 3))
    rays = np.concatenate([rays / np.linalg.norm(rays, axis=1, keepdims=True), np.eye(3), -np.eye(3)])
    frame = np.concatenate([tangent_basis(rays), rays[:, None]], 1)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frame.shape), atol=1e-12)
