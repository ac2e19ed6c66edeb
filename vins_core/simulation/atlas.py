"""All textures with their mip-maps in one image, so that any set of rays is shaded in a few look-ups.

A pixel's footprint on a face is an ellipse: `distance x pixel angle` across, and longer by 1 / cos(incidence) along
the line of sight.  It is filtered by a few taps along that line in a mip-map (Williams 1983, Pyramidal parametrics;
anisotropic probing as in McCormack et al. 1999, Feline).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .world import World

TAPS = 3  # along the long axis of the footprint
SHARPNESS = 0.7  # width of the filter in pixels; below 0.5 corners would flicker
WIDTH_PX = 4096  # of the atlas, at least


@dataclass(frozen=True)
class Atlas:
    image: np.ndarray  # (rows, columns) uint8
    corner: np.ndarray  # (2, surfaces, levels) x, y of each level's top left texel
    size: np.ndarray  # (2, surfaces, levels) columns, rows
    top: np.ndarray  # (surfaces,) the coarsest level; what follows it is padding
    texels_per_m: np.ndarray  # (surfaces, 2) at level 0, along right and down
    origin_w: np.ndarray  # (surfaces, 3)
    axes_w: np.ndarray  # (surfaces, 2, 3) right and down

    @staticmethod
    def of(world: World) -> Atlas:
        surfaces = world.surfaces()
        pyramids = [_mip_map(texture) for texture in world.textures()]
        top = np.array([len(p) - 1 for p in pyramids])
        pyramids = [p + [p[-1]] * (top.max() + 1 - len(p)) for p in pyramids]
        size = np.array([[level.shape[::-1] for level in p] for p in pyramids])
        image, corner = _pack([level for p in pyramids for level in p])
        return Atlas(
            image,
            np.moveaxis(corner.reshape(size.shape), -1, 0).astype(np.float32),
            np.moveaxis(size, -1, 0).astype(np.float32),
            top,
            (size[:, 0] / surfaces.size_m).astype(np.float32),
            surfaces.origin_w,
            np.stack([surfaces.right_w, surfaces.down_w], 1),
        )

    def shade(
        self, origin_w: np.ndarray, rays_w: np.ndarray, surface: np.ndarray, distance: np.ndarray, pixel_rad: np.ndarray
    ) -> np.ndarray:
        """Filtered grey values (n,) float32 where rays (n, 3) from `origin_w` ((3,) or one a ray) meet surfaces (n,).

        `pixel_rad` (n,) is the angle a pixel covers.
        """
        scale = self.texels_per_m[surface].T
        start = self._start(origin_w, surface)  # metres from the top left, (2, n)
        slope = self._along_axes(rays_w, surface)
        place = start + distance * slope
        sine = np.sqrt(np.minimum(slope[0] ** 2 + slope[1] ** 2, np.float32(0.9999)))
        across = SHARPNESS * distance * pixel_rad  # metres
        along = across / np.sqrt(1 - sine**2)
        width = np.maximum(across, along / TAPS) * scale[0]
        level = np.log2(np.maximum(width, 1))
        step = slope * (along / (TAPS * np.maximum(sine, np.float32(1e-6)))) * scale
        first = place * scale - step * np.float32((TAPS - 1) / 2)
        low = np.minimum(level.astype(np.intp), self.top[surface])
        high = np.minimum(low + 1, self.top[surface])
        share = np.minimum(level - low, 1)
        return (1 - share) * self._probe(surface, low, first, step) + share * self._probe(surface, high, first, step)

    def _start(self, origin_w: np.ndarray, surface: np.ndarray) -> np.ndarray:
        if np.ndim(origin_w) == 1:
            return np.einsum("sij,sj->is", self.axes_w, origin_w - self.origin_w).astype(np.float32)[:, surface]
        offset = origin_w - self.origin_w[surface]
        return np.einsum("nij,nj->in", self.axes_w[surface], offset).astype(np.float32)

    def _along_axes(self, rays_w: np.ndarray, surface: np.ndarray) -> np.ndarray:
        x, y, z = rays_w.T
        table = np.ascontiguousarray(np.moveaxis(self.axes_w, 0, -1), np.float32)  # (2, 3, surfaces)
        return np.stack([a[surface] * x + b[surface] * y + c[surface] * z for a, b, c in table])

    def _probe(self, surface: np.ndarray, level: np.ndarray, first: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Mean of TAPS bilinear look-ups.  Texel centres of level l lie at (i + 0.5) 2^l texels of level 0."""
        shrink = np.exp2(-level.astype(np.float32))
        corner, last = self.corner[:, surface, level], self.size[:, surface, level] - 1
        at, step = first * shrink - np.float32(0.5), step * shrink
        total = np.zeros(len(surface), np.float32)
        for tap in range(TAPS):
            total += _bilinear(self.image, corner + np.clip(at + np.float32(tap) * step, 0, last))
        return total / TAPS


def _bilinear(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (n,) at x, y (2, n); OpenCV wants its maps as rectangles of limited size."""
    count, columns = at.shape[1], 1024
    maps = np.zeros((2, -(-count // columns) * columns), np.float32)
    maps[:, :count] = at
    x, y = maps.reshape(2, -1, columns)
    return cv2.remap(image, x, y, cv2.INTER_LINEAR).ravel()[:count]


def _mip_map(texture: np.ndarray) -> list[np.ndarray]:
    """Halved by averaging 2x2 texels until one side would be uneven or below 8."""
    levels = [np.ascontiguousarray(texture, np.uint8)]
    while min(levels[-1].shape) >= 8 and not any(n % 2 for n in levels[-1].shape):
        a = levels[-1].astype(np.uint16)
        levels.append(((a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2] + 2) // 4).astype(np.uint8))
    return levels


def _pack(tiles: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Tiles side by side on shelves, the highest first: the image and the corners (tiles, 2) x, y."""
    width = max(WIDTH_PX, *(tile.shape[1] for tile in tiles))
    corner = np.zeros((len(tiles), 2), np.intp)
    x = y = shelf = 0
    for index in sorted(range(len(tiles)), key=lambda i: -tiles[i].shape[0]):
        rows, columns = tiles[index].shape
        if x + columns > width:
            x, y, shelf = 0, y + shelf, 0
        corner[index], x, shelf = (x, y), x + columns, max(shelf, rows)
    image = np.zeros((y + shelf, width), np.uint8)
    for (x, y), tile in zip(corner, tiles):
        image[y : y + tile.shape[0], x : x + tile.shape[1]] = tile
    return image, corner
