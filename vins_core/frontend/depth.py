"""What a depth image that is registered to the camera's pixels says at each track.

Flow sees a whole patch, and steep pixels count most: where the depths z_p of its pixels differ, it follows

    1/z = sum_p |grad I_p|^2 / z_p  /  sum_p |grad I_p|^2

for a small motion, by the normal equations of Lucas and Kanade.  That is the depth read here, and not the one of the
pixel in the middle: corners sit on silhouettes, and the far side of a slanted patch, being compressed, is steeper, so
that the middle is nearer than what is followed, and a camera that trusts it moves too little (docs/depth.md).  A patch
whose depths vary by more than `frontend.depth_max_variation`, because of an edge or a slant, says nothing at all.

Every reason why there is no depth is a gate that the record can answer again (`gates`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..errors import CalibrationError
from ..params import Frontend
from ..report import DEPTH_LOSSES, DepthLoss, Gate, TrackReport
from ..sensors import CameraCalibration, DepthCalibration, DepthSource, ImageSource, Packet
from ..window.state import Observations
from .images import equalized
from .ledger import KEPT
from .state import TrackerState

FATES = {loss: np.uint8(i) for i, loss in enumerate(DEPTH_LOSSES)}
Tracked = tuple[TrackerState, Observations, TrackReport]


@dataclass(frozen=True)
class Reading:
    """Depths at n tracks."""

    depth_m: np.ndarray  # (n,) float32 that flow sees in the patch, NaN where too few pixels have one
    variation: np.ndarray  # (n,) float32 by which a tenth of its pixels differ from their median, as a share
    share: np.ndarray  # (n,) float32 of the patch's pixels that have a depth
    fate: np.ndarray  # (n,) uint8, KEPT or an index into DEPTH_LOSSES


def measure(
    params: Frontend, camera: CameraCalibration, images: ImageSource, packet: Packet, tracked: Tracked
) -> Tracked:
    """`tracked` with the depths that the image of the frame has; none where that image is missing.

    Raises CalibrationError when it has not the size of the camera's images, RecordingError when it cannot be read.
    """
    tracker, observations, report = tracked
    sensor, ref = camera.depth, packet.depth
    assert sensor is not None and isinstance(images, DepthSource)
    depth_m = None if ref is None else images.load_depth(ref, sensor.scale_m)
    size = (camera.model.height, camera.model.width)
    if depth_m is not None and depth_m.shape != size:
        raise CalibrationError(
            f"the depth image of {sensor.topic or camera.name} at {ref.t_ns if ref else 0} ns has {depth_m.shape[1]}x"
            f"{depth_m.shape[0]} pixels, its camera {size[1]}x{size[0]}; expected depth registered to the camera's "
            "pixels: record the aligned depth topic, or use mode mono_imu"
        )
    image = None if depth_m is None else equalized(images, packet.image, params)
    reading = read(params, sensor, depth_m, image, report.uv_px)
    found = float((reading.fate == KEPT).mean()) if len(report.ids) else None
    gate = Gate("depth found", found, ">=", params.min_depth_share, "frontend.min_depth_share", decides=False)
    report = replace(
        report,
        gates=(*report.gates, gate),
        depth_m=reading.depth_m,
        depth_variation=reading.variation,
        depth_share=reading.share,
        depth_loss=reading.fate,
    )
    rows = np.searchsorted(report.ids, observations.ids)
    return tracker, replace(observations, depth_m=report.usable_depth_m[rows]), report


def read(
    params: Frontend, sensor: DepthCalibration, depth_m: np.ndarray | None, image: np.ndarray | None, uv_px: np.ndarray
) -> Reading:
    """Depths at `uv_px` (n, 2) of a depth image (rows, columns) in metres, NaN where it has none; None: no image.

    `image`: the grey image as flow sees it.
    """
    n, unknown = len(uv_px), np.full(len(uv_px), np.nan, np.float32)
    if depth_m is None or image is None or not n:
        none = np.full(n, FATES[DepthLoss.NO_IMAGE], np.uint8)
        return Reading(unknown, unknown, np.zeros(n, np.float32), none)
    half = params.klt_window // 2
    patch = _patches(depth_m, uv_px, half).astype(float)
    share = np.mean(~np.isnan(patch), 1)
    depth, variation = np.full(n, np.nan), np.full(n, np.nan)
    enough = np.flatnonzero((share >= params.depth_min_patch_share) & (share > 0))
    if len(enough):
        steepness = _patches(_steepness(image), uv_px[enough], half)
        depth[enough], variation[enough] = _of_flow(patch[enough], steepness), _variation(patch[enough])

    fate = np.full(n, KEPT, np.uint8)
    fate[variation > params.depth_max_variation] = FATES[DepthLoss.EDGE]
    fate[depth > sensor.max_m] = FATES[DepthLoss.FAR]
    fate[depth < sensor.min_m] = FATES[DepthLoss.NEAR]
    fate[np.isnan(depth)] = FATES[DepthLoss.MISSING]
    return Reading(depth.astype(np.float32), variation.astype(np.float32), share.astype(np.float32), fate)


def _steepness(image: np.ndarray) -> np.ndarray:
    """(rows, columns) float32, squared gradient: the weight of a pixel in Lucas and Kanade's normal equations."""
    return cv2.Scharr(image, cv2.CV_32F, 1, 0) ** 2 + cv2.Scharr(image, cv2.CV_32F, 0, 1) ** 2


def _of_flow(patch: np.ndarray, steepness: np.ndarray) -> np.ndarray:
    """Depth (n,) whose parallax flow sees in patches (n, pixels); a little of all pixels where there is no texture."""
    weight = np.where(np.isnan(patch) | np.isnan(steepness), 0.0, steepness + 1.0)
    inverse = 1.0 / np.where(weight > 0, patch, 1.0)
    return weight.sum(1) / np.maximum((weight * inverse).sum(1), 1e-12)


def _variation(patch: np.ndarray) -> np.ndarray:
    """How far at least a tenth of the pixels of patches (n, pixels) are from the median, as a share of it (n,)."""
    return np.nanquantile(np.abs(np.nanmedian(patch, 1, keepdims=True) / patch - 1.0), 0.9, axis=1)


def gates(params: Frontend, sensor: DepthCalibration, report: TrackReport, row: int) -> tuple[Gate, ...]:
    """The gates that the depth of one track met, from the record alone."""
    if report.depth_loss[row] == FATES[DepthLoss.NO_IMAGE]:
        return (Gate("depth image", 0, ">=", 1),)
    depth_m, variation, share = (
        None if np.isnan(value) else float(value)
        for value in (report.depth_m[row], report.depth_variation[row], report.depth_share[row])
    )
    return (
        Gate("pixels with depth", share, ">=", params.depth_min_patch_share, "frontend.depth_min_patch_share"),
        Gate("nearest depth", depth_m, ">=", sensor.min_m, unit="m"),
        Gate("farthest depth", depth_m, "<=", sensor.max_m, unit="m"),
        Gate("depths around the track", variation, "<=", params.depth_max_variation, "frontend.depth_max_variation"),
    )


def _patches(image: np.ndarray, uv_px: np.ndarray, half: int) -> np.ndarray:
    """(n, patch pixels) around the nearest pixels, NaN outside of the image."""
    rows, columns = image.shape
    offset = np.arange(-half, half + 1)
    u, v = np.rint(uv_px.astype(float)).astype(np.int64).T
    u, v = u[:, None, None] + offset[None, None, :], v[:, None, None] + offset[None, :, None]
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    found = image[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)]
    return np.where(inside, found, np.float32(np.nan)).reshape(len(uv_px), -1)
