import dataclasses
import math

import cv2
import numpy as np
import pytest

from vins_core.errors import CalibrationError
from vins_core.geometry.camera import MODELS, camera_from_dict, camera_to_dict
from vins_core.geometry.field_of_view import widest_angle_rad
from vins_core.geometry.kannala_brandt import KannalaBrandt
from vins_core.geometry.mei import Mei
from vins_core.geometry.pinhole_radtan import PinholeRadtan
from vins_core.geometry.pinhole_rational import PinholeRational
from vins_core.geometry.scaramuzza import Scaramuzza
from vins_core.simulation import lenses

EUROC = PinholeRadtan(752, 480, 458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)
WIDE = PinholeRadtan(640, 480, 290.0, 291.0, 316.0, 243.0, -0.22, 0.045, -0.0011, 0.0008)
PINCUSHION = PinholeRadtan(640, 480, 500.0, 500.0, 320.0, 240.0, 0.12, 0.03, 0.0, 0.0)
FOLDING = PinholeRadtan(640, 480, 300.0, 300.0, 320.0, 240.0, -0.35, 0.05, 0.0005, -0.0005)  # folds inside the image
FISHEYE = KannalaBrandt(512, 512, 190.98, 190.97, 254.93, 256.9, 0.0034, 0.00077, -0.002, 0.0002)  # 195 degrees
STEEP = KannalaBrandt(640, 480, 380.0, 381.0, 322.0, 238.0, -0.05, 0.02, -0.03, 0.001)
HALF_A_SPHERE_AND_MORE = KannalaBrandt(800, 800, 172.0, 171.0, 402.0, 397.0, 0.01, -0.004, 0.001, -0.0001)  # 245
KINECT = PinholeRational(
    1280, 720, 612.3, 612.0, 637.8, 368.9, 0.5158, -2.6033, 0.000498, -0.000227, 1.5076, 0.3946, -2.4277, 1.4353
)
ACTION = PinholeRational(640, 480, 260.0, 261.0, 322.0, 236.0, 0.31, 0.02, 4e-4, -3e-4, 1e-3, 0.65, 0.06, 3e-3)
OMNI = Mei(752, 480, 1.72, 1162.0, 1158.0, 368.0, 248.0, -0.28, 0.24, 4.7e-4, -3.6e-4)
WIDE_OMNI = Mei(640, 640, 1.18, 262.0, 261.0, 318.0, 322.0, -0.05, 0.01, 3e-4, -2e-4)  # 220 degrees
MIRROR = Mei(640, 480, 0.93, 180.0, 181.0, 318.0, 243.0, 0.02, 0.005, 1e-4, 2e-4)
OCAM = Scaramuzza(1280, 1024, -6.1e2, 0.0, 5.1e-4, -2.7e-7, 3.9e-10, 1.0008, 3.1e-4, -2.2e-4, 641.3, 514.9)
WIDE_OCAM = Scaramuzza(640, 640, -1.7e2, 0.0, 2.1e-3, -4.0e-6, 9.0e-9, 0.9993, -4e-4, 7e-4, 317.0, 322.0)

ALL = {
    "euroc": EUROC,
    "wide": WIDE,
    "pincushion": PINCUSHION,
    "folding": FOLDING,
    "fisheye": FISHEYE,
    "steep": STEEP,
    "245 degrees": HALF_A_SPHERE_AND_MORE,
    "kinect": KINECT,
    "action": ACTION,
    "omni": OMNI,
    "wide omni": WIDE_OMNI,
    "mirror": MIRROR,
    "ocam": OCAM,
    "wide ocam": WIDE_OCAM,
    **{f"simulated {lens.name}": lens for lens in (lenses.KB_190, lenses.MEI, lenses.SCARAMUZZA, lenses.RATIONAL)},
}
CAMERAS = pytest.mark.parametrize("camera", ALL.values(), ids=ALL.keys())
BEYOND_180 = [FISHEYE, HALF_A_SPHERE_AND_MORE, WIDE_OMNI, MIRROR, WIDE_OCAM]


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


@pytest.mark.parametrize("camera", [KINECT, ACTION], ids=["kinect", "action"])
def test_the_rational_model_agrees_with_opencv(camera):
    uv = pixels(camera, 16)
    rays = camera.lift(uv)
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    D = np.array([getattr(camera, k) for k in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")])
    projected = cv2.projectPoints(5.0 * rays, np.zeros(3), np.zeros(3), K, D)[0][:, 0]
    np.testing.assert_allclose(projected, uv, atol=1e-9)


def test_a_rational_model_without_denominator_is_radtan_and_mei_without_mirror_as_well():
    uv = pixels(WIDE, 16)
    width, height, *numbers = dataclasses.astuple(WIDE)
    rational = PinholeRational(width, height, *numbers, 0.0, 0.0, 0.0, 0.0)
    mei = Mei(width, height, 0.0, *numbers)
    np.testing.assert_allclose(rational.lift(uv), WIDE.lift(uv), atol=1e-14)
    np.testing.assert_allclose(mei.lift(uv), WIDE.lift(uv), atol=1e-14)


def test_a_parabolic_mirror_is_the_stereographic_projection():
    """xi = 1 without distortion: |xy| = tan(theta / 2), up to the point behind the mirror."""
    mirror = Mei(640, 480, 1.0, 100.0, 100.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0)
    angle = np.radians([0.0, 30.0, 90.0, 120.0, 175.0])
    rays = np.column_stack([np.sin(angle), np.zeros(5), np.cos(angle)])
    expected = np.column_stack([320.0 + 100.0 * np.tan(angle / 2), np.full(5, 240.0)])
    np.testing.assert_allclose(mirror.project(rays), expected, rtol=1e-13)
    np.testing.assert_allclose(mirror.lift(expected), rays, atol=1e-13)


def test_behind_the_edge_of_the_mirror_there_is_no_image():
    """For xi > 1 the image of the sphere folds back where cos = -1 / xi."""
    mirror = dataclasses.replace(WIDE_OMNI, xi=1.6, k1=0.0, k2=0.0)
    for step, seen in ((-1e-3, True), (1e-3, False)):
        angle = math.acos(-1 / 1.6) + step
        uv = mirror.project(np.array([[math.sin(angle), 0.0, math.cos(angle)]]))
        assert np.isfinite(uv).all() == seen
    beyond = np.array([[mirror.cx + mirror.fx * (1 / math.sqrt(1.6**2 - 1) + 1e-3), mirror.cy]])
    assert np.isnan(mirror.lift(beyond)).all()


def test_a_constant_polynomial_of_scaramuzza_is_a_pinhole():
    ocam = Scaramuzza(640, 480, -300.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 310.0, 245.0)
    pinhole = PinholeRadtan(640, 480, 300.0, 300.0, 310.0, 245.0, 0.0, 0.0, 0.0, 0.0)
    uv = pixels(ocam, 16)
    np.testing.assert_allclose(ocam.lift(uv), pinhole.lift(uv), atol=1e-15)


def test_scaramuzza_lifts_to_the_height_of_its_polynomial_over_the_affine_sensor():
    x, y = 240.0, -150.0
    affine = np.array([[WIDE_OCAM.ac, WIDE_OCAM.ad], [WIDE_OCAM.ae, 1.0]])
    uv = affine @ [x, y] + [WIDE_OCAM.cx, WIDE_OCAM.cy]
    rho = math.hypot(x, y)
    height = -sum(getattr(WIDE_OCAM, f"p{i}") * rho**i for i in range(5))
    expected = np.array([x, y, height]) / math.hypot(x, y, height)
    np.testing.assert_allclose(WIDE_OCAM.lift(uv[None])[0], expected, atol=1e-15)


@pytest.mark.parametrize("camera", BEYOND_180, ids=["fisheye", "245 degrees", "wide omni", "mirror", "wide ocam"])
def test_the_image_goes_on_through_90_degrees_without_a_jump(camera):
    """From the centre to a corner of the image the ray turns on and on, also behind the image plane."""
    rays = camera.lift(np.linspace([camera.cx, camera.cy], [0.0, 0.0], 2000))
    rays = rays[np.isfinite(rays).all(1)]
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    assert rays[:, 2].min() < -0.08
    assert (np.diff(angle) > 0).all() and np.diff(angle).max() < 20 * np.diff(angle)[0]


def test_the_widest_angle_is_that_of_the_farthest_corner():
    assert widest_angle_rad(PINCUSHION) == pytest.approx(math.acos(PINCUSHION.lift(np.zeros((1, 2)))[0, 2]))
    assert math.degrees(widest_angle_rad(HALF_A_SPHERE_AND_MORE)) > 120, "corners without a ray do not hide the rest"


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
    with pytest.raises(CalibrationError, match=r"unknown camera model 'pinhole'; expected one of pinhole-radtan, pinh"):
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


@pytest.mark.parametrize(
    ("camera", "key", "value", "said"),
    [
        (OMNI, "xi", -0.1, "xi=-0.1; expected 0"),
        (OCAM, "p0", 610.0, "p0=610.0; expected less than 0"),
        (OCAM, "ac", -1.0, "ac=-1.0, .* expected ac - ad ae greater than 0"),
    ],
)
def test_numbers_that_no_lens_has_are_refused(camera, key, value, said):
    with pytest.raises(CalibrationError, match=said):
        camera_from_dict(**(camera_to_dict(camera) | {key: value}))
