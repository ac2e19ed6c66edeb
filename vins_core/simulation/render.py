"""Images of a world through a real camera model: one ray a pixel, filtered textures, smooth silhouettes.

A pixel's footprint on a face is an ellipse: `distance x pixel angle` across, and longer by 1 / cos(incidence) along
the line of sight.  It is filtered by a few taps along that line in a mip-map (Williams 1983; anisotropic probing as
McCormack et al. 1999, Feline).  Pixels on the edge of a face are split into sub-rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.camera import CameraModel
from .world import World, hits

TAPS = 3  # along the long axis of the footprint
SUBRAYS = 4  # per side of an edge pixel
SHARPNESS = 0.7  # texture filter width in pixels; below 0.5 corners would flicker


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
        T = np.broadcast_to(T_w_c, (self.shape[0], 4, 4)) if T_w_c.ndim == 2 else T_w_c
        R, origin = T[:, :3, :3].astype(np.float32), T[:, :3, 3]
        moving = T_w_c.ndim == 3
        rays = np.einsum("rij,rcj->rci", R, self._rays) if moving else self._rays @ R[0].T
        rays = rays.reshape(-1, 3)
        start = np.repeat(origin, self.shape[1], 0) if moving else origin[0]
        surface, distance = hits(self.world, start, rays)
        grey = self._atlas.shade(start, rays, surface, distance, self._pixel_rad.ravel())
        edge = np.flatnonzero(_is_edge(surface.reshape(self.shape)).ravel())
        grey[edge] = self._split(R, origin, edge)
        return grey.reshape(self.shape) * self._vignette

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


@dataclass(frozen=True)
class Atlas:
    """The mip-maps of all textures in one flat array, so that any set of rays is shaded in one go."""

    texels: np.ndarray  # flat uint8
    offset: np.ndarray  # (surfaces, levels) of each level's first texel
    shape: np.ndarray  # (surfaces, levels, 2) rows, columns
    texels_per_m: np.ndarray  # (surfaces, 2) at level 0, along right and down
    frame: np.ndarray  # (surfaces, 2, 4): right and down axis, and minus its product with the origin

    @staticmethod
    def of(world: World) -> Atlas:
        surfaces, textures = world.surfaces(), world.textures()
        pyramids = [_mip_map(texture) for texture in textures]
        levels = max(len(p) for p in pyramids)
        pyramids = [p + [p[-1]] * (levels - len(p)) for p in pyramids]
        flat = [level for pyramid in pyramids for level in pyramid]
        offset = np.concatenate([[0], np.cumsum([level.size for level in flat])[:-1]])
        axes = np.stack([surfaces.right_w, surfaces.down_w], 1)
        shift = -np.einsum("sij,sj->si", axes, surfaces.origin_w)
        size_px = np.array([t.shape[::-1] for t in textures])
        return Atlas(
            np.concatenate([level.ravel() for level in flat]),
            offset.reshape(len(textures), levels),
            np.array([level.shape for level in flat]).reshape(len(textures), levels, 2),
            (size_px / surfaces.size_m).astype(np.float32),
            np.concatenate([axes, shift[..., None]], -1).astype(np.float32),
        )

    def shade(
        self, origin_w: np.ndarray, rays_w: np.ndarray, surface: np.ndarray, distance: np.ndarray, pixel_rad: np.ndarray
    ) -> np.ndarray:
        """Filtered grey values (n,) where rays meet surfaces; `pixel_rad` is the angle a pixel covers."""
        frame = self.frame[surface]  # (n, 2, 4)
        slope = np.einsum("nij,nj->ni", frame[..., :3], rays_w)  # ray along right and down
        point = (origin_w + distance[:, None] * rays_w).astype(np.float32)
        place = np.einsum("nij,nj->ni", frame[..., :3], point) + frame[..., 3]  # metres from the top left
        grazing = np.sqrt(np.minimum((slope**2).sum(1), 0.9999))
        across = SHARPNESS * distance * pixel_rad  # metres
        along = across / np.sqrt(1.0 - grazing**2)
        scale = self.texels_per_m[surface]
        width = np.maximum(across, along / TAPS) * scale[:, 0]
        level = np.log2(np.maximum(width, 1.0))
        stride = slope * (along / TAPS / np.maximum(grazing, 1e-6))[:, None]
        grey = np.zeros(len(rays_w), np.float32)
        for tap in range(TAPS):
            at = (place + (tap - (TAPS - 1) / 2) * stride) * scale
            grey += self._trilinear(surface, at, level)
        return grey / TAPS

    def _trilinear(self, surface: np.ndarray, at: np.ndarray, level: np.ndarray) -> np.ndarray:
        low = np.minimum(level.astype(np.intp), self.offset.shape[1] - 1)
        high = np.minimum(low + 1, self.offset.shape[1] - 1)
        share = level - low
        return (1 - share) * self._bilinear(surface, at, low) + share * self._bilinear(surface, at, high)

    def _bilinear(self, surface: np.ndarray, at: np.ndarray, level: np.ndarray) -> np.ndarray:
        """Texel centres of level l lie at (i + 0.5) 2^l texels of level 0."""
        rows, columns = self.shape[surface, level].T
        x, y = (at * np.exp2(-level.astype(np.float32))[:, None] - 0.5).T
        x, y = np.clip(x, 0, columns - 1.001), np.clip(y, 0, rows - 1.001)
        column, row = x.astype(np.intp), y.astype(np.intp)
        x, y = x - column, y - row
        first = self.offset[surface, level] + row * columns + column
        right, below = np.minimum(1, columns - 1), np.minimum(1, rows - 1) * columns
        texels = self.texels
        top = (1 - x) * texels[first] + x * texels[first + right]
        bottom = (1 - x) * texels[first + below] + x * texels[first + below + right]
        return ((1 - y) * top + y * bottom).astype(np.float32)


def _mip_map(texture: np.ndarray) -> list[np.ndarray]:
    """Halved by averaging 2x2 texels until one side would be uneven or below 8."""
    levels = [np.ascontiguousarray(texture, np.uint8)]
    while min(levels[-1].shape) >= 8 and not any(n % 2 for n in levels[-1].shape):
        a = levels[-1].astype(np.uint16)
        levels.append(((a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2] + 2) // 4).astype(np.uint8))
    return levels
