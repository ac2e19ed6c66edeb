"""Two rooms side by side on one corridor: places that look the same, and a building to come back to.

    y ^   +--------+-----+
      |   | room 1 |     |        each room 5 x 5 m, with a doorway to the corridor
          |        :     |        origin in the middle of the building, floor at z = 0
          +--------+ cor-|
          | room 0 | ri- |
          |        : dor |
          +--------+-----+  -> x

Everything of one room lies `PITCH_M` further along y in the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from . import posters, rooms
from .canvas import TEXELS_PER_M, Canvas
from .world import Solid, World

ROOM_M, HEIGHT_M, CORRIDOR_M = 5.0, 3.0, 2.0
WALL_M = 1.0 / 6.0  # all sides are whole blocks of texels
DOOR_M, DOOR_HEIGHT_M = 1.0, 2.0
PITCH_M = ROOM_M + WALL_M
SIZE_M = np.array([ROOM_M + WALL_M + CORRIDOR_M, 2 * ROOM_M + WALL_M, HEIGHT_M])
ROOM_X_M = (ROOM_M - SIZE_M[0]) / 2  # middle of the rooms
CORRIDOR_X_M = (SIZE_M[0] - CORRIDOR_M) / 2  # of the corridor
DOOR_X_M = ROOM_X_M + (ROOM_M + WALL_M) / 2  # of the wall between them
PAINT = 176

RUGS: tuple[rooms.Rectangle, ...] = ((0.7, 0.8, 1.6, 1.1), (2.9, 2.9, 1.1, 1.5))
BOXES: tuple[rooms.Box, ...] = (
    ("books", (-2.28, 0.9), (0.4, 1.3, 1.9), 0.0, 0.0),
    ("crate", (-2.1, -1.95), (0.6, 0.6, 0.6), 20.0, 0.0),
    ("cabinet", (0.3, 2.27), (1.2, 0.42, 0.9), 0.0, 0.0),
    ("cardboard", (0.4, 2.27), (0.4, 0.35, 0.35), 8.0, 0.9),
    ("books", (0.2, -2.3), (1.3, 0.36, 1.2), 0.0, 0.0),
    ("crate", (2.1, -1.9), (0.5, 0.5, 0.5), 35.0, 0.0),
    ("cabinet", (2.26, 1.6), (0.4, 0.9, 0.9), 0.0, 0.0),
    ("cardboard", (0.0, 0.1), (0.5, 0.4, 0.7), -20.0, 0.0),
)


@dataclass(frozen=True)
class _Room:
    """What one room shows; walls as one sees them from inside, the door's from the corridor, too."""

    west: np.ndarray
    east: np.ndarray
    south: np.ndarray
    north: np.ndarray
    floor: np.ndarray
    ceiling: np.ndarray
    boxes: tuple[Solid, ...]  # in a room centred on the origin


def twins(seed: int) -> World:
    """Two rooms without any difference."""
    rng = np.random.default_rng([seed, 3])
    room = _room(rng)
    return _building(rng, (room, room))


def different(seed: int) -> World:
    """Two rooms that share a plan and nothing else."""
    rng = np.random.default_rng([seed, 4])
    return _building(rng, (_room(rng), _room(rng)))


def centre_m(room: int) -> np.ndarray:
    """(2,) x and y of a room's middle."""
    return np.array([ROOM_X_M, (room - 0.5) * PITCH_M])


def _room(rng: np.random.Generator) -> _Room:
    walls, pictures = [], int(rng.integers(len(posters.POSTERS)))
    for _ in range(4):
        wall, pictures = rooms.draw_wall(rng, ROOM_M, HEIGHT_M, pictures)
        walls.append(wall)
    boxes = tuple(rooms.make_box(rng, *box) for box in BOXES)
    floor = rooms.draw_floor(rng, ROOM_M, ROOM_M, boxes, RUGS)
    west, east, south, north = walls
    return _Room(west, east, south, north, floor, rooms.draw_ceiling(rng, ROOM_M, ROOM_M), boxes)


def _building(rng: np.random.Generator, pair: tuple[_Room, _Room]) -> World:
    a, b = pair
    length = SIZE_M[1]
    corridor, pictures = rooms.draw_wall(rng, length, HEIGHT_M, 7)
    ends = [rooms.draw_wall(rng, CORRIDOR_M, HEIGHT_M, pictures + k)[0] for k in range(2)]
    floor = rooms.draw_floor(rng, CORRIDOR_M, length, (), ())
    ceiling = rooms.draw_ceiling(rng, CORRIDOR_M, length)
    jamb, sill = _paint(WALL_M, HEIGHT_M), _paint(ROOM_M, WALL_M)
    side = _paint(WALL_M, length)
    shell = (
        np.hstack([a.west, jamb, b.west]),
        corridor,
        np.hstack([ends[0], jamb, a.south]),
        np.hstack([b.north, jamb, ends[1]]),
        np.hstack([np.vstack([b.floor, sill, a.floor]), side, floor]),
        np.hstack([ceiling, side, np.vstack([b.ceiling, sill, a.ceiling])]),
    )
    middle = np.array([0.0, 0.0, HEIGHT_M / 2])
    solids = [
        _wall(
            (ROOM_X_M + WALL_M / 2, 0.0),
            (ROOM_M + WALL_M, WALL_M),
            0.0,
            HEIGHT_M,
            {2: np.hstack([a.north, jamb]), 3: np.hstack([jamb, b.south])},
        )
    ]
    for number, room in enumerate(pair):
        outside, pictures = rooms.draw_wall(rng, ROOM_M, HEIGHT_M, pictures)
        solids += _door_wall(centre_m(number)[1], room.east, outside)
        shift = np.append(centre_m(number), 0.0)
        solids += [replace(box, centre_w_m=box.centre_w_m + shift) for box in room.boxes]
    return World(Solid(middle, SIZE_M, shell, hollow=True), tuple(solids))


def _door_wall(y_m: float, inside: np.ndarray, outside: np.ndarray) -> list[Solid]:
    """The wall between a room and the corridor in three parts: beyond the doorway, above it, before it."""
    wing, above = (ROOM_M - DOOR_M) / 2, HEIGHT_M - DOOR_HEIGHT_M
    first, last, top = (round(m * TEXELS_PER_M) for m in (wing, wing + DOOR_M, above))
    offset, upper = (ROOM_M + DOOR_M) / 4, slice(0, top)
    return [
        _wall((DOOR_X_M, y_m + offset), (WALL_M, wing), 0.0, HEIGHT_M, {0: inside[:, :first], 1: outside[:, last:]}),
        _wall(
            (DOOR_X_M, y_m),
            (WALL_M, DOOR_M),
            DOOR_HEIGHT_M,
            HEIGHT_M,
            {0: inside[upper, first:last], 1: outside[upper, first:last]},
        ),
        _wall((DOOR_X_M, y_m - offset), (WALL_M, wing), 0.0, HEIGHT_M, {0: inside[:, last:], 1: outside[:, :first]}),
    ]


def _wall(
    centre: tuple[float, float],
    size: tuple[float, float],
    bottom_m: float,
    top_m: float,
    pictures: dict[int, np.ndarray],
) -> Solid:
    """A slab, painted where it has no picture; faces are numbered as in FACES."""
    (x, y), z = size, top_m - bottom_m
    plain = [_paint(*sides) for sides in ((y, z), (y, z), (x, z), (x, z), (x, y), (x, y))]
    textures = tuple(np.ascontiguousarray(pictures.get(face, plain[face])) for face in range(6))
    return Solid(np.array([*centre, (bottom_m + top_m) / 2]), np.array([x, y, z]), textures)


def _paint(width_m: float, height_m: float) -> np.ndarray:
    return Canvas(width_m, height_m, PAINT).pixels
