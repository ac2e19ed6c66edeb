"""A street around a block of houses, with what is parked in it: somewhere to drive where a satellite can be seen.

Drawn as a room at a third of its size, pictures for shop fronts and tiles for paving, then enlarged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import rooms
from .canvas import Canvas
from .world import Solid, World

ENLARGED = 3.0
SIZE_M = ENLARGED * np.array([12.0, 9.0, 3.0])
BLOCK_M = ENLARGED * np.array([5.0, 2.0, 3.0])
LANE_RADII_M = (13.0, 8.7)
"""Of the ellipse in the middle of the street."""

PARKED: tuple[rooms.Box, ...] = (  # outside of the lane, before enlarging
    ("cabinet", (5.45, 1.2), (0.6, 1.4, 0.7), 0.0, 0.0),
    ("crate", (5.3, -1.9), (0.7, 0.7, 0.7), 20.0, 0.0),
    ("cardboard", (3.6, 3.9), (1.0, 0.6, 0.6), -15.0, 0.0),
    ("books", (0.9, 4.1), (1.4, 0.5, 1.0), 0.0, 0.0),
    ("cabinet", (-2.2, 4.0), (1.3, 0.6, 0.8), 4.0, 0.0),
    ("crate", (-5.1, 2.9), (0.8, 0.8, 0.9), 40.0, 0.0),
    ("cardboard", (-5.4, -0.6), (0.7, 1.1, 0.6), 8.0, 0.0),
    ("cabinet", (-3.7, -3.9), (1.2, 0.6, 0.8), -10.0, 0.0),
    ("books", (-0.6, -4.1), (1.5, 0.5, 1.1), 0.0, 0.0),
    ("crate", (2.8, -3.9), (0.9, 0.7, 0.7), 12.0, 0.0),
)


def street(seed: int) -> World:
    """36 x 27 m centred on the origin, the ground at z = 0; nothing stands within the lane."""
    rng = np.random.default_rng([seed, 5])
    x, y, z = SIZE_M / ENLARGED
    fronts, pictures = _fronts(rng, (y, y, x, x), z, 0)
    boxes = [rooms.make_box(rng, *place) for place in PARKED]
    ground = rooms.draw_floor(rng, x, y, boxes, ())
    shell = Solid(np.array([0.0, 0.0, z / 2]), SIZE_M / ENLARGED, (*fronts, ground, _sky(rng, x, y)), hollow=True)
    return World(_enlarged(shell), tuple(_enlarged(solid) for solid in (_block(rng, pictures), *boxes)))


def _block(rng: np.random.Generator, pictures: int) -> Solid:
    x, y, z = BLOCK_M / ENLARGED
    fronts, _ = _fronts(rng, (y, y, x, x), z, pictures)
    roof = Canvas(x, y, 120).pixels
    return Solid(np.array([0.0, 0.0, z / 2]), BLOCK_M / ENLARGED, (*fronts, roof, roof))


def _fronts(
    rng: np.random.Generator, widths: tuple[float, ...], height: float, pictures: int
) -> tuple[list[np.ndarray], int]:
    fronts = []
    for width in widths:
        front, pictures = rooms.draw_wall(rng, width, height, pictures)
        fronts.append(front)
    return fronts, pictures


def _sky(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    canvas = Canvas(width, height, 215)
    canvas.mottle(rng, 2.0, 0.12)
    return canvas.pixels


def _enlarged(solid: Solid) -> Solid:
    return replace(solid, centre_w_m=ENLARGED * solid.centre_w_m, size_m=ENLARGED * solid.size_m)
