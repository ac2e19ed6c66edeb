"""The scene: a room seen from inside and boxes seen from outside, every face a textured rectangle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FACES = ("-x", "+x", "-y", "+y", "-z", "+z")


@dataclass(frozen=True)
class Solid:
    """A box standing upright, turned by `yaw_rad`; textures are as a viewer sees them, upright and unmirrored."""

    centre_w_m: np.ndarray  # (3,)
    size_m: np.ndarray  # (3,)
    textures: tuple[np.ndarray, ...]  # one (rows, columns) uint8 a face, in the order of FACES
    yaw_rad: float = 0.0
    hollow: bool = False  # a room: seen from inside

    @property
    def R_w_s(self) -> np.ndarray:
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Surfaces:
    """All faces as arrays.  A point p on face i has texture coordinates (p - origin[i]) . right[i], ... . down[i]."""

    origin_w: np.ndarray  # (m, 3) the texture's top left corner
    right_w: np.ndarray  # (m, 3) unit
    down_w: np.ndarray  # (m, 3) unit
    size_m: np.ndarray  # (m, 2) along right and down

    def point(self, surface: int, right_m: float, down_m: float) -> np.ndarray:
        """(3,) world point of a place on a face."""
        return self.origin_w[surface] + right_m * self.right_w[surface] + down_m * self.down_w[surface]


@dataclass(frozen=True)
class World:
    room: Solid
    boxes: tuple[Solid, ...]

    @property
    def solids(self) -> tuple[Solid, ...]:
        return (self.room, *self.boxes)

    def surfaces(self) -> Surfaces:
        """Face f of solid s is surface 6 s + f."""
        rows = [_face(solid, axis, side) for solid in self.solids for axis in range(3) for side in (-1, 1)]
        return Surfaces(*(np.array(column) for column in zip(*rows)))

    def textures(self) -> list[np.ndarray]:
        return [texture for solid in self.solids for texture in solid.textures]


def _face(solid: Solid, axis: int, side: int) -> tuple[np.ndarray, ...]:
    normal = np.eye(3)[axis] * side * (-1 if solid.hollow else 1)  # towards the viewer
    up = np.eye(3)[2] if axis < 2 else np.eye(3)[1]
    right = np.cross(up, normal)
    size = np.array([np.abs(right) @ solid.size_m, np.abs(up) @ solid.size_m])
    centre = np.eye(3)[axis] * side * solid.size_m[axis] / 2
    corner = centre - right * size[0] / 2 + up * size[1] / 2
    R = solid.R_w_s
    return solid.centre_w_m + R @ corner, R @ right, R @ -up, size


def hits(world: World, origin_w: np.ndarray, rays_w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest surface along unit rays (n, 3) from `origin_w` ((3,) or one a ray): index (n,), distance (n,) m."""
    rays_w = np.asfortranarray(rays_w)  # sweeps over x, y and z are several times faster on columns
    _, leave, forward = _slabs(world.room, origin_w, rays_w)
    axis, distance = np.argmin(leave, 0), leave.min(0)
    surface = 2 * axis + _pick(forward, axis)
    for number, (box, near) in enumerate(zip(world.boxes, _towards(world.boxes, origin_w, rays_w)), 1):
        if len(near) == 0:
            continue
        start = origin_w if np.ndim(origin_w) == 1 else origin_w[near]
        enter, leave, forward = _slabs(box, start, np.asfortranarray(rays_w[near]))
        axis, reach = np.argmax(enter, 0), enter.max(0)
        seen = (reach > 0) & (reach < leave.min(0)) & (reach < distance[near])
        surface[near[seen]] = (6 * number + 2 * axis + ~_pick(forward, axis))[seen]
        distance[near[seen]] = reach[seen]
    return surface, distance


def _slabs(solid: Solid, origin_w: np.ndarray, rays_w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances to where rays enter and leave the three pairs of parallel planes, and whether they run along +axis.

    All (3, n), by the axes of the solid.  Source: Kay and Kajiya 1986, the slab method.
    """
    R_s_w = solid.R_w_s.T
    rays = R_s_w.astype(rays_w.dtype) @ rays_w.T
    start = (R_s_w @ np.reshape(origin_w - solid.centre_w_m, (-1, 3)).T).astype(rays.dtype)
    inverse = 1 / np.where(np.abs(rays) < 1e-9, np.float32(1e-9), rays)
    middle, half = -start * inverse, (solid.size_m[:, None] / 2).astype(rays.dtype) * np.abs(inverse)
    return middle - half, middle + half, inverse > 0


def _pick(rows: np.ndarray, which: np.ndarray) -> np.ndarray:
    """rows[which[i], i]"""
    return np.take_along_axis(rows, which[None], 0)[0]


def _towards(boxes: tuple[Solid, ...], origin_w: np.ndarray, rays_w: np.ndarray) -> list[np.ndarray]:
    """For each box the rows of the rays that pass the sphere around it, with a margin for a moving viewpoint."""
    viewpoint = np.reshape(origin_w, (-1, 3)).mean(0)
    offset = np.array([box.centre_w_m for box in boxes]).reshape(-1, 3) - viewpoint
    distance = np.linalg.norm(offset, axis=1)
    sine = np.array([np.linalg.norm(box.size_m) / 2 + 0.05 for box in boxes]) / distance
    least = np.where(sine < 1, np.sqrt(np.maximum(1 - sine**2, 0)), -1.0)
    cosine = (offset / distance[:, None]).astype(rays_w.dtype) @ rays_w.T
    return [np.flatnonzero(row >= limit) for row, limit in zip(cosine, least.astype(rays_w.dtype))]
