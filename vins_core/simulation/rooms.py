"""Furnished rooms: walls with posters, shelves and windows, a tiled floor, boxes to walk around."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from . import posters
from .canvas import Canvas
from .world import Solid, World

SIZE_M = np.array([12.0, 10.0, 3.4])
WAINSCOT_M = 0.85
SPLITS = ((0.6, 0.4), (0.5, 0.5), (0.45, 0.3, 0.25), (0.65, 0.35))  # of a column of pictures
GAP_M = 0.18  # between them

Rectangle = tuple[float, float, float, float]
"""Left, top, width, height on a face, m."""
Box = tuple[str, tuple[float, float], tuple[float, float, float], float, float]
"""Kind, centre x y m, size m, yaw deg, height of the underside m."""


def furnished(seed: int) -> World:
    """A room of 12 x 10 x 3.4 m centred on the origin, floor at z = 0; nothing stands within the loop's path."""
    rng = np.random.default_rng([seed, 1])
    x, y, z = SIZE_M
    walls, pictures = [], 0
    for width in (y, y, x, x):
        wall, pictures = draw_wall(rng, width, z, pictures)
        walls.append(wall)
    boxes = [make_box(rng, *place) for place in BOXES]
    floor = draw_floor(rng, x, y, boxes, RUGS)
    textures = (*walls, floor, draw_ceiling(rng, x, y))
    return World(Solid(np.array([0.0, 0.0, z / 2]), SIZE_M, textures, hollow=True), tuple(boxes))


def bare(seed: int) -> World:
    """The same room painted white: a few sockets and faint scuffs, one picture, and nothing else to hold on to."""
    rng = np.random.default_rng([seed, 2])
    x, y, z = SIZE_M
    faces = []
    for width, height in ((y, z), (y, z), (x, z), (x, z), (x, y), (x, y)):
        canvas = Canvas(width, height, 176)
        canvas.mottle(rng, 3.0, 0.9)
        for _ in range(round(0.8 * width * height)):
            w, h = rng.uniform(0.04, 0.14, 2)
            canvas.rectangle(
                rng.uniform(0, width - w), rng.uniform(0, height - h), w, h, 176 + rng.choice([-18, -10, 12])
            )
        faces.append(canvas)
    posters.frame(faces[1], 3.6, 1.1, 0.8, 0.6, 90)
    posters.landscape(faces[1], rng, 0, 3.6, 1.1, 0.8, 0.6)
    textures = tuple(lit(canvas).pixels for canvas in faces)
    return World(Solid(np.array([0.0, 0.0, z / 2]), SIZE_M, textures, hollow=True), ())


RUGS: tuple[Rectangle, ...] = ((4.2, 0.9, 2.6, 1.6), (8.2, 7.0, 2.2, 1.5), (1.0, 4.2, 1.5, 2.2), (9.6, 2.6, 1.4, 2.0))
BOXES: tuple[Box, ...] = (
    ("cabinet", (-0.1, 0.1), (1.3, 0.8, 0.9), 15.0, 0.0),
    ("cardboard", (-0.35, 0.15), (0.5, 0.45, 0.4), 40.0, 0.9),
    ("crate", (0.25, 0.0), (0.45, 0.45, 0.45), 5.0, 0.9),
    ("books", (5.7, 2.9), (0.5, 1.8, 2.1), 0.0, 0.0),
    ("crate", (5.2, -1.5), (0.8, 0.8, 0.8), 20.0, 0.0),
    ("cardboard", (5.2, -1.5), (0.5, 0.4, 0.4), -15.0, 0.8),
    ("cardboard", (3.9, 4.3), (0.7, 0.6, 0.6), -25.0, 0.0),
    ("books", (1.3, 4.75), (1.6, 0.45, 1.1), 0.0, 0.0),
    ("cabinet", (-2.2, 4.6), (1.8, 0.6, 0.95), 0.0, 0.0),
    ("cardboard", (-2.6, 4.6), (0.4, 0.35, 0.35), 10.0, 0.95),
    ("crate", (-5.2, 3.5), (0.9, 0.7, 1.1), -10.0, 0.0),
    ("books", (-5.7, -0.6), (0.45, 2.0, 1.9), 0.0, 0.0),
    ("cardboard", (-4.9, -4.0), (0.8, 0.7, 0.7), 30.0, 0.0),
    ("cardboard", (-4.9, -4.0), (0.5, 0.5, 0.4), 5.0, 0.7),
    ("books", (0.2, -4.75), (2.2, 0.4, 1.5), 0.0, 0.0),
    ("crate", (-2.4, -4.5), (0.6, 0.6, 0.5), -20.0, 0.0),
    ("crate", (4.2, -4.1), (0.7, 0.7, 0.6), 35.0, 0.0),
)


def draw_wall(rng: np.random.Generator, width: float, height: float, pictures: int) -> tuple[np.ndarray, int]:
    """Columns of two or three pictures between the ceiling and the wainscot, numbered on from `pictures`."""
    canvas = Canvas(width, height, 188)
    canvas.mottle(rng, 5.0, 0.25)
    _wainscot(canvas, rng)
    left = 0.2
    while left < width - 0.6:
        w = min(rng.uniform(0.6, 1.05), width - 0.2 - left)
        shares = rng.permutation(SPLITS[rng.integers(len(SPLITS))])
        top, bottom = 0.25 + rng.uniform(0.0, 0.15), height - WAINSCOT_M - 0.15 - rng.uniform(0.0, 0.12)
        free = bottom - top - GAP_M * (len(shares) - 1)
        for h in shares * free:
            narrow = rng.uniform(0.8, 1.0) * w
            x = left + rng.uniform(0.0, w - narrow)
            posters.frame(canvas, x, top, narrow, h, rng.choice([25, 60, 235]))
            posters.POSTERS[pictures % len(posters.POSTERS)](canvas, rng, pictures, x, top, narrow, h)
            top += h + GAP_M
            pictures += 1
        left += w + rng.uniform(0.18, 0.3)
    return lit(canvas).pixels, pictures


def _wainscot(canvas: Canvas, rng: np.random.Generator) -> None:
    """Boards of different shades below a rail, a skirting board at the floor."""
    top, left = canvas.height_m - WAINSCOT_M, 0.0
    while left < canvas.width_m:
        w = rng.uniform(0.16, 0.3)
        grey = rng.uniform(70, 150)
        canvas.rectangle(left, top, w, WAINSCOT_M, grey)
        canvas.rectangle(left, top, 0.015, WAINSCOT_M, 0.5 * grey)
        if rng.random() < 0.35:
            canvas.rectangle(left + 0.3 * w, top + rng.uniform(0.15, 0.5), 0.4 * w, 0.09, rng.choice([40, 200]))
        left += w
    canvas.rectangle(0, top - 0.03, canvas.width_m, 0.06, 215)
    canvas.rectangle(0, canvas.height_m - 0.12, canvas.width_m, 0.12, 60)


def draw_floor(
    rng: np.random.Generator, width: float, height: float, boxes: Sequence[Solid], rugs: Sequence[Rectangle]
) -> np.ndarray:
    """Tiles, rugs and the shadows of what stands on them; the face is centred on the origin."""
    side = 0.5
    canvas = Canvas(width, height, 80)
    for i in range(round(width / side)):
        for j in range(round(height / side)):
            grey = (118 if (i + j) % 2 else 165) + rng.uniform(-22, 22)
            canvas.rectangle(i * side + 0.006, j * side + 0.006, side - 0.012, side - 0.012, grey)
            if rng.random() < 0.4:
                cx, cy, r = (i + 0.5) * side, (j + 0.5) * side, rng.uniform(0.06, 0.15)
                canvas.polygon([(cx, cy - r), (cx + r, cy), (cx, cy + r), (cx - r, cy)], rng.choice([55, 225]))
    canvas.mottle(rng, 6.0, 0.12)
    for x, y, w, h in rugs:
        canvas.rectangle(x, y, w, h, 45)
        canvas.rectangle(x + 0.08, y + 0.08, w - 0.16, h - 0.16, 215)
        posters.quilt(canvas, rng, 0, x + 0.16, y + 0.16, w - 0.32, h - 0.32)
    canvas.shade(_shadows(canvas, boxes))
    return lit(canvas).pixels


def _shadows(floor: Canvas, boxes: Sequence[Solid]) -> np.ndarray:
    """Darker towards whatever stands on the floor."""
    right, down = floor.grid_m()
    x, y = right - floor.width_m / 2, floor.height_m / 2 - down
    light = np.ones(np.broadcast_shapes(x.shape, y.shape))
    for box in boxes:
        if box.centre_w_m[2] > box.size_m[2] / 2 + 0.01:
            continue
        dx, dy = x - box.centre_w_m[0], y - box.centre_w_m[1]
        c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
        beside_x = np.maximum(np.abs(c * dx + s * dy) - box.size_m[0] / 2, 0)
        beside_y = np.maximum(np.abs(c * dy - s * dx) - box.size_m[1] / 2, 0)
        light *= 1.0 - 0.55 * np.exp(-np.hypot(beside_x, beside_y) / 0.15)
    return light


def draw_ceiling(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """Panels, beams and lamps."""
    canvas = Canvas(width, height, 205)
    for x in np.arange(0.0, width, 1.25):
        canvas.rectangle(x, 0, 0.14, height, 110 + rng.uniform(-20, 20))
    for y in np.arange(0.8, height, 1.6):
        canvas.rectangle(0, y, width, 0.05, 150)
    for x in np.arange(1.3, width, 2.5):
        for y in np.arange(1.4, height, 2.4):
            canvas.rectangle(x, y, 0.9, 0.35, 60)
            canvas.rectangle(x + 0.04, y + 0.04, 0.82, 0.27, 252)
    canvas.mottle(rng, 3.0, 0.3)
    return lit(canvas).pixels


def lit(canvas: Canvas) -> Canvas:
    """Less light towards the edges of a face, where walls meet."""
    x, y = canvas.grid_m()
    gap_x = np.minimum(x, canvas.width_m - x)
    gap_y = np.minimum(y, canvas.height_m - y)
    canvas.shade((1.0 - 0.28 * np.exp(-gap_x / 0.35)) * (1.0 - 0.22 * np.exp(-gap_y / 0.3)))
    return canvas


def make_box(
    rng: np.random.Generator,
    kind: str,
    centre_m: tuple[float, float],
    size_m: tuple[float, float, float],
    yaw_deg: float,
    bottom_m: float,
) -> Solid:
    x, y, z = size_m
    side = SIDES[kind]
    faces = [side(rng, w, h) for w, h in ((y, z), (y, z), (x, z), (x, z))]
    lids = [_lid(rng, x, y), _lid(rng, x, y)]
    light = (0.8, 1.0, 0.9, 0.75, 0.5, 1.1)  # from above and one side
    textures = []
    for canvas, factor in zip([*faces, *lids], light):
        canvas.mottle(rng, 5.0, 0.08)
        canvas.shade(factor)
        textures.append(canvas.pixels)
    return Solid(
        np.array([*centre_m, bottom_m + z / 2]), np.array(size_m), tuple(textures), yaw_rad=float(np.radians(yaw_deg))
    )


def _cardboard(rng: np.random.Generator, width: float, height: float) -> Canvas:
    canvas = Canvas(width, height, rng.uniform(135, 175))
    canvas.rectangle(0.44 * width, 0, 0.12 * width, height, 205)
    x, y = width * rng.uniform(0.06, 0.2), height * rng.uniform(0.12, 0.3)
    canvas.rectangle(x, y, 0.32 * width, 0.35 * height, 242)
    for row in range(4):
        length = width * rng.uniform(0.12, 0.27)
        canvas.rectangle(x + 0.03 * width, y + (0.05 + 0.08 * row) * height, length, 0.04 * height, 35)
    word = str(rng.choice(["FRAGILE", "IMU INSIDE", "SPARES", "GYROS", "THIS WAY UP", "LENSES"]))
    canvas.text(word, 0.08 * width, 0.9 * height, 0.12 * height, 40, 0.84 * width)
    for x in (0.64 * width, 0.82 * width):
        arrow = [(0, 0), (0.07, 0.12), (0.03, 0.12), (0.03, 0.32), (-0.03, 0.32), (-0.03, 0.12), (-0.07, 0.12)]
        canvas.polygon([(x + a * width, (0.18 + b) * height) for a, b in arrow], 45)
    return canvas


def _crate(rng: np.random.Generator, width: float, height: float) -> Canvas:
    canvas = Canvas(width, height, 40)
    planks = max(3, round(height / 0.14))
    for plank in range(planks):
        grey = rng.uniform(105, 185)
        canvas.rectangle(0, (plank + 0.06) * height / planks, width, 0.88 * height / planks, grey)
    rail = min(0.12, 0.2 * width)
    canvas.polygon([(rail, 0), (2 * rail, 0), (width - rail, height), (width - 2 * rail, height)], 205)
    for x in (0.0, width - rail):
        canvas.rectangle(x, 0, rail, height, 85)
        for plank in range(planks):
            canvas.circle(x + rail / 2, (plank + 0.5) * height / planks, 0.018, 230)
    return canvas


def _cabinet(rng: np.random.Generator, width: float, height: float) -> Canvas:
    canvas = Canvas(width, height, 50)
    columns, rows = max(1, round(width / 0.5)), max(2, round(height / 0.3))
    w, h = width / columns, height / rows
    for i in range(columns):
        for j in range(rows):
            grey = rng.uniform(120, 215)
            canvas.rectangle(i * w + 0.015, j * h + 0.015, w - 0.03, h - 0.03, grey)
            canvas.rectangle((i + 0.35) * w, (j + 0.42) * h, 0.3 * w, 0.16 * h, 35 if grey > 160 else 235)
            canvas.circle((i + 0.15) * w, (j + 0.3) * h, 0.025, 60)
    return canvas


def _books(rng: np.random.Generator, width: float, height: float) -> Canvas:
    canvas = Canvas(width, height, 35)
    rows = max(2, round(height / 0.36))
    h = height / rows
    for row in range(rows):
        canvas.rectangle(0, (row + 0.9) * h, width, 0.1 * h, 170)
        left = 0.03
        while left < width - 0.06:
            w = min(rng.uniform(0.04, 0.11), width - 0.03 - left)
            tall = h * rng.uniform(0.55, 0.84)
            grey = rng.choice([65, 90, 115, 140, 165, 190, 220])
            top = (row + 0.9) * h - tall
            if rng.random() < 0.9:
                canvas.rectangle(left, top, w, tall, grey)
                canvas.rectangle(
                    left, top + rng.uniform(0.1, 0.6) * tall, w, 0.16 * tall, grey + (70 if grey < 140 else -70)
                )
            left += w + 0.006
    return canvas


def _lid(rng: np.random.Generator, width: float, height: float) -> Canvas:
    canvas = Canvas(width, height, rng.uniform(140, 190))
    canvas.rectangle(0, 0.45 * height, width, 0.1 * height, 215)
    posters.quilt(canvas, rng, 0, 0.12 * width, 0.1 * height, 0.3 * width, 0.28 * height)
    canvas.rectangle(0.6 * width, 0.65 * height, 0.25 * width, 0.2 * height, 40)
    return canvas


SIDES: dict[str, Callable[[np.random.Generator, float, float], Canvas]] = {
    "cardboard": _cardboard,
    "crate": _crate,
    "cabinet": _cabinet,
    "books": _books,
}
