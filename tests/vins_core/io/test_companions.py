"""Stereo pairs, depth images and GPS fixes find their way into the packet of their frame."""

import itertools
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from tiny_recording import CALIBRATION, CAMERA, T0, gps, images, imus, in_time_order, picture, recorded

from vins_core.errors import CalibrationError, RecordingError
from vins_core.geometry.camera import camera_from_dict, camera_to_dict
from vins_core.io.inspect import inspect
from vins_core.io.messages import GpsMessage, ImageMessage, Message
from vins_core.io.modes import inspect_modes, restrict
from vins_core.io.recording import Recording, open_recording
from vins_core.io.sync import packets
from vins_core.io.write import convert
from vins_core.params import Params
from vins_core.params import replace as with_params
from vins_core.sensors import NO_IMU, Calibration, CameraCalibration, DepthCalibration, DepthRef, Packet

MS = 1_000_000
RIGHT = CameraCalibration("cam1", CAMERA, CALIBRATION.cameras[0].T_b_c, "/cam1/image_raw")
STEREO = replace(CALIBRATION, cameras=(*CALIBRATION.cameras, RIGHT))
ALONE = replace(STEREO, has_imu=False, noise=NO_IMU, imu_topic="")
DEPTH = DepthCalibration("/depth", scale_m=0.001)
RGBD = replace(CALIBRATION, cameras=(replace(CALIBRATION.cameras[0], depth=DEPTH),))


def rights(late_ms: float = 0.0, without: tuple[int, ...] = ()) -> list[ImageMessage]:
    taken = enumerate(images(0, 2, topic="/cam1/image_raw"))
    return [replace(m, t_ns=m.t_ns + round(late_ms * MS)) for k, m in taken if k not in without]


def depths(rate_hz: float = 20.0, late_ms: float = 0.0) -> list[ImageMessage]:
    stamps = [T0 + round(k * 1e9 / rate_hz) + round(late_ms * MS) for k in range(round(2 * rate_hz) + 1)]
    return [ImageMessage(t, "/depth", "16UC1", picture(k, dtype=np.uint16)) for k, t in enumerate(stamps)]


def recording_of(tmp_path: Path, *parts: list, format: str = "mcap") -> Recording:
    messages: list[Message] = list(itertools.chain(*parts))
    return recorded(tmp_path, in_time_order(messages), format)


def frames(recording: Recording, calibration: Calibration, freq: float = 10.0, **span: float) -> list[Packet]:
    return list(packets(recording, calibration, with_params(Params(), {"frontend.freq": freq}), **span))


def said(found: list[Packet], kind: str) -> list[str]:
    return [a.message for p in found for a in p.anomalies if a.kind == kind]


# -- pairs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", ["asl", "ros1", "mcap"])
@pytest.mark.parametrize("late_ms", [0.0, 2.9, -2.9])
@pytest.mark.parametrize("calibration", [STEREO, ALONE], ids=["stereo_imu", "stereo"])
def test_every_image_is_followed_by_the_one_taken_with_it(
    tmp_path: Path, format: str, late_ms: float, calibration: Calibration
) -> None:
    recording = recording_of(tmp_path, imus(), images(0.1, 2), rights(late_ms), format=format)
    found = frames(recording, calibration)
    assert said(found, "unsynchronized") == []
    for packet in found:
        assert [ref.camera for ref in packet.images] == [0, 1] * (len(packet.images) // 2)
        for left, right in packet.pairs:
            assert right is not None and right.t_ns == left.t_ns + round(late_ms * MS)
        assert packet.t_ns == packet.pairs[-1][0].t_ns
    lefts = [left.index for packet in found for left, _ in packet.pairs]
    assert lefts == list(range(39))


def test_frames_are_the_same_with_and_without_a_second_camera(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, imus(), images(), rights(1.0), [gps(T0 + k * 10**8) for k in range(20)])
    for mono, stereo in zip(frames(recording, CALIBRATION), frames(recording, STEREO), strict=True):
        assert mono.images == tuple(left for left, _ in stereo.pairs)
        assert mono.imu.gyro_rad_s.tobytes() == stereo.imu.gyro_rad_s.tobytes()
        assert mono.imu.t_ns.tobytes() == stereo.imu.t_ns.tobytes() and mono.t_ns == stereo.t_ns


def test_without_imu_there_are_the_same_frames(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, imus(), images(), rights())
    with_imu, alone = frames(recording, STEREO), frames(recording, ALONE)
    assert [p.images for p in alone] == [p.images for p in with_imu]
    assert not any(len(p.imu) for p in alone)


def test_images_further_apart_than_3_ms_are_no_pair_and_told(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, imus(), images(), rights(3.1))
    found = frames(recording, STEREO)
    assert all(right is None for packet in found for _, right in packet.pairs)
    lonely = said(found, "unsynchronized")
    assert sum("image of /cam0/image_raw/compressed" in text for text in lonely) == 41
    assert "has none of /cam1/image_raw/compressed within 3 ms" in lonely[0]


def test_a_missing_right_image_is_told_and_its_left_one_kept(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, imus(), images(), rights(without=(7, 8)))
    found = frames(recording, STEREO)
    missing = [left.index for packet in found for left, right in packet.pairs if right is None]
    assert missing == [7, 8] and len(said(found, "unsynchronized")) == 2
    assert len(said(found, "dropped_image")) == 1


def test_the_time_offsets_of_both_cameras_count_for_their_pairing(tmp_path: Path) -> None:
    """Images taken together and stamped 8 ms apart, which the calibration knows."""
    recording = recording_of(tmp_path, imus(), images(0.1, 1.9), rights(8.0))
    found = frames(recording, replace(STEREO, td_s=0.010, cameras=(STEREO.cameras[0], replace(RIGHT, td_s=0.002))))
    assert said(found, "unsynchronized") == []
    assert all(right is not None for packet in found for _, right in packet.pairs)


def test_the_right_image_has_to_have_its_own_calibrated_size(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, imus(), images(), rights())
    other = replace(RIGHT, model=camera_from_dict(**(camera_to_dict(CAMERA) | {"width": 65})))
    with pytest.raises(CalibrationError, match=r"images of /cam1/image_raw/compressed are 64x48, .* for 65x48"):
        frames(recording, replace(STEREO, cameras=(STEREO.cameras[0], other)))


def test_info_tells_images_without_partner(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, imus(), images(), rights(1.0, without=(3,)))
    counts = inspect(recording, calibration=STEREO).counts
    assert (counts["unsynchronized"], counts["dropped_image"]) == (1, 1)
    assert "unsynchronized" not in inspect(recording).counts


# -- GPS -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", ["asl", "ros1", "mcap"])
@pytest.mark.parametrize("td_s", [0.0, 0.013])
def test_fixes_come_with_the_first_frame_at_or_after_them(tmp_path: Path, format: str, td_s: float) -> None:
    sent = [gps(T0 + k * 70 * MS + 1) for k in range(27)]
    recording = recording_of(tmp_path, imus(), images(), sent, format=format)
    found = frames(recording, replace(CALIBRATION, td_s=td_s))
    last = -(2**63)
    for packet in found:
        t_imu = packet.t_ns + round(td_s * 1e9)
        assert [fix.t_ns for fix in packet.gps] == [m.t_ns for m in sent if last < m.t_ns <= t_imu]
        last = t_imu
    fixes = [fix for packet in found for fix in packet.gps]
    for fix, message in zip(fixes, sent, strict=False):
        assert (fix.latitude_deg, fix.altitude_m, fix.status) == (
            message.latitude_deg,
            message.altitude_m,
            message.status,
        )
        assert fix.covariance_enu_m2.tobytes() == message.covariance_enu_m2.tobytes()


def test_a_place_that_is_no_number_is_told_unless_the_receiver_had_no_fix(tmp_path: Path) -> None:
    def broken(t_ns: int, status: int) -> GpsMessage:
        return replace(gps(t_ns), latitude_deg=float("nan"), status=status)

    sent = [broken(T0 + 500 * MS, 0), gps(T0 + 700 * MS), broken(T0 + 900 * MS, -1)]
    found = frames(recording_of(tmp_path, imus(), images(), sent), CALIBRATION)
    assert [fix.t_ns for packet in found for fix in packet.gps] == [T0 + 700 * MS]
    assert len(said(found, "nan")) == 1 and "/gps0 has a place that is no number" in said(found, "nan")[0]


def test_an_outage_is_a_gap(tmp_path: Path) -> None:
    sent = [gps(T0 + k * 50 * MS) for k in range(40) if not 12 < k < 25]
    found = frames(recording_of(tmp_path, imus(), images(), sent), CALIBRATION)
    assert len(said(found, "gap")) == 1 and said(found, "gap")[0].startswith("/gps0 is silent for 0.650 s")


# -- depth ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate_hz", "late_ms", "share"), [(20.0, 0.0, 1.0), (20.0, 9.0, 1.0), (10.0, 1.0, 0.5)])
def test_depth_comes_with_the_image_that_it_belongs_to(
    tmp_path: Path, rate_hz: float, late_ms: float, share: float
) -> None:
    recording = recording_of(tmp_path, imus(), images(), depths(rate_hz, late_ms), format="ros1")
    found = frames(recording, RGBD)
    pairs = [pair for packet in found for pair in zip(packet.images, packet.depths, strict=True)]
    assert np.mean([depth is not None for _, depth in pairs]) == pytest.approx(share, abs=0.03)
    assert {depth.t_ns - image.t_ns for image, depth in pairs if depth} == {round(late_ms * MS)}
    assert found[3].depth == found[3].depths[-1]
    assert said(found, "unsynchronized") == [], "depth may come more rarely than images"


def test_depth_is_read_only_when_the_calibration_asks_for_it(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, imus(), images(), depths())
    assert all(packet.depths == () for packet in frames(recording, restrict(RGBD, "mono_imu")))


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_depth_is_in_metres_and_unknown_where_the_camera_says_nothing(tmp_path: Path, kind: type) -> None:
    raw = np.full((48, 64), 1500, kind) if kind is np.uint16 else np.full((48, 64), 1.5, kind)
    raw[0, 0] = 0
    expected = np.full((48, 64), 1.5, np.float32)
    expected[0, 0] = np.nan
    if kind is np.float32:
        raw[0, 1], raw[0, 2] = np.inf, -1.0
        expected[0, 1:3] = np.nan
    format = "16UC1" if kind is np.uint16 else "32FC1"
    sent = [replace(m, format=format, data=raw) for m in depths()]
    recording = recording_of(tmp_path, imus(), images(), sent)
    ref = frames(recording, RGBD)[2].depth
    assert ref is not None
    np.testing.assert_allclose(recording.load_depth(ref, DEPTH.scale_m), expected, rtol=1e-6)


@pytest.mark.parametrize("named_by", ["nanoseconds", "seconds"])
def test_a_folder_of_depth_images_is_a_depth_camera(tmp_path: Path, named_by: str) -> None:
    """TUM's names are seconds with decimals, its unit is 0.2 mm."""
    path = recorded(tmp_path, [*imus(), *images()]).path
    folder = path / "mav0" / "depth0" / "data"
    folder.mkdir(parents=True)
    for image in images():
        name = str(image.t_ns) if named_by == "nanoseconds" else f"{image.t_ns // 10**9}.{image.t_ns % 10**9:09d}"
        cv2.imwrite(str(folder / f"{name}.png"), np.full((48, 64), 5000, np.uint16))
    depth = DepthCalibration(scale_m=1 / 5000)
    recording = open_recording(path)
    found = frames(recording, replace(RGBD, cameras=(replace(RGBD.cameras[0], depth=depth),)))
    ref = found[2].depth
    assert ref is not None and ref.t_ns == found[2].t_ns
    assert (recording.load_depth(ref, depth.scale_m) == np.float32(1.0)).all()


def test_a_colour_image_is_no_depth(tmp_path: Path) -> None:
    path = recorded(tmp_path, [*imus(), *images()]).path
    folder = path / "mav0" / "depth0" / "data"
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / f"{T0}.png"), np.zeros((48, 64, 3), np.uint8))
    recording = open_recording(path)
    ref = frames(recording, replace(RGBD, cameras=(replace(RGBD.cameras[0], depth=DepthCalibration()),)))[0].depths[0]
    assert ref is not None
    with pytest.raises(RecordingError, match=r"depth image of /depth0/image_raw .* cannot be read: expected 16UC1"):
        recording.load_depth(ref, 1e-3)


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
@pytest.mark.parametrize("format", ["asl", "ros1", "mcap"])
def test_depth_survives_conversion(tmp_path: Path, kind: type, format: str) -> None:
    raw = [np.random.default_rng(k).uniform(1, 5, (48, 64)).astype(np.float32) for k in range(3)]
    pixels = raw if kind is np.float32 else [(1000 * p).astype(np.uint16) for p in raw]
    name = "32FC1" if kind is np.float32 else "16UC1"
    sent = [ImageMessage(T0 + k * 50 * MS, "/depth0/image_raw", name, p) for k, p in enumerate(pixels)]
    first = recording_of(tmp_path, imus(), images(), sent, format=format)
    again = open_recording(
        convert(first, tmp_path / f"again{'.bag' if format == 'asl' else ''}", "ros1" if format == "asl" else "asl")
    )
    for recording in (first, again):
        recording.use(replace(RGBD, cameras=(replace(RGBD.cameras[0], depth=DepthCalibration(), topic=""),)))
        stubs = list(recording.scan([recording.depth_topic]))
        found = [recording.load_depth(DepthRef(s.t_ns, 0, k, s.locator), 0.001) for k, s in enumerate(stubs)]  # type: ignore[union-attr]
        expected = [p.astype(np.float32) * np.float32(1 if kind is np.float32 else 0.001) for p in pixels]
        np.testing.assert_array_equal(found, expected)


# -- modes ---------------------------------------------------------------------------------------------------------


def test_a_recording_with_everything_can_run_in_every_mode(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, imus(), images(), rights(), depths(), [gps(T0)])
    both = replace(STEREO, cameras=(RGBD.cameras[0], RIGHT))
    assert [(m.missing, m.gps) for m in inspect_modes(recording, both)] == [((), True)] * 4


@pytest.mark.parametrize(
    ("parts", "calibration", "mode", "missing"),
    [
        ([imus(), images()], None, "mono_imu", ("a calibration (--calib)",)),
        ([imus(), images()], STEREO, "stereo", ("images of a second camera",)),
        ([imus(), images(), rights()], CALIBRATION, "stereo_imu", ("a second camera in the calibration",)),
        ([images(), rights()], STEREO, "stereo_imu", ("an IMU",)),
        ([imus(), images(), rights()], ALONE, "stereo_imu", ("an IMU in the calibration",)),
        ([imus(0, 2, 10), images()], CALIBRATION, "mono_imu", ("an IMU of 50 Hz or more (it comes at 10 Hz)",)),
        ([imus(), images()], RGBD, "rgbd_imu", ("depth images",)),
        ([imus(), images(), depths()], CALIBRATION, "rgbd_imu", ("depth in the calibration",)),
        ([imus()], CALIBRATION, "mono_imu", ("images",)),
    ],
)
def test_what_a_mode_lacks_is_told(
    tmp_path: Path, parts: list, calibration: Calibration | None, mode: str, missing: tuple[str, ...]
) -> None:
    found = {m.mode: m.missing for m in inspect_modes(recording_of(tmp_path, *parts), calibration)}
    assert found[mode] == missing


def test_a_topic_that_the_calibration_names_and_the_recording_lacks_is_told(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, imus(), images(), rights())
    wrong = replace(STEREO, cameras=(STEREO.cameras[0], replace(RIGHT, topic="/other")))
    found = {m.mode: m.missing for m in inspect_modes(recording, wrong)}
    assert found["mono_imu"] == () and "there is no image topic /other" in found["stereo"][0]
