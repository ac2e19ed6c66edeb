"""The front end on a page: follow every image, and at the frame reject, spread and refill (REFERENCE 2)."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from ..params import Frontend
from ..report import Gate, LossReason, TrackReport
from ..sensors import CameraCalibration, ImageRef, ImageSource, Packet
from ..window.state import Observations
from .detect import detect_corners, keep_spaced
from .images import check_size, equalized, usable_area
from .ledger import FATES, KEPT, TrackLedger
from .predict import turn_between, turn_pixels
from .reject import epipolar_inliers
from .state import TrackerState
from .stereo import match
from .track import follow


def track(
    params: Frontend,
    camera: CameraCalibration,
    images: ImageSource,
    state: TrackerState,
    packet: Packet,
    rejected: Mapping[LossReason, Collection[int]] | None = None,
    right: CameraCalibration | None = None,
) -> tuple[TrackerState, Observations, TrackReport]:
    """Carry the tracks through the images of a packet; the last image is the frame the estimator gets.

    Tracks in `rejected`, by what the estimator found wrong with them, are dropped (REFERENCE TF8).  A gap longer than
    `max_gap_s`, or time that does not advance, drops every track and fails the deciding gate "image interval"; ids are
    never given twice.  With a second camera, `right`, the tracks of the frame are looked for in its image as well
    (stereo.py).  Raises CalibrationError when image or mask do not have the camera's size.
    """
    usable = usable_area(camera)
    tracks = TrackLedger(state)
    for reason, ids in (rejected or {}).items():
        tracks.drop(np.isin(tracks.ids, list(ids)), reason)
    gates = _follow_images(params, camera, images, tracks, packet)
    if params.f_ransac:
        gates.append(_reject(params, camera, tracks))
    tracks.drop(~keep_spaced(tracks.uv_px, params.min_dist, usable), LossReason.MASK)
    n_old = len(tracks)
    frame = equalized(images, packet.image, params)
    corners_px = detect_corners(frame, params.max_cnt - n_old, tracks.uv_px, params, usable)
    tracks.add(corners_px, camera.model.lift(corners_px))
    gates.append(Gate("tracks", len(tracks), ">=", params.min_tracks, "frontend.min_tracks", decides=False))
    observations = tracks.observations(params.min_track_count)
    report = TrackReport(
        tracks.ids, tracks.uv_px, tracks.age, tracks.velocity, *tracks.lost(), len(tracks) - n_old, tuple(gates)
    )
    if right is None:
        return tracks.state_at_frame(), observations, report
    matches = match(params, (camera, right), images, tracks, state, packet.pairs[-1])
    seen = matches.observations(tracks.ids)
    observations = replace(observations, right=seen.among(observations.ids))
    report = replace(
        report,
        gates=(*report.gates, matches.gate(params)),
        right_uv_px=matches.reported_px(),
        right_loss=matches.fate,
    )
    return tracks.state_at_frame(seen), observations, report


def _follow_images(
    params: Frontend, camera: CameraCalibration, images: ImageSource, tracks: TrackLedger, packet: Packet
) -> list[Gate]:
    """Move the tracks from image to image, or start over where time makes that impossible."""
    n, intervals_s = len(tracks), []
    for ref, _ in packet.pairs:
        check_size(equalized(images, ref, params), camera, ref)
        if tracks.image is not None:
            dt_s = (ref.t_ns - tracks.image.t_ns) * 1e-9
            intervals_s.append(dt_s)
            if not 0 < dt_s <= params.max_gap_s:
                n = 0
                tracks.drop(np.ones(len(tracks), bool), LossReason.RESET)
        if len(tracks):
            _follow_image(params, camera, images, tracks, ref, packet)
        tracks.image = ref

    flow, back, border = (tracks.count_lost(r) for r in (LossReason.FLOW, LossReason.FLOW_BACK, LossReason.BORDER))
    gates = [_share("flow found", n - flow, n, params.min_flow_share, "min_flow_share")]
    if intervals_s:
        longest_s = max(intervals_s) if min(intervals_s) > 0 else None
        gates.insert(0, Gate("image interval", longest_s, "<=", params.max_gap_s, "frontend.max_gap_s", "s"))
    if params.flow_back:
        found = n - flow - border
        gates.append(_share("flow-back agrees", found - back, found, params.min_flow_back_share, "min_flow_back_share"))
    return gates


def _follow_image(
    params: Frontend,
    camera: CameraCalibration,
    images: ImageSource,
    tracks: TrackLedger,
    ref: ImageRef,
    packet: Packet,
) -> None:
    """Tracks found again in `ref` are one image older."""
    assert tracks.image is not None
    guess_px = None
    if params.predict != "off" and len(packet.imu):
        td_ns = int(packet.imu.t_ns[-1]) - packet.t_ns  # the last sample is at the frame
        turn = turn_between(packet.imu, tracks.image.t_ns + td_ns, ref.t_ns + td_ns)
        guess_px = turn_pixels(camera, turn, tracks.rays, tracks.uv_px)
    previous, current = (equalized(images, image, params) for image in (tracks.image, ref))
    uv_px, fate = follow(previous, current, tracks.uv_px, params, guess_px)
    rays = camera.model.lift(uv_px)
    fate[(fate == KEPT) & ~np.isfinite(rays).all(1)] = FATES[LossReason.BORDER]  # the lens shows nothing there
    tracks.end(fate)
    tracks.move(ref, uv_px[fate == KEPT], rays[fate == KEPT])


def _reject(params: Frontend, camera: CameraCalibration, tracks: TrackLedger) -> Gate:
    """Epipolar RANSAC between the last frame and this one, over the tracks that were in both."""
    both = np.flatnonzero(np.isfinite(tracks.frame_uv_px).all(1))
    before = camera.model.lift(tracks.frame_uv_px[both])
    inlier = epipolar_inliers(before, tracks.rays[both], params)
    n_tested, n_inliers = 0, 0
    if inlier is not None:
        n_tested, n_inliers = len(inlier), int(inlier.sum())
        outlier = np.zeros(len(tracks), bool)
        outlier[both[~inlier]] = True
        tracks.drop(outlier, LossReason.RANSAC)
    return _share("F-RANSAC inliers", n_inliers, n_tested, params.min_inlier_share, "min_inlier_share")


def _share(name: str, n: int, of: int, limit: float, knob: str) -> Gate:
    return Gate(name, n / of if of else None, ">=", limit, f"frontend.{knob}", decides=False)
