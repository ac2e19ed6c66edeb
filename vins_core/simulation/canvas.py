"""Drawing on a face in metres: x to the right, y down from the top left, grey 0-255, edges anti-aliased."""

from __future__ import annotations

import cv2
import numpy as np

TEXELS_PER_M = 192.0
BLOCK = 32  # sides are multiples of it, so that the mip-map halves evenly
_SHIFT = 4  # OpenCV's fixed-point bits

Point = tuple[float, float]


class Canvas:
    def __init__(self, width_m: float, height_m: float, grey: float):
        columns, rows = (max(BLOCK, BLOCK * round(side * TEXELS_PER_M / BLOCK)) for side in (width_m, height_m))
        self.width_m, self.height_m = width_m, height_m
        self._scale = np.array([columns / width_m, rows / height_m])
        self.pixels = np.full((rows, columns), grey, np.uint8)

    def polygon(self, points: list[Point] | np.ndarray, grey: float) -> None:
        cv2.fillPoly(self.pixels, [self._fixed(points)], int(grey), cv2.LINE_AA, _SHIFT)

    def rectangle(self, x: float, y: float, width: float, height: float, grey: float) -> None:
        self.polygon([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], grey)

    def circle(self, x: float, y: float, radius: float, grey: float) -> None:
        angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        self.polygon(np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], -1), grey)

    def line(self, points: list[Point] | np.ndarray, width: float, grey: float) -> None:
        thickness = max(1, round(width * self._scale[0]))
        cv2.polylines(self.pixels, [self._fixed(points)], False, int(grey), thickness, cv2.LINE_AA, _SHIFT)

    def text(self, words: str, x: float, y: float, height: float, grey: float, fit_width: float | None = None) -> None:
        """`words` with cap height `height` and baseline at y, made smaller where they exceed `fit_width`."""
        face, unit = cv2.FONT_HERSHEY_SIMPLEX, 21.0  # cap height in pixels at font scale 1
        size = height * self._scale[1] / unit
        thickness = max(1, round(height * self._scale[1] / 7))
        (length, _), _ = cv2.getTextSize(words, face, size, thickness)
        if fit_width is not None and length > fit_width * self._scale[0]:
            size *= fit_width * self._scale[0] / length
            thickness = max(1, round(size * unit / 7))
        at = (round(x * self._scale[0]), round(y * self._scale[1]))
        cv2.putText(self.pixels, words, at, face, size, int(grey), thickness, cv2.LINE_AA)

    def mottle(self, rng: np.random.Generator, amplitude: float, grain_m: float) -> None:
        """Smooth random shades, e.g. of plaster or paper."""
        cells = (max(2, round(self.height_m / grain_m)), max(2, round(self.width_m / grain_m)))
        self.shade(1.0 + rng.standard_normal(cells, np.float32) * (amplitude / 128.0), cv2.INTER_CUBIC)

    def shade(self, light: np.ndarray | float, between: int = cv2.INTER_LINEAR) -> None:
        """Multiply by a number, or by a field of light over the whole face that may be coarser than the texels."""
        if np.ndim(light):
            rows, columns = self.pixels.shape
            light = cv2.resize(np.asarray(light, np.float32), (columns, rows), interpolation=between)
        self.pixels = cv2.convertScaleAbs(np.maximum(self.pixels * np.float32(light), 0))

    def grid_m(self, step: int = 8) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates x (1, n) and y (m, 1) for a field of light with one value for every `step` texels."""
        rows, columns = (side // step for side in self.pixels.shape)
        return (
            ((np.arange(columns) + 0.5) / columns * self.width_m)[None],
            ((np.arange(rows) + 0.5) / rows * self.height_m)[:, None],
        )

    def _fixed(self, points: list[Point] | np.ndarray) -> np.ndarray:
        """OpenCV counts from pixel centres."""
        return np.round((np.asarray(points, float) * self._scale - 0.5) * (1 << _SHIFT)).astype(np.int32)
