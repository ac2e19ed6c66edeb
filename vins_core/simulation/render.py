"""Images of a world through a real camera model: one ray a pixel, filtered textures, smooth silhouettes."""

from __future__ import annotations

import numpy as np

from ..geometry.camera import CameraModel
from .atlas import Atlas
from .world import World, hits

SUBRAYS = 3  # per side of a pixel on the edge of a face


class Renderer:
    """Holds what does not change between images: rays of the camera, mip-maps of the world."""

    def __init__(self, world: World, camera: CameraModel):
        self.world = world
        self.shape = (camera.height, camera.width)
        v, u = np.mgrid[: camera.height, : camera.width].astype(float)
        rays = camera.lift(np.stack([u.ravel(), v.ravel()], -1)).reshape(camera.height, camera.width, 3)
        self._inside = np.isfinite(rays).all(-1)
        rays = np.where(self._inside[..., None], rays, np.array([0.0, 0.0, 1.0]))
        self._rays = rays.astype(np.float32)
        self._step_v, self._step_u = (np.asarray(step) for step in np.gradient(self._rays, axis=(0, 1)))
        self._pixel_rad = np.sqrt(
            np.maximum(np.linalg.norm(np.cross(self._step_u, self._step_v), axis=-1), 1e-8)
        ).astype(np.float32)
        self._vignette = (1.0 - 0.4 * (1.0 - self._rays[..., 2] ** 2)) * self._inside
        self._atlas = Atlas.of(world)

    def render(self, T_w_c: np.ndarray) -> np.ndarray:
        """(rows, columns) float32 grey values 0-255.  `T_w_c` is (4, 4), or (rows, 4, 4) for a rolling shutter."""
        T = np.broadcast_to(T_w_c, (self.shape[0], 4, 4))
        R, origin = T[:, :3, :3].astype(np.float32), T[:, :3, 3]
        if T_w_c.ndim == 2:
            rays, start = self._rays @ R[0].T, origin[0]
        else:
            rays, start = np.einsum("rij,rcj->rci", R, self._rays), np.repeat(origin, self.shape[1], 0)
        rays = rays.reshape(-1, 3)
        surface, distance = hits(self.world, start, rays)
        grey = self._atlas.shade(start, rays, surface, distance, self._pixel_rad.ravel())
        edge = np.flatnonzero(_is_edge(surface.reshape(self.shape)).ravel())
        grey[edge] = self._split(R, origin, edge)
        return grey.reshape(self.shape) * self._vignette

    def depth_m(self, T_w_c: np.ndarray) -> np.ndarray:
        """(rows, columns) float32: depth along the optical axis of what each pixel shows, NaN where it shows nothing.

        `T_w_c` is (4, 4).  Behind the image plane the depth is negative.
        """
        rays = self._rays.reshape(-1, 3)
        _, distance = hits(self.world, T_w_c[:3, 3], rays @ T_w_c[:3, :3].T.astype(np.float32))
        return np.where(self._inside, (distance * rays[:, 2]).reshape(self.shape), np.nan).astype(np.float32)

    def _split(self, R: np.ndarray, origin: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Mean of SUBRAYS^2 rays for each of the given flat pixel indices."""
        offsets = (np.arange(SUBRAYS, dtype=np.float32) + 0.5) / SUBRAYS - 0.5
        dv, du = (d.reshape(-1, 1, 1) for d in np.meshgrid(offsets, offsets, indexing="ij"))
        centre, step_u, step_v = (a.reshape(-1, 3)[pixels] for a in (self._rays, self._step_u, self._step_v))
        rays = centre + du * step_u + dv * step_v  # (SUBRAYS^2, pixels, 3)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        row = pixels // self.shape[1]
        rays = np.einsum("pij,spj->spi", R[row], rays).reshape(-1, 3)
        start = np.tile(origin[row], (SUBRAYS**2, 1))
        surface, distance = hits(self.world, start, rays)
        pixel_rad = np.tile(self._pixel_rad.ravel()[pixels], SUBRAYS**2)
        return self._atlas.shade(start, rays, surface, distance, pixel_rad).reshape(SUBRAYS**2, -1).mean(0)


def _is_edge(surface: np.ndarray) -> np.ndarray:
    """Pixels with a neighbour on another face."""
    edge = np.zeros(surface.shape, bool)
    across, along = surface[:, 1:] != surface[:, :-1], surface[1:] != surface[:-1]
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= along
    edge[:-1] |= along
    return edge
