"""Two cameras begin: with IMU from a full window, without from a single frame."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_stereo as ss
import synthetic_window as sw

from vins_core.geometry import se3, so3
from vins_core.geometry.pinhole_radtan import PinholeRadtan
from vins_core.initialization.stereo import begin, initialize
from vins_core.params import Params
from vins_core.sensors import Calibration, CameraCalibration
from vins_core.window.locate import locate
from vins_core.window.slide import restrict
from vins_core.window.state import Landmarks, WindowState

MODEL = PinholeRadtan(640, 480, 460.0, 460.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0)
CALIBRATION = Calibration(
    (CameraCalibration("cam0", MODEL, sw.T_B_C), CameraCalibration("cam1", MODEL, sw.T_B_C @ ss.T_C0_C1)),
    sw.NOISE,
    sw.GRAVITY,
)
PARAMS = Params()


def unknown(window: WindowState) -> WindowState:
    """The same measurements, and nothing estimated."""
    zero, identity = np.zeros(3), np.array([1.0, 0, 0, 0])
    frames = tuple(replace(f, p_w_b=zero, q_w_b=identity, v_w_b=zero, b_a=zero, b_g=zero) for f in window.frames)
    return replace(window, frames=frames, landmarks=restrict(Landmarks.empty(), frames), prior=None)


def relative(window: WindowState) -> np.ndarray:
    Ts = ss.poses_of(window.frames)
    return se3.inverse(Ts[0]) @ Ts


@pytest.mark.parametrize("seed", range(3))
def test_a_window_with_imu_is_metric_upright_and_moves_as_it_did(seed: int) -> None:
    flight = ss.make(seed, n_tracks=150)
    window, report = initialize(PARAMS, CALIBRATION, unknown(flight.window))
    assert window is not None and report.succeeded, report.stages[-1].outcome
    ours, truth = relative(window), relative(flight.truth)
    length = np.linalg.norm(truth[-1, :3, 3])
    assert np.linalg.norm(ours[-1, :3, 3] - truth[-1, :3, 3]) < 0.03 * length
    for frame, true in zip(window.frames, flight.truth.frames):
        up, true_up = (so3.rotate(so3.inverse(q), np.array([0, 0, 1.0])) for q in (frame.q_w_b, true.q_w_b))
        assert np.rad2deg(np.arccos(min(up @ true_up, 1.0))) < 1.5
        speeds = [so3.rotate(so3.inverse(f.q_w_b), f.v_w_b) for f in (frame, true)]
        assert np.linalg.norm(speeds[0] - speeds[1]) < 0.15
    np.testing.assert_allclose(report.b_g, sw.B_G, atol=3e-3)
    assert window.prior is not None and window.inertial


def test_standing_still_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """One camera needs acceleration to find its scale; two do not."""
    tilt = so3.exp(np.array([0.1, -0.2, 0.3]))
    monkeypatch.setattr(sw, "position", lambda t: np.zeros((*np.shape(t), 3)))
    monkeypatch.setattr(sw, "attitude", lambda t: np.broadcast_to(tilt, (*np.shape(t), 4)).copy())
    flight = ss.make(0, n_tracks=150)
    window, report = initialize(PARAMS, CALIBRATION, unknown(flight.window))
    assert window is not None, report.stages[-1].outcome
    stages = [stage.name for stage in report.stages]
    assert stages == ["intervals", "frames", "structure", "gyroscope bias", "alignment", "gravity", "refinement"]
    assert max(np.linalg.norm(f.v_w_b) for f in window.frames) < 0.05
    assert np.linalg.norm(relative(window)[:, :3, 3], axis=1).max() < 0.02


def test_cameras_in_the_wrong_order_are_refused() -> None:
    flight = ss.make(1, n_tracks=150)
    swapped = replace(unknown(flight.window), T_b_c=flight.window.T_b_c[::-1].copy())
    window, report = initialize(PARAMS, CALIBRATION, swapped)
    assert window is None and not report.succeeded and report.stages[-1].outcome


def test_a_wrong_imu_is_refused_by_gravity() -> None:
    """An accelerometer in units of g."""
    flight = ss.make(2, n_tracks=150)
    frames = tuple(
        f
        if f.imu is None
        else replace(f, imu=replace(f.imu, imu=replace(f.imu.imu, accel_m_s2=f.imu.imu.accel_m_s2 / 9.81)))
        for f in unknown(flight.window).frames
    )
    raw = replace(unknown(flight.window), frames=frames)
    window, report = initialize(PARAMS, CALIBRATION, raw)
    assert window is None and any(not g.passed for g in report.stages[-1].gates)


def test_without_imu_the_first_pair_of_images_is_the_world() -> None:
    flight = ss.make(0, n_tracks=300, longest_track=30)
    blank = unknown(ss.without_imu(flight.window))
    first = replace(blank, frames=blank.frames[:1], landmarks=restrict(Landmarks.empty(), blank.frames[:1]))
    window, report = begin(PARAMS, first)
    assert window is not None and report.succeeded
    up_in_image = so3.rotate(window.frames[0].q_w_b, -sw.T_B_C[:3, 1])
    np.testing.assert_allclose(up_in_image, [0, 0, 1], atol=1e-9)
    assert abs(so3.heading(window.frames[0].q_w_b)) < 1e-9
    true = flight.truth.landmarks
    near = np.isfinite(window.landmarks.inv_depth) & np.isin(window.landmarks.ids, true.ids)
    ratio = window.landmarks.inv_depth[near] / true.inv_depth[np.searchsorted(true.ids, window.landmarks.ids[near])]
    assert abs(np.median(ratio) - 1) < 0.03


def test_without_landmarks_by_both_cameras_nothing_begins() -> None:
    blank = unknown(ss.without_imu(ss.make(0, share=0.02).window))
    first = replace(blank, frames=blank.frames[:1], landmarks=restrict(Landmarks.empty(), blank.frames[:1]))
    window, report = begin(PARAMS, first)
    assert window is None and "seen by both cameras" in report.stages[-1].outcome


def test_the_newest_frame_is_located_by_the_landmarks_it_sees() -> None:
    flight = ss.make(4, n_tracks=200)
    *before, newest = flight.truth.frames
    lost = replace(newest, p_w_b=np.zeros(3), q_w_b=np.array([1.0, 0, 0, 0]))
    window, gate = locate(PARAMS, replace(flight.truth, frames=(*before, lost)))
    assert gate.passed
    found = window.frames[-1]
    assert np.linalg.norm(found.p_w_b - newest.p_w_b) < 0.02
    assert np.rad2deg(np.linalg.norm(so3.difference(found.q_w_b, newest.q_w_b))) < 0.5


def test_where_nothing_is_seen_the_motion_goes_on() -> None:
    flight = ss.make(4, n_tracks=200)
    *before, newest = flight.truth.frames
    o = newest.observations
    blind = replace(newest, observations=replace(o, ids=o.ids + 10_000, right=None))
    window, gate = locate(PARAMS, replace(flight.truth, frames=(*before, blind)))
    assert not gate.passed
    a, b, c = before[-2], before[-1], window.frames[-1]
    np.testing.assert_allclose(c.p_w_b - b.p_w_b, b.p_w_b - a.p_w_b, atol=1e-9)
