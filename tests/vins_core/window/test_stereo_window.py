"""What a window makes of two cameras outside of its solve: depths, keyframes, what leaves."""

from dataclasses import replace

import numpy as np
import synthetic_stereo as ss
import synthetic_window as sw

from vins_core.geometry import se3, so3
from vins_core.params import Params
from vins_core.window import landmarks
from vins_core.window.assemble import gather_tracks
from vins_core.window.keyframe import decide
from vins_core.window.slide import drop_oldest, restrict
from vins_core.window.state import CANDIDATE, TRIANGULATED, Landmarks, Observations, WindowFrame, WindowState

PARAMS = Params()
IDENTITY, ZERO = np.array([1.0, 0, 0, 0]), np.zeros(3)


def without_depths(window: WindowState) -> WindowState:
    return replace(window, landmarks=restrict(Landmarks.empty(), window.frames))


def relative_errors(window: WindowState, truth: WindowState) -> np.ndarray:
    """Of the inverse depths that `window` has and `truth` knows for the same anchor."""
    known = np.isfinite(window.landmarks.inv_depth) & np.isin(window.landmarks.ids, truth.landmarks.ids)
    rows = np.searchsorted(truth.landmarks.ids, window.landmarks.ids[known])
    return window.landmarks.inv_depth[known] / truth.landmarks.inv_depth[rows] - 1


def test_a_pair_of_images_gives_depth_at_the_first_frame() -> None:
    truth = ss.make(0, pixel_sigma=0.0, right_sigma_px=0.0, n_tracks=150).truth
    first = without_depths(replace(truth, frames=truth.frames[:1]))
    triangulated = landmarks.triangulate(PARAMS.window, first)
    seen = first.frames[0].observations.right
    assert seen is not None
    has_depth = triangulated.landmarks.ids[triangulated.landmarks.status == TRIANGULATED]
    np.testing.assert_array_equal(has_depth, seen.ids)
    assert np.abs(relative_errors(triangulated, truth)).max() < 1e-6


def test_tracks_that_one_camera_sees_wait_for_parallax() -> None:
    truth = ss.make(0, share=0.0, n_tracks=150).truth
    triangulated = landmarks.triangulate(PARAMS.window, without_depths(replace(truth, frames=truth.frames[:1])))
    assert (triangulated.landmarks.status == CANDIDATE).all()


def test_what_a_pair_sees_beyond_infinity_is_far_away() -> None:
    """Rays that diverge by a pixel of noise: not at `init_depth`, from where no solve would bring it back."""
    toward = np.array([[0.0, 0.0, 1.0]])
    beyond = np.array([[1.0 / 460, 0.0, 1.0]]) / np.hypot(1.0, 1.0 / 460)
    ids, uv_px, velocity = np.array([7]), np.zeros((1, 2), np.float32), np.zeros((1, 2), np.float32)
    right = Observations(ids, beyond, uv_px, velocity)
    frame = WindowFrame(
        0, 0, True, Observations(ids, toward, uv_px, velocity, right), None, ZERO, IDENTITY, *[ZERO] * 3
    )
    T_c0_c1 = se3.from_rotation_translation(np.eye(3), np.array([0.1, 0.0, 0.0]))
    window = WindowState((frame,), restrict(Landmarks.empty(), (frame,)), None, np.stack([np.eye(4), T_c0_c1]), False)
    assert landmarks.triangulate(PARAMS.window, window).landmarks.inv_depth[0] == 1 / landmarks.FAR_M


def test_depths_move_with_the_anchor_when_the_oldest_frame_leaves() -> None:
    truth = ss.without_imu(ss.make(2, pixel_sigma=0.0, right_sigma_px=0.0, n_tracks=150).truth)
    slid = drop_oldest(truth)
    again = landmarks.triangulate(PARAMS.window, without_depths(slid))
    assert len(slid.landmarks) > 50 and not slid.inertial
    both = np.isfinite(again.landmarks.inv_depth) & np.isfinite(slid.landmarks.inv_depth)
    np.testing.assert_allclose(again.landmarks.inv_depth[both], slid.landmarks.inv_depth[both], rtol=1e-5)


def plane_frames(p: np.ndarray, q: np.ndarray) -> tuple[WindowFrame, ...]:
    """Three frames that see a plane 3 m ahead; the second one is at `p`, turned by `q`."""
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9), [3.0]), -1).reshape(-1, 3)
    frames = []
    for k, (p_k, q_k) in enumerate([(ZERO, IDENTITY), (p, q), (p, q)]):
        rays = so3.rotate(so3.inverse(q_k), grid - p_k)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        empty = np.zeros((len(rays), 2), np.float32)
        frames.append(
            WindowFrame(k, k, True, Observations(np.arange(len(rays)), rays, empty, empty), None, p_k, q_k, *[ZERO] * 3)
        )
    return tuple(frames)


def test_without_imu_the_estimated_rotation_tells_parallax_from_turning() -> None:
    """Rotation that is found from the images alone takes most of a sideways motion past a plane with it."""
    sideways = plane_frames(np.array([0.15, 0.0, 0.0]), IDENTITY)
    posed = decide(PARAMS.window, sideways, np.eye(3), gyro_is_calibrated=True, posed=True)
    aligned = decide(PARAMS.window, sideways, np.eye(3), gyro_is_calibrated=True)
    assert posed.is_keyframe and posed.parallax_px == posed.parallax_raw_px > 20
    assert aligned.parallax_px < 0.2 * posed.parallax_px
    turned = plane_frames(ZERO, so3.exp(np.array([0.0, 0.1, 0.02])))
    assert decide(PARAMS.window, turned, np.eye(3), gyro_is_calibrated=True, posed=True).parallax_px < 1e-6


def test_tracks_know_what_the_second_camera_sees() -> None:
    window = ss.make(1, n_tracks=60).window
    tracks = gather_tracks(window.frames)
    assert tracks.right is not None
    for slot, frame in enumerate(window.frames):
        o = frame.observations
        assert o.right is not None
        rows = np.flatnonzero(tracks.slots == slot)
        ids = tracks.ids[tracks.track[rows]]
        with_right = ~np.isnan(tracks.right[rows, 0])
        np.testing.assert_array_equal(np.sort(ids[with_right]), o.right.ids)
        order = np.argsort(ids[with_right])
        np.testing.assert_array_equal(tracks.right[rows][with_right][order], o.right.rays)
    assert gather_tracks(sw.make(1, n_tracks=60).window.frames).right is None
