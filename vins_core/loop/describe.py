"""Points of an image and their binary descriptors: what places are recognised by (REFERENCE L5, seed 004.24).

A descriptor is 256 brightness comparisons around a point, 32 bytes; two of them are compared by Hamming distance.
Three kinds exist, each with a name that vocabularies refer to.  They differ in how a point is found and turned:

    orb-upright    FAST corners at one scale, ORB's comparisons, not rotated: the default
    orb            FAST corners at eight scales, ORB's comparisons, turned to the direction of the corner
    brief          FAST corners at one scale, BRIEF (Calonder 2010) with VINS' comparisons, from its pattern file
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Protocol

import cv2
import numpy as np

from ..errors import CalibrationError, VocabularyError
from ..io.yaml_file import read_yaml

BYTES = 32
"""Bytes of a descriptor."""
FAST_THRESHOLDS = (40, 20, 10, 5)
"""Contrast asked of a corner, in grey levels: lowered until there are enough corners."""
CELL_PX = 32
"""Corners are spread over the image by taking the strongest of every cell, then the second strongest, and so on."""
TAKEN_PX = 4
"""Corners nearer than this to a tracked one are the same corner."""


@dataclass(frozen=True)
class Features:
    """Described points of one image."""

    uv_px: np.ndarray  # (n, 2) float32
    descriptors: np.ndarray  # (n, 32) uint8

    def __len__(self) -> int:
        return len(self.uv_px)


class Describer(Protocol):
    """Finds and describes the points of an image.  `name` is what a vocabulary must have been made for."""

    name: ClassVar[str]

    def __call__(
        self, image: np.ndarray, tracked_uv_px: np.ndarray, max_corners: int, usable: np.ndarray | None = None
    ) -> Features:
        """The tracked points (n, 2), first and in their order, and up to `max_corners` FAST corners.

        `image` (rows, columns) uint8; `usable` 255 where corners may lie, None for everywhere.
        """
        ...


@dataclass(frozen=True)
class UprightOrb:
    """ORB's learned comparisons (Rublee 2011), not rotated: a vehicle or a head seldom rolls."""

    name: ClassVar[str] = "orb-upright"

    def __call__(
        self, image: np.ndarray, tracked_uv_px: np.ndarray, max_corners: int, usable: np.ndarray | None = None
    ) -> Features:
        uv_px = np.concatenate([_as_points(tracked_uv_px), fast_corners(image, max_corners, tracked_uv_px, usable)])
        return Features(uv_px, _orb_at(image, uv_px, np.zeros(len(uv_px)), np.zeros(len(uv_px), int), levels=1))


@dataclass(frozen=True)
class OrientedOrb:
    """ORB as ORB-SLAM uses it, for its vocabulary: an image pyramid, and each patch turned to its own direction."""

    name: ClassVar[str] = "orb"
    levels: ClassVar[int] = 8

    def __call__(
        self, image: np.ndarray, tracked_uv_px: np.ndarray, max_corners: int, usable: np.ndarray | None = None
    ) -> Features:
        tracked = _as_points(tracked_uv_px)
        finder = cv2.ORB.create(nfeatures=max_corners, nlevels=self.levels, edgeThreshold=0, fastThreshold=10)
        found = finder.detect(image, _free_area(image, tracked, usable)) if max_corners else ()
        uv_px = np.concatenate([tracked, _as_points(cv2.KeyPoint.convert(found))])
        angles = np.concatenate([patch_angles_deg(image, tracked), [k.angle for k in found]])
        octaves = np.concatenate([np.zeros(len(tracked), int), [k.octave for k in found]]).astype(int)
        return Features(uv_px, _orb_at(image, uv_px, angles, octaves, self.levels))


@dataclass(frozen=True)
class Brief:
    """BRIEF: bit i is I(p + a_i) < I(p + b_i) in an image smoothed by a Gaussian (9x9, sigma 2).

    Comparisons that leave the image give 0.  The order of bits is that of DBoW2 (bit i is bit i % 8 of byte i // 8).
    """

    name: ClassVar[str] = "brief"
    offsets: np.ndarray = field(repr=False)  # (256, 2, 2) int: comparison, end, (x, y)

    def __call__(
        self, image: np.ndarray, tracked_uv_px: np.ndarray, max_corners: int, usable: np.ndarray | None = None
    ) -> Features:
        uv_px = np.concatenate([_as_points(tracked_uv_px), fast_corners(image, max_corners, tracked_uv_px, usable)])
        smooth = cv2.GaussianBlur(image, (9, 9), 2.0, sigmaY=2.0)
        x, y = (
            (uv_px[:, axis, None] + self.offsets[..., axis].ravel().astype(np.float32)).astype(np.int32)  # towards zero
            for axis in (0, 1)
        )
        rows, columns = image.shape
        inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
        grey = smooth.ravel().take(np.where(inside, y * columns + x, 0)).reshape(-1, 8 * BYTES, 2)
        inside = inside[:, 0::2] & inside[:, 1::2]
        return Features(uv_px, np.packbits((grey[..., 0] < grey[..., 1]) & inside, axis=1, bitorder="little"))


def read_brief(pattern: str | Path) -> Brief:
    """BRIEF with the comparisons of a pattern file, VINS' `brief_pattern.yml`: lists x1, y1, x2, y2 of 256 pixels.

    Raises VocabularyError when the file is something else.
    """
    path = Path(pattern)
    try:
        content = read_yaml(path)
    except CalibrationError as problem:
        raise VocabularyError(str(problem)) from None
    columns = []
    for key in ("x1", "y1", "x2", "y2"):
        values = content.get(key)
        if not isinstance(values, list) or len(values) != 8 * BYTES or not all(type(v) is int for v in values):
            raise VocabularyError(
                f"{path}: {key} is not a list of {8 * BYTES} whole numbers; expected VINS' brief_pattern.yml with x1, "
                "y1, x2 and y2"
            )
        if max(map(abs, values)) > 255:
            raise VocabularyError(f"{path}: {key} holds {max(values, key=abs)}; offsets stay within 255 pixels")
        columns.append(values)
    return Brief(np.array(columns, np.int16).T.reshape(-1, 2, 2))


def describer_named(name: str, brief_pattern: str | Path | None = None) -> Describer:
    """The describer that a vocabulary asks for by name; raises VocabularyError when it cannot be made."""
    if name == UprightOrb.name:
        return UprightOrb()
    if name == OrientedOrb.name:
        return OrientedOrb()
    if name == Brief.name:
        if brief_pattern is None:
            raise VocabularyError(
                "descriptor 'brief' needs the pattern file its vocabulary was trained with: VINS ships "
                "brief_pattern.yml beside brief_k10L6.bin"
            )
        return read_brief(brief_pattern)
    raise VocabularyError(
        f"unknown descriptor {name!r}; expected {UprightOrb.name}, {OrientedOrb.name} or {Brief.name}"
    )


def fast_corners(image: np.ndarray, n: int, taken_uv_px: np.ndarray, usable: np.ndarray | None = None) -> np.ndarray:
    """Up to n FAST corners (k, 2) float32, spread over the image, away from points already taken.

    The contrast asked for starts high, so that a textured image costs little, and falls until there are n of them.
    """
    if n <= 0:
        return np.zeros((0, 2), np.float32)
    area = _free_area(image, taken_uv_px, usable)
    found: Sequence[cv2.KeyPoint] = ()
    for threshold in FAST_THRESHOLDS:
        found = cv2.FastFeatureDetector.create(threshold).detect(image, area)
        if len(found) >= n:
            break
    uv_px = _as_points(cv2.KeyPoint.convert(found))
    return uv_px[spread(uv_px, np.array([k.response for k in found]), n)]


def spread(uv_px: np.ndarray, strength: np.ndarray, n: int) -> np.ndarray:
    """Rows of up to n points: the strongest of every cell, then the second strongest of every cell, and so on."""
    cell = (uv_px // CELL_PX).astype(np.int64) @ [1, 1 << 16]
    order = np.lexsort((-strength, cell))
    new_cell = np.diff(cell[order], prepend=-1) != 0
    first = np.flatnonzero(new_cell)
    rank = np.arange(len(order)) - first[np.cumsum(new_cell) - 1] if len(order) else order
    return order[np.lexsort((-strength[order], rank))[:n]]


def patch_angles_deg(image: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
    """(n,) direction from each point to the intensity centroid of the disc of radius 15 around it (Rosin 1999)."""
    radius = 15
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    u, v = u[disc := u * u + v * v <= radius * radius], v[disc]
    padded = cv2.copyMakeBorder(image, radius, radius, radius, radius, cv2.BORDER_REFLECT_101)
    center = np.rint(uv_px).astype(int) + radius
    grey = padded[center[:, 1, None] + v, center[:, 0, None] + u].astype(np.int64)
    return np.degrees(np.arctan2(grey @ v, grey @ u)) % 360.0


def _free_area(image: np.ndarray, taken_uv_px: np.ndarray, usable: np.ndarray | None) -> np.ndarray:
    area = np.full(image.shape, 255, np.uint8) if usable is None else usable.copy()
    for u, v in np.rint(taken_uv_px).astype(int).tolist():
        cv2.circle(area, (u, v), TAKEN_PX, 0, cv2.FILLED)
    return area


def _orb_at(
    image: np.ndarray, uv_px: np.ndarray, angles_deg: np.ndarray, octaves: np.ndarray, levels: int
) -> np.ndarray:
    """ORB descriptors at given points; the border is mirrored, so that every point has one."""
    points = [
        cv2.KeyPoint(u, v, 31.0, angle, 0.0, octave, row)
        for row, ((u, v), angle, octave) in enumerate(zip(uv_px.tolist(), angles_deg.tolist(), octaves.tolist()))
    ]
    out = np.zeros((len(points), BYTES), np.uint8)
    if points:
        kept, described = cv2.ORB.create(nlevels=levels, edgeThreshold=0).compute(image, points)
        out[[p.class_id for p in kept]] = described
    return out


def _as_points(uv_px: np.ndarray | Sequence[Sequence[float]]) -> np.ndarray:
    return np.asarray(uv_px, np.float32).reshape(-1, 2)
