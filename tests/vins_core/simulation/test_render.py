"""Pixels are where the camera model says they are."""

import numpy as np
import pytest

from vins_core.geometry import se3
from vins_core.geometry.kannala_brandt import KannalaBrandt
from vins_core.geometry.pinhole_radtan import PinholeRadtan
from vins_core.simulation.render import Renderer
from vins_core.simulation.world import Solid, World, hits

CAMERAS = [
    PinholeRadtan(160, 120, 95.0, 96.0, 78.3, 61.1, -0.28, 0.07, 2e-4, 1e-5),
    KannalaBrandt(160, 120, 60.0, 61.0, 80.4, 58.9, -0.01, 0.004, -0.003, 0.0006),
]
MARKER_M = 0.12
BLACK_WALL = np.zeros((512, 512), np.uint8)
LOOKING_ALONG_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def world_with_marker(right_m: float, down_m: float) -> World:
    """A black cube of 4 m around the origin with a white disc on its +x wall."""
    y, x = (np.mgrid[:512, :512] + 0.5) * 4.0 / 512
    wall = np.where(np.hypot(x - right_m, y - down_m) < MARKER_M, 255, 0).astype(np.uint8)
    faces = [wall if face == 1 else BLACK_WALL for face in range(6)]
    return World(Solid(np.zeros(3), np.full(3, 4.0), tuple(faces), hollow=True), ())


def pose(p_w_c: list[float]) -> np.ndarray:
    return se3.from_rotation_translation(LOOKING_ALONG_X, np.array(p_w_c))


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.name)
@pytest.mark.parametrize("place", [(2.0, 2.0), (1.3, 2.5), (2.9, 1.4)])
def test_a_marker_appears_where_its_centre_projects(camera, place):
    world, T_w_c = world_with_marker(*place), pose([-1.0, 0.1, -0.05])
    image = Renderer(world, camera).render(T_w_c) / Renderer(_white(world), camera).render(T_w_c)
    v, u = np.mgrid[: camera.height, : camera.width]
    seen = np.array([(u * image).sum(), (v * image).sum()]) / image.sum()

    # the image of a disc is not centred on the image of its centre: average over the disc, as the light does
    r, a = np.meshgrid(np.sqrt(np.arange(0.5, 20) / 20) * MARKER_M, np.arange(64) * 2 * np.pi / 64)
    disc = [
        world.surfaces().point(1, place[0] + x, place[1] + y)
        for x, y in zip((r * np.cos(a)).ravel(), (r * np.sin(a)).ravel())
    ]
    at = se3.transform(se3.inverse(T_w_c), np.array(disc))
    weight = at[:, 2] / np.linalg.norm(at, axis=1) ** 3  # area in the image per area on the wall, to first order
    expected = np.average(camera.project(at), axis=0, weights=weight)
    np.testing.assert_allclose(seen, expected, atol=0.1)


def _white(world: World) -> World:
    white = np.full_like(BLACK_WALL, 255)
    return World(Solid(world.room.centre_w_m, world.room.size_m, (white,) * 6, hollow=True), ())


def test_rays_meet_the_surface_they_are_said_to_meet():
    rng = np.random.default_rng(0)
    box = Solid(np.array([1.0, 0.3, -0.2]), np.array([0.6, 0.8, 1.0]), (BLACK_WALL,) * 6, yaw_rad=0.4)
    world = World(Solid(np.zeros(3), np.full(3, 4.0), (BLACK_WALL,) * 6, hollow=True), (box,))
    rays = rng.standard_normal((500, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    origin = np.array([-0.5, -0.2, 0.1])
    surface, distance = hits(world, origin, rays)
    assert {*range(6)} < {*surface.tolist()}  # all walls and some of the box
    faces = world.surfaces()
    offset = origin + distance[:, None] * rays - faces.origin_w[surface]
    right = (offset * faces.right_w[surface]).sum(1)
    down = (offset * faces.down_w[surface]).sum(1)
    normal = np.cross(faces.right_w, faces.down_w)[surface]
    np.testing.assert_allclose((offset * normal).sum(1), 0.0, atol=1e-5)
    assert np.all((right > -1e-5) & (right < faces.size_m[surface, 0] + 1e-5))
    assert np.all((down > -1e-5) & (down < faces.size_m[surface, 1] + 1e-5))
    assert np.all((normal * rays).sum(1) > 0), "right x down points away from the viewer"


def test_a_rolling_shutter_at_rest_is_a_global_shutter():
    camera = CAMERAS[0]
    renderer, T_w_c = Renderer(world_with_marker(2.0, 2.0), camera), pose([0.0, 0.0, 0.0])
    rows = np.broadcast_to(T_w_c, (camera.height, 4, 4))
    np.testing.assert_allclose(renderer.render(rows), renderer.render(T_w_c), atol=0.05)


def test_far_texture_is_averaged_not_sampled():
    """A chequerboard finer than a pixel is grey."""
    fine = np.kron(np.indices((256, 256)).sum(0) % 2, np.ones((2, 2))).astype(np.uint8) * 255
    world = World(Solid(np.zeros(3), np.full(3, 4.0), (fine,) * 6, hollow=True), ())
    image = Renderer(world, CAMERAS[0]).render(pose([-1.9, 0.0, 0.0]))
    assert np.abs(image[40:80, 60:100] - 127.5).max() < 15
