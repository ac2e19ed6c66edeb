import dataclasses
import math

import cv2
import numpy as np
import pytest

from vins_core.errors import CalibrationError
from vins_core.geometry.camera import MODELS, camera_from_dict, camera_to_dict
from vins_core.geometry.kannala_brandt import KannalaBrandt
from vins_core.geometry.pinhole_radtan import PinholeRadtan

EUROC = PinholeRadtan(752, 480, 458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)
WIDE = PinholeRadtan(640, 480, 290.0, 291.0, 316.0, 243.0, -0.22, 0.045, -0.0011, 0.0008)
PINCUSHION = PinholeRadtan(640, 480, 500.0, 500.0, 320.0, 240.0, 0.12, 0.03, 0.0, 0.0)
FOLDING = PinholeRadtan(640, 480, 300.0, 300.0, 320.0, 240.0, -0.35, 0.05, 0.0005, -0.0005)  # folds inside the image
FISHEYE = KannalaBrandt(512, 512, 190.98, 190.97, 254.93, 256.9, 0.0034, 0.00077, -0.002, 0.0002)  # 195 degrees
STEEP = KannalaBrandt(640, 480, 380.0, 381.0, 322.0, 238.0, -0.05, 0.02, -0.03, 0.001)

CAMERAS = pytest.mark.parametrize(
    "camera",
    [EUROC, WIDE, PINCUSHION, FOLDING, FISHEYE, STEEP],
    ids=["euroc", "wide", "pincushion", "folding", "fisheye", "steep"],
)


def pixels(camera, step=8):
    """A grid over the whole image, corners and border included."""
    u, v = np.meshgrid(np.arange(0, camera.width + 1, step), np.arange(0, camera.height + 1, step))
    return np.stack([u.ravel(), v.ravel()], -1).astype(float)


@CAMERAS
def test_pixels_survive_lifting_and_projecting(camera):
    uv = pixels(camera)
    rays = camera.lift(uv)
    inside = np.isfinite(rays).all(1)
    assert inside.mean() > (0.46 if camera is FOLDING else 0.78)  # FOLDING reaches 216 px from the centre
    np.testing.assert_allclose(np.linalg.norm(rays[inside], axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(camera.project(rays[inside]), uv[inside], atol=1e-9)


@CAMERAS
def test_rays_of_the_field_of_view_survive_projecting_and_lifting(camera):
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(5000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    uv = camera.project(rays)
    with np.errstate(invalid="ignore"):
        seen = ((uv >= 0) & (uv <= [camera.width, camera.height])).all(1)
    assert seen.sum() > 200
    np.testing.assert_allclose(camera.lift(uv[seen]), rays[seen], atol=1e-9)


@CAMERAS
def test_the_image_of_a_point_does_not_depend_on_its_distance(camera):
    rays = camera.lift(pixels(camera, 40))
    rays = rays[np.isfinite(rays).all(1)]
    np.testing.assert_allclose(camera.project(7.3 * rays), camera.project(rays), atol=1e-9)


def test_every_pixel_of_an_ordinary_lens_has_a_ray():
    for camera in (EUROC, WIDE, PINCUSHION):
        assert np.isfinite(camera.lift(pixels(camera))).all()


def test_radtan_agrees_with_opencv():
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.8, 0.8, 500), rng.uniform(-0.55, 0.55, 500), np.ones(500)])
    points *= rng.uniform(0.5, 20, (500, 1))
    K = np.array([[EUROC.fx, 0, EUROC.cx], [0, EUROC.fy, EUROC.cy], [0, 0, 1.0]])
    D = np.array([EUROC.k1, EUROC.k2, EUROC.p1, EUROC.p2])
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, D)[0][:, 0]
    np.testing.assert_allclose(EUROC.project(points), expected, atol=1e-9)


def test_kannala_brandt_agrees_with_opencv_up_to_90_degrees():
    rng = np.random.default_rng(2)
    angle, turn = rng.uniform(0, math.radians(80), 500), rng.uniform(0, 2 * math.pi, 500)
    rays = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
    K = np.array([[FISHEYE.fx, 0, FISHEYE.cx], [0, FISHEYE.fy, FISHEYE.cy], [0, 0, 1.0]])
    D = np.array([FISHEYE.k1, FISHEYE.k2, FISHEYE.k3, FISHEYE.k4])
    expected = cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), K, D)[0][:, 0]
    np.testing.assert_allclose(FISHEYE.project(rays), expected, atol=1e-9)


def test_the_optical_axis_hits_the_principal_point():
    for camera in (EUROC, FISHEYE):
        axis, centre = np.array([[0.0, 0.0, 1.0]]), np.array([[camera.cx, camera.cy]])
        np.testing.assert_array_equal(camera.project(axis), centre)
        np.testing.assert_array_equal(camera.lift(centre), axis)


def test_a_fisheye_sees_behind_90_degrees_and_a_pinhole_does_not():
    angle = math.radians(96)
    ray = np.array([[math.sin(angle), 0.0, math.cos(angle)]])
    assert np.isfinite(FISHEYE.project(ray)).all()
    np.testing.assert_allclose(FISHEYE.lift(FISHEYE.project(ray)), ray, atol=1e-12)
    assert np.isnan(EUROC.project(np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0]]))).all()


def test_beyond_the_fold_of_the_polynomial_there_is_no_image():
    """f(r) = r - 0.35 r^3 + 0.05 r^5 grows up to r = 1.108 only; what is projected beyond would come back inwards."""
    s = (3 * 0.35 - math.sqrt(9 * 0.35**2 - 20 * 0.05)) / (10 * 0.05)
    r = math.sqrt(s)
    just_inside, just_outside = np.array([[0.999 * r, 0, 1]]), np.array([[1.001 * r, 0, 1]])
    assert np.isfinite(FOLDING.project(just_inside)).all()
    assert np.isnan(FOLDING.project(just_outside)).all()
    assert np.isnan(FOLDING.lift(np.array([[0.0, 0.0], [640.0, 480.0]]))).all()


def test_no_pixel_of_a_fisheye_lifts_beyond_180_degrees():
    wild = dataclasses.replace(FISHEYE, k1=0.0, k2=0.0, k3=0.0, k4=0.0)  # equidistant: theta_d = theta for ever
    rim = wild.cx + wild.fx * math.pi
    assert np.isfinite(wild.lift(np.array([[rim - 0.01, wild.cy]]))).all()
    assert np.isnan(wild.lift(np.array([[rim + 0.01, wild.cy]]))).all()


@CAMERAS
def test_nan_in_gives_nan_out_and_nothing_gives_nothing(camera):
    assert np.isnan(camera.lift(np.array([[np.nan, 3.0]]))).all()
    assert np.isnan(camera.project(np.array([[np.nan, 0.0, 1.0], [0.0, 0.0, 0.0]]))).all()
    assert camera.lift(np.zeros((0, 2))).shape == (0, 3)
    assert camera.project(np.zeros((0, 3))).shape == (0, 2)


@CAMERAS
def test_a_camera_survives_being_written_down(camera):
    assert camera_from_dict(**camera_to_dict(camera)) == camera
    assert MODELS[camera.name] is type(camera)


def test_an_unusable_calibration_is_refused_with_the_key_that_is_wrong():
    good = camera_to_dict(EUROC)
    with pytest.raises(CalibrationError, match=r"unknown camera model 'pinhole'; expected one of pinhole-radtan, kann"):
        camera_from_dict(**(good | {"model": "pinhole"}))
    with pytest.raises(CalibrationError, match=r"pinhole-radtan: missing k2; unknown k3; it needs width, height"):
        camera_from_dict(**{("k3" if k == "k2" else k): v for k, v in good.items()})
    for key, value in [
        ("fx", 0.0),
        ("fy", float("nan")),
        ("width", 752.5),
        ("height", -480),
        ("k1", "0.1"),
        ("cx", None),
    ]:
        with pytest.raises(CalibrationError, match=rf"{key}=.*; expected a (positive|finite) (number|integer)"):
            camera_from_dict(**(good | {key: value}))
