"""KITTI raw data in the layout in which it is downloaded."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from vins_core.errors import CalibrationError, RecordingError
from vins_core.geometry import se3, so3
from vins_core.io.calibration import read_calibration
from vins_core.io.kitti import KittiRecording
from vins_core.io.modes import inspect_modes
from vins_core.io.recording import open_recording
from vins_core.io.sync import packets
from vins_core.io.trajectory import read_trajectory
from vins_core.params import Params

N, THERE = 12, 8  # lines of timestamps.txt, and images that are there
T0 = 1_317_042_504_900_000_000  # 2011-09-26 13:08:24.9 UTC
LATITUDE, LONGITUDE = 49.0, 8.4
BASELINE = 0.54


def row(values: np.ndarray) -> str:
    return " ".join(f"{v:.12e}" for v in np.ravel(values))


def stamp(t_ns: int) -> str:
    seconds = np.datetime64(t_ns // 10**9, "s").astype(str).replace("T", " ")
    return f"{seconds}.{t_ns % 10**9:09d}"


@pytest.fixture
def day(tmp_path: Path) -> Path:
    """A drive to the north at 1 m a frame, heading 90 degrees from east."""
    root = tmp_path / "2011_09_26"
    drive = root / "2011_09_26_drive_0042_sync"
    for name, late_ns in (("image_00", 0), ("image_01", 1_000_000), ("oxts", -5_000_000)):
        (drive / name / "data").mkdir(parents=True)
        lines = [stamp(T0 + k * 100_000_000 + late_ns) for k in range(N)]
        (drive / name / "timestamps.txt").write_text("\n".join(lines) + "\n")
    for k in range(N):
        values = np.zeros(30)
        values[:3] = LATITUDE + k / 111_200.0, LONGITUDE, 110.0
        values[3:6] = 0.01, -0.02, np.pi / 2
        values[6:9] = 10.0, 0.1, 10.0  # north, east, forward
        values[11:14], values[17:20] = (0.1, 0.2, 9.8), (0.01, 0.02, 0.03)
        values[23] = 0.05
        (drive / "oxts" / "data" / f"{k:010d}.txt").write_text(row(values))
        for name in ("image_00", "image_01"):
            if k < THERE:
                cv2.imwrite(str(drive / name / "data" / f"{k:010d}.png"), np.full((48, 64), 10 * k, np.uint8))
    P = np.array([[70.0, 0, 31.0, 0], [0, 70.0, 23.0, 0], [0, 0, 1, 0]])
    P_right = P.copy()
    P_right[0, 3] = -70.0 * BASELINE
    R_rect = so3.to_matrix(so3.exp(np.array([0.01, -0.02, 0.03])))
    (root / "calib_cam_to_cam.txt").write_text(
        f"calib_time: 09-Jan-2012 13:57:47\nR_rect_00: {row(R_rect)}\n"
        + "".join(f"S_rect_0{i}: 64 48\nP_rect_0{i}: {row(p)}\n" for i, p in enumerate((P, P_right)))
    )
    forward = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # x right, y down, z forward
    (root / "calib_velo_to_cam.txt").write_text(f"R: {row(forward)}\nT: 0 -0.08 -0.27\n")
    (root / "calib_imu_to_velo.txt").write_text(f"R: {row(np.eye(3))}\nT: -0.81 0.32 -0.8\n")
    return tmp_path


@pytest.mark.parametrize("inside", ["", "2011_09_26", "2011_09_26/2011_09_26_drive_0042_sync"])
def test_a_drive_is_found_from_above(day: Path, inside: str) -> None:
    recording = open_recording(day / inside)
    assert recording.kind == "kitti"
    assert {s.topic: s.count for s in recording.streams} == {
        "/image_00": THERE,
        "/image_01": THERE,
        "/oxts/imu": N,
        "/oxts/gps": N,
        "/oxts/pose": N,
    }
    assert recording.stream("/image_00").first_ns == T0


def test_two_drives_are_not_one(day: Path) -> None:
    other = day / "2011_09_26" / "2011_09_26_drive_0043_sync" / "image_00"
    other.mkdir(parents=True)
    (other / "timestamps.txt").write_text("")
    with pytest.raises(RecordingError, match=r"2 KITTI drives; open one of them: 2011_09_26_drive_0042_sync, 2011_09"):
        open_recording(day)


def test_stamps_keep_their_nanoseconds(day: Path) -> None:
    recording = open_recording(day)
    assert [ref.t_ns for ref in recording.images()] == [T0 + k * 100_000_000 for k in range(THERE)]


def test_oxts_is_imu_gps_and_truth(day: Path) -> None:
    recording = open_recording(day)
    imu, fixes, truth = recording.imu(), recording.gps(), recording.truth()
    assert imu.t_ns[0] == T0 - 5_000_000 and imu.accel_m_s2[3].tolist() == [0.1, 0.2, 9.8]
    assert imu.gyro_rad_s[3].tolist() == [0.01, 0.02, 0.03]
    assert (
        fixes[2].latitude_deg == pytest.approx(LATITUDE + 2 / 111_200.0, abs=1e-10)
        and fixes[2].covariance_enu_m2[0, 0] == 0.05**2
    )
    assert truth is not None and truth.v_w_b is not None
    np.testing.assert_allclose(truth.p_w_b[5], [0.0, 5.0, 0.0], atol=0.01)
    np.testing.assert_allclose(truth.v_w_b[5], [0.1, 10.0, 0.0], atol=1e-12)
    forward = so3.rotate(truth.q_w_b[5], np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(forward, [0.0, np.cos(0.02), np.sin(0.02)], atol=1e-12)  # negative pitch looks up


def test_the_folder_brings_its_calibration(day: Path) -> None:
    recording = open_recording(day)
    found = read_calibration([], recording).calibration
    left, right = found.cameras
    assert not found.has_imu and (left.topic, right.topic) == ("/image_00", "/image_01")
    assert (left.model.width, left.model.height) == (64, 48)
    baseline = se3.inverse(left.T_b_c) @ right.T_b_c
    np.testing.assert_allclose(
        baseline, se3.from_rotation_translation(np.eye(3), np.array([BASELINE, 0, 0])), atol=1e-12
    )
    ahead = left.T_b_c[:3, :3] @ [0, 0, 1]
    np.testing.assert_allclose(ahead, [1, 0, 0], atol=0.05)
    assert left.T_b_c[0, 3] == pytest.approx(0.81 + 0.27, abs=0.05), "the cameras stand in front of the unit"


def test_packets_hold_pairs_and_fixes(day: Path) -> None:
    recording = open_recording(day)
    calibration = read_calibration([], recording).calibration
    found = list(packets(recording, calibration, Params()))
    pairs = [pair for packet in found for pair in packet.pairs]
    assert len(pairs) == THERE and all(right is not None and right.index == left.index for left, right in pairs)
    assert sum(len(packet.gps) for packet in found) == THERE - 1, "the first comes before the first image"
    assert not any(packet.anomalies for packet in found)
    assert recording.load(pairs[3][1]).mean() == 30  # type: ignore[arg-type]


def test_the_imu_of_a_synced_drive_is_too_slow_and_stereo_is_not(day: Path) -> None:
    recording = open_recording(day)
    calibration = read_calibration([], recording).calibration
    found = {m.mode: m for m in inspect_modes(recording, calibration)}
    assert found["stereo"].missing == () and found["stereo"].gps
    assert found["stereo_imu"].missing == ("an IMU of 50 Hz or more (it comes at 10 Hz)",)


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("2011_09_26_drive_0042_sync/image_00/timestamps.txt", "13:08:24.9\n", r"line 1: expected a stamp like 2011"),
        (
            "2011_09_26_drive_0042_sync/oxts/data/0000000003.txt",
            "49.0 8.4",
            r"0003.txt: expected 30 numbers .* found 2",
        ),
        ("2011_09_26_drive_0042_sync/oxts/data/0000000003.txt", "x " * 30, r"0003.txt: expected 30 numbers .* found 0"),
    ],
)
def test_a_damaged_file_is_told(day: Path, file: str, content: str, said: str) -> None:
    (day / "2011_09_26" / file).write_text(content)
    with pytest.raises(RecordingError, match=said):
        open_recording(day).imu()


def test_a_drive_without_its_calibration_says_what_is_missing(day: Path) -> None:
    velo = day / "2011_09_26" / "calib_velo_to_cam.txt"
    velo.write_text("T: 0 0 0\n")
    with pytest.raises(CalibrationError, match=r"calib_velo_to_cam.txt: key R: expected 9 numbers"):
        read_calibration([], open_recording(day))
    velo.unlink()
    with pytest.raises(CalibrationError, match=r"calib_velo_to_cam.txt: missing, so this drive has no calibration"):
        read_calibration([], open_recording(day))


@pytest.mark.skipif("VINS_DATA" not in os.environ, reason="VINS_DATA is not set")
def test_a_real_drive() -> None:
    folder = Path(os.environ["VINS_DATA"]) / "kitti_0009"
    recording = open_recording(folder)
    assert isinstance(recording, KittiRecording)
    truth, known = recording.truth(), read_trajectory(folder / "truth.csv")
    assert truth is not None and np.array_equal(truth.t_ns, known.t_ns)
    np.testing.assert_allclose(truth.q_w_b, known.q_w_b, atol=1e-8)
    travelled = np.linalg.norm(np.diff(known.p_w_b, axis=0), axis=1).sum()
    assert np.abs(truth.p_w_b - known.p_w_b).max() < 2e-3 * travelled, "Mercator and WGS 84 differ by a thousandth"
    found = list(packets(recording, read_calibration([], recording).calibration, Params()))
    assert len(found) == 50 and all(right is not None for p in found for _, right in p.pairs)
