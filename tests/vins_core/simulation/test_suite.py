"""Two rooms on a corridor, and the rounds that are made through them."""

import numpy as np
import pytest

from vins_core.geometry import se3, so3
from vins_core.simulation import SCENARIOS, simulate, suite
from vins_core.simulation.render import Renderer
from vins_core.simulation.scenarios import PINHOLE


def view(world, room, yaw_deg, offset=(0.3, -0.2)):
    """What a camera sees in a room."""
    q = so3.exp(np.radians(yaw_deg) * np.array([0.0, 0.0, 1.0]))
    p = np.array([*(suite.centre_m(room) + offset), 1.4])
    return Renderer(world, PINHOLE.camera).render(se3.from_quaternion_translation(q, p) @ PINHOLE.T_b_c)


def test_nothing_tells_twin_rooms_apart():
    world = suite.twins(1)
    for yaw_deg in (90, 180, 270):
        apart = np.abs(view(world, 0, yaw_deg) - view(world, 1, yaw_deg))
        assert np.mean(apart > 2.0) < 5e-3  # where a texture ends, its filter reaches what lies beside it


def test_other_rooms_of_a_suite_differ():
    world = suite.different(1)
    assert np.abs(view(world, 0, 180) - view(world, 1, 180)).mean() > 15


@pytest.mark.parametrize("name", ["twin_rooms", "building_first", "building_second"])
def test_rounds_go_through_doors_and_never_through_walls(name):
    simulation = simulate(name)
    world = simulation.renderer.world
    p = simulation.truth.p_w_b
    assert np.all(np.abs(p - world.room.centre_w_m) < world.room.size_m / 2 - 0.3)
    for solid in world.boxes:
        local = (p - solid.centre_w_m) @ solid.R_w_s
        assert not np.all(np.abs(local) < solid.size_m / 2 + 0.15, axis=1).any()
    inside = p[:, 0] < suite.DOOR_X_M
    rooms = (p[inside, 1] > 0).astype(int)
    visits = rooms[np.flatnonzero(np.diff(rooms, prepend=-1))]
    assert visits.tolist() == {"twin_rooms": [0, 1, 0], "building_first": [0, 1], "building_second": [1, 0]}[name]
    assert np.linalg.norm(simulation.truth.v_w_b, axis=1).max() < 2.5


def test_both_sessions_see_the_same_building_from_places_and_directions_they_share():
    first, second = simulate("building_first", 5), simulate("building_second", 5)
    for a, b in zip(first.renderer.world.textures(), second.renderer.world.textures(), strict=True):
        np.testing.assert_array_equal(a, b)
    start = np.linalg.norm(first.truth.p_w_b - second.truth.p_w_b[0], axis=1)
    assert start.argmin() > len(start) / 2  # the second begins where the first came late
    near = np.linalg.norm(second.truth.p_w_b[::20, None] - first.truth.p_w_b[::20], axis=2) < 0.8
    turned = np.linalg.norm(so3.difference(second.truth.q_w_b[::20, None], first.truth.q_w_b[::20]), axis=2)
    assert (near & (turned < np.radians(30))).any(1).mean() > 0.6


def test_a_level_camera_has_a_body_whose_euler_yaw_means_nothing():
    scenario = SCENARIOS["level_camera"]
    truth = simulate("level_camera").truth
    axis = so3.rotate(truth.q_w_b, scenario.rig.T_b_c[:3, 2])
    assert np.degrees(np.abs(np.arcsin(axis[:, 2]))).max() < 8  # what the hand adds
    up = so3.rotate(truth.q_w_b, np.array([1.0, 0.0, 0.0]))
    assert up[:, 2].min() > np.cos(np.radians(10))
    assert np.abs(np.diff(np.unwrap(so3.heading(truth.q_w_b)))).max() > np.radians(20)
