import cv2
import numpy as np
import pytest

from vins_core.frontend.reject import FOCAL_PX, epipolar_distance_px, epipolar_inliers
from vins_core.geometry import so3
from vins_core.params import Frontend

BOTH_MODELS = pytest.mark.parametrize("model", ["essential", "fundamental"])


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def pairs(n=120, t=(0.1, 0.02, 0.01), w=(0.01, 0.03, 0.0), noise_px=0.2, outliers=0, seed=0, cone_deg=45.0):
    """Unit rays of n points from two cameras, the last `outliers` of them moved far off."""
    rng = np.random.default_rng(seed)
    angle, turn = np.radians(rng.uniform(0, cone_deg, n)), rng.uniform(0, 2 * np.pi, n)
    rays = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
    points = rays * rng.uniform(2, 8, (n, 1))
    moved = so3.rotate(so3.exp(np.array(w, float)), points) + np.array(t)
    sigma = noise_px / FOCAL_PX
    a, b = unit(rays + rng.normal(0, sigma, (n, 3))), unit(unit(moved) + rng.normal(0, sigma, (n, 3)))
    if outliers:
        b[-outliers:] = unit(b[-outliers:] + rng.uniform(0.03, 0.1, (outliers, 3)) * rng.choice([-1, 1], (outliers, 3)))
    return a, b


def essential(t, w):
    return so3.skew(np.array(t)) @ so3.to_matrix(so3.exp(np.array(w)))


@BOTH_MODELS
@pytest.mark.parametrize("n", [30, 120])
def test_planted_outliers_go_and_the_rest_stays(model, n):
    a, b = pairs(n, outliers=n // 5)
    inlier = epipolar_inliers(a, b, Frontend(epipolar_model=model))
    good, bad = inlier[: -n // 5], inlier[-n // 5 :]
    assert good.mean() > (0.99 if model == "essential" else 0.8)
    assert bad.mean() < 0.2  # an outlier may slide along its epipolar line


@pytest.mark.parametrize(
    ("t", "w"),
    [((0, 0, 0), (0, 0, 0)), ((0, 0, 0), (0, 0.1, 0)), ((0, 0, -0.2), (0, 0, 0))],
    ids=["standing", "turning", "forwards"],
)
@pytest.mark.parametrize("noise_px", [0.0, 0.2])
@BOTH_MODELS
def test_motions_that_say_little_about_the_geometry_lose_no_track(t, w, noise_px, model):
    a, b = pairs(t=t, w=w, noise_px=noise_px)
    share = epipolar_inliers(a, b, Frontend(epipolar_model=model)).mean()
    assert share >= (0.99 if model == "essential" or noise_px == 0 else 0.85)


def test_what_moves_while_the_camera_stands_goes():
    a, b = pairs(t=(0, 0, 0), w=(0, 0, 0), noise_px=0.0, outliers=20)
    inlier = epipolar_inliers(a, b, Frontend())
    assert inlier[:-20].all() and inlier[-20:].mean() < 0.2


@BOTH_MODELS
def test_rays_beyond_90_degrees_are_tested_too(model):
    t, w = (0.3, 0.05, 0.1), (0.02, 0.03, 0.0)
    a, b = pairs(300, t=t, w=w, noise_px=0.05, cone_deg=100.0)
    wide = np.flatnonzero((a[:, 2] < 0.1) & (b[:, 2] < 0.1))
    assert (a[wide, 2] < 0).any() and len(wide) > 20
    E = essential(t, w)
    normals = unit(a[wide] @ E.T)
    broken = wide[::2]
    b[broken] = unit(b[broken] + 0.05 * normals[::2])  # 23 px460 off the epipolar plane
    inlier = epipolar_inliers(a, b, Frontend(epipolar_model=model))
    assert not inlier[broken].any()
    assert inlier[np.setdiff1d(wide, broken)].mean() > 0.8


def test_distance_is_the_angle_to_the_epipolar_plane_and_small_angles_are_pixels():
    t, w = (0.3, 0.05, 0.1), (0.02, 0.03, 0.0)
    a, b = pairs(t=t, w=w, noise_px=0.0)
    E = essential(t, w)
    np.testing.assert_allclose(epipolar_distance_px(E, a, b), 0.0, atol=1e-9)
    off = unit(b + 2.0 / FOCAL_PX * unit(a @ E.T))
    assert (epipolar_distance_px(E, a, off) >= 2.0 - 1e-3).all()
    np.testing.assert_allclose(epipolar_distance_px(-7.0 * E, a, off), epipolar_distance_px(E, a, off))
    np.testing.assert_allclose(epipolar_distance_px(E.T, off, a), epipolar_distance_px(E, a, off))


@pytest.mark.parametrize("n", [0, 1, 7])
def test_too_few_pairs_cannot_be_judged(n):
    a, b = pairs(n)
    assert epipolar_inliers(a, b, Frontend()) is None
    a, b = pairs(20)
    a[n:, 2] *= -1  # behind: not on the image plane
    assert epipolar_inliers(a, b, Frontend()) is None


@BOTH_MODELS
def test_the_verdict_is_repeatable_whatever_other_random_numbers_were_drawn(model):
    a, b = pairs(outliers=30)
    params = Frontend(epipolar_model=model)
    first = epipolar_inliers(a, b, params)
    cv2.setRNGSeed(12345)
    np.random.default_rng().normal(size=10)
    np.testing.assert_array_equal(epipolar_inliers(a, b, params), first)
