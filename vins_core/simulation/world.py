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
    surface, distance = _leave(world.room, origin_w, rays_w)
    viewpoint = np.reshape(origin_w, (-1, 3)).mean(0)
    for number, box in enumerate(world.boxes, 1):
        near = _towards(box, viewpoint, rays_w)
        if len(near) == 0:
            continue
        start = origin_w if np.ndim(origin_w) == 1 else origin_w[near]
        face, reach = _enter(box, start, rays_w[near])
        closer = reach < distance[near]
        surface[near[closer]] = 6 * number + face[closer]
        distance[near[closer]] = reach[closer]
    return surface, distance


def _slabs(solid: Solid, origin_w: np.ndarray, rays_w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances along the rays to where they enter and leave the three pairs of parallel planes, each (n, 3)."""
    R = solid.R_w_s.astype(rays_w.dtype)
    rays = rays_w @ R
    start = ((origin_w - solid.centre_w_m) @ solid.R_w_s).astype(rays.dtype)
    inverse = 1.0 / np.where(np.abs(rays) < 1e-9, np.copysign(np.float32(1e-9), rays), rays)
    middle, half = -start * inverse, (solid.size_m / 2).astype(rays.dtype) * np.abs(inverse)
    return middle - half, middle + half


def _leave(room: Solid, origin_w: np.ndarray, rays_w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays from inside meet the walls: face number and distance."""
    _, leave = _slabs(room, origin_w, rays_w)
    axis = np.argmin(leave, 1)
    rows = np.arange(len(axis))
    along = rays_w @ room.R_w_s.astype(rays_w.dtype)
    return 2 * axis + (along[rows, axis] > 0), leave[rows, axis]


def _enter(box: Solid, origin_w: np.ndarray, rays_w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays from outside meet a box: face number and distance, infinite where they miss."""
    enter, leave = _slabs(box, origin_w, rays_w)
    axis = np.argmax(enter, 1)
    rows = np.arange(len(axis))
    reach = enter[rows, axis]
    along = rays_w @ box.R_w_s.astype(rays_w.dtype)
    missed = (reach >= leave.min(1)) | (reach <= 0)
    return 2 * axis + (along[rows, axis] < 0), np.where(missed, np.inf, reach).astype(rays_w.dtype)


def _towards(box: Solid, viewpoint_w: np.ndarray, rays_w: np.ndarray) -> np.ndarray:
    """Rows of the rays that pass the sphere around the box (with a margin for moving viewpoints)."""
    offset = box.centre_w_m - viewpoint_w
    distance, radius = np.linalg.norm(offset), np.linalg.norm(box.size_m) / 2 + 0.05
    if distance <= radius:
        return np.arange(len(rays_w))
    cosine = np.sqrt(1.0 - (radius / distance) ** 2)
    return np.flatnonzero(rays_w @ (offset / distance).astype(rays_w.dtype) >= cosine)
