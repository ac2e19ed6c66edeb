"""Which images become frames, and the IMU between them."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_recording import CALIBRATION, T0, images, imu, imus, in_time_order, picture, recorded

from vins_core.errors import CalibrationError, RecordingError
from vins_core.io.messages import ImageMessage, ImuMessage, Message
from vins_core.io.recording import Recording
from vins_core.io.sync import LEAD_IN_NS, TimeOffset, packets
from vins_core.params import Params
from vins_core.params import replace as with_params
from vins_core.sensors import Anomaly, Packet

MS = 1_000_000


def frames(recording: Recording, td_s: float = 0.0, freq: float = 10.0, **span: float) -> list[Packet]:
    params = with_params(Params(), {"frontend.freq": freq})
    return list(packets(recording, replace(CALIBRATION, td_s=td_s), params, **span))


def anomalies(found: list[Packet]) -> list[Anomaly]:
    return [a for packet in found for a in packet.anomalies]


@pytest.fixture
def plain(tmp_path: Path) -> Recording:
    """Two seconds, IMU at 200 Hz, images at 20 Hz."""
    return recorded(tmp_path, [*imus(), *images()])


def test_every_second_image_of_20_hz_becomes_a_frame_at_10_hz(plain: Recording) -> None:
    found = frames(plain)
    assert [(p.t_ns - T0) // MS for p in found] == list(range(100, 2001, 100))
    assert [p.frame for p in found] == list(range(20))


def test_every_image_but_the_first_becomes_a_frame_when_the_rate_is_not_limited(plain: Recording) -> None:
    assert len(frames(plain, freq=100.0)) == 40


def test_images_are_all_delivered_once_and_in_order(plain: Recording) -> None:
    assert [i.index for p in frames(plain) for i in p.images] == list(range(41))


@pytest.mark.parametrize("rate", [7.0, 13.0, 29.97, 60.0])
def test_the_achieved_rate_stays_within_one_frame_of_the_asked_one(tmp_path: Path, rate: float) -> None:
    found = frames(recorded(tmp_path, [*imus(0, 5, 100), *images(0, 5, rate)]))
    asked = min(rate, 10.0) * 5
    assert len(found) <= asked + 1
    if rate > 20:
        assert len(found) >= 0.8 * asked


@pytest.mark.parametrize("td_s", [0.0, 0.0021, -0.0137, 0.03])
def test_the_last_imu_sample_of_a_packet_is_the_first_of_the_next_at_image_time_plus_td(
    plain: Recording, td_s: float
) -> None:
    found = frames(plain, td_s)
    for before, after in itertools.pairwise(found):
        assert before.imu.t_ns[-1] == after.imu.t_ns[0] == before.t_ns + round(td_s * 1e9)
        for name in ("gyro_rad_s", "accel_m_s2"):
            assert np.array_equal(getattr(before.imu, name)[-1], getattr(after.imu, name)[0])
    assert all(np.all(np.diff(p.imu.t_ns) > 0) for p in found)


def test_the_imu_is_cut_by_an_offset_that_moves(plain: Recording) -> None:
    """It is read when a packet leaves, which is one packet ahead of the run."""
    offset, found = TimeOffset(0.0), []
    for packet in packets(plain, CALIBRATION, Params(), offset=offset):
        found.append(packet)
        offset.td_s += 0.0015
    assert [p.late_ns for p in found] == [max(0, k - 1) * 1_500_000 for k in range(len(found))]
    for before, after in itertools.pairwise(found):
        assert before.imu.t_ns[-1] == after.imu.t_ns[0]


def test_a_rolling_shutter_is_cut_at_its_middle_row_unless_that_is_off(plain: Recording) -> None:
    camera = replace(CALIBRATION.cameras[0], readout_s=0.02)
    rolling = replace(CALIBRATION, cameras=(camera,), td_s=0.003)
    assert {p.late_ns for p in packets(plain, rolling, Params())} == {13 * MS}
    off = with_params(Params(), {"online.rolling_shutter": False})
    assert {p.late_ns for p in packets(plain, rolling, off)} == {3 * MS}


def test_samples_at_the_ends_lie_on_the_line_between_their_neighbours(tmp_path: Path) -> None:
    def ramp(t_ns: int) -> ImuMessage:
        s = (t_ns - T0) * 1e-9
        return ImuMessage(t_ns, "/imu0", np.array([s, -s, 0.5]), np.array([2 * s, 1 - s, 9.8]))

    recording = recorded(tmp_path, [*(ramp(T0 + k * 5 * MS) for k in range(401)), *images()])
    for packet in frames(recording, td_s=0.0017):
        s = (packet.imu.t_ns - T0) * 1e-9
        assert packet.imu.gyro_rad_s == pytest.approx(np.stack([s, -s, 0 * s + 0.5], 1), abs=1e-7)
        assert packet.imu.accel_m_s2 == pytest.approx(np.stack([2 * s, 1 - s, 0 * s + 9.8], 1), abs=1e-7)


def test_a_sample_on_the_image_is_used_as_it_is(plain: Recording) -> None:
    for packet in frames(plain):
        assert packet.imu.gyro_rad_s[-1].tobytes() == imu(packet.t_ns).gyro_rad_s.tobytes()


def test_the_first_packet_holds_what_came_before_its_first_image(tmp_path: Path) -> None:
    first = frames(recorded(tmp_path, [*imus(0.0, 2.0), *images(0.5, 2.0)]))[0]
    assert first.imu.t_ns[0] == T0
    assert first.imu.t_ns[-1] == first.t_ns


def test_the_lead_in_is_bounded(tmp_path: Path) -> None:
    recording = recorded(tmp_path, [*imus(0.0, 31.0, 20), *images(30.0, 31.0)])
    first = frames(recording)[0]
    assert LEAD_IN_NS <= first.t_ns - first.imu.t_ns[0] <= LEAD_IN_NS + 50 * MS


def test_start_and_duration_count_from_the_first_image(tmp_path: Path) -> None:
    recording = recorded(tmp_path, [*imus(0.0, 3.0), *images(0.5, 3.0)])
    found = frames(recording, start_s=0.5, duration_s=1.0)
    assert found[0].images[0].t_ns == T0 + 1_000 * MS
    assert found[0].images[0].index == 10
    assert found[-1].t_ns == T0 + 2_000 * MS


def test_the_last_images_of_a_chosen_time_wait_for_their_imu(plain: Recording) -> None:
    found = frames(plain, td_s=0.12, duration_s=1.0)
    assert found[-1].t_ns == T0 + 1_000 * MS
    assert anomalies(found) == []


def test_reading_begins_before_the_end_of_the_file_is_reached(plain: Recording) -> None:
    def endless():
        yield from plain_events()
        raise AssertionError("read to the end")

    plain_events = plain.events
    plain.events = endless  # type: ignore[method-assign]
    assert next(packets(plain, CALIBRATION, Params())).frame == 0


# -- what may be wrong ---------------------------------------------------------------------------------------------


def only(found: list[Packet], kind: str) -> Anomaly:
    assert [a.kind for a in anomalies(found)] == [kind]
    return anomalies(found)[0]


def test_a_sample_with_nan_is_dropped_and_told(tmp_path: Path) -> None:
    samples = imus()
    bad = samples[101]
    samples[101] = ImuMessage(bad.t_ns, "/imu0", np.array([0.0, np.nan, 0.0]), bad.accel_m_s2)
    found = frames(recorded(tmp_path, [*samples, *images()]))
    anomaly = only(found, "nan")
    assert anomaly.t_ns == bad.t_ns and "/imu0 has a value that is no number" in anomaly.message
    assert not any(bad.t_ns in p.imu.t_ns for p in found)


def test_a_repeated_imu_stamp_is_dropped_and_told(tmp_path: Path) -> None:
    samples = imus()
    found = frames(recorded(tmp_path, [*samples[:101], samples[100], *samples[101:], *images()]))
    anomaly = only(found, "duplicate")
    assert anomaly.t_ns == samples[100].t_ns and "/imu0 repeats the stamp" in anomaly.message
    assert all(np.all(np.diff(p.imu.t_ns) > 0) for p in found)


@pytest.mark.parametrize("format", ["asl", "ros1", "mcap"])
def test_time_going_back_is_told_once_and_its_samples_are_dropped(tmp_path: Path, format: str) -> None:
    samples = imus()
    back = [imu(samples[90].t_ns + 1), imu(samples[91].t_ns + 1)]
    found = frames(recorded(tmp_path, [*samples[:101], *back, *samples[101:], *images()], format))
    anomaly = only(found, "reversal")
    assert anomaly.t_ns == back[0].t_ns and "/imu0 goes back by 0.05 s" in anomaly.message
    used = np.concatenate([p.imu.t_ns for p in found])
    assert not np.isin([b.t_ns for b in back], used).any()


def test_a_gap_in_the_imu_is_told_and_images_in_it_are_only_tracked(tmp_path: Path) -> None:
    samples = [s for s in imus() if not T0 + 650 * MS < s.t_ns < T0 + 960 * MS]
    found = frames(recorded(tmp_path, [*samples, *images()]))
    assert {a.kind for a in anomalies(found)} == {"gap", "no_imu"}
    gap = next(a for a in anomalies(found) if a.kind == "gap")
    assert "/imu0 is silent for 0.310 s" in gap.message and "about 61 samples" in gap.message
    inside = [p for p in found if T0 + 650 * MS < p.t_ns < T0 + 960 * MS]
    assert not inside
    assert [i.index for p in found for i in p.images] == list(range(41)), "the tracker still sees every image"


def test_a_missing_image_is_told(tmp_path: Path) -> None:
    pictures = images()
    del pictures[20:22]
    anomaly = only(frames(recorded(tmp_path, [*imus(), *pictures])), "dropped_image")
    assert "about 2 samples are missing" in anomaly.message


def test_repeated_and_reversed_images_are_dropped_and_told(tmp_path: Path) -> None:
    pictures = images()
    late = replace(pictures[5], t_ns=pictures[5].t_ns + 1)
    found = frames(recorded(tmp_path, [*imus(), *pictures[:11], pictures[10], late, *pictures[11:]]))
    assert [a.kind for a in anomalies(found)] == ["duplicate", "reversal"]
    assert np.all(np.diff([i.t_ns for p in found for i in p.images]) > 0)


def test_images_before_the_imu_are_left_out_and_told(tmp_path: Path) -> None:
    found = frames(recorded(tmp_path, [*imus(0.52, 2.0), *images()]))
    anomaly = only(found, "no_imu")
    assert anomaly.t_ns == T0 and "the IMU begins later; 11 images are left out" in anomaly.message
    assert found[0].images[0].index == 11


def test_images_after_the_imu_are_left_out_and_told(tmp_path: Path) -> None:
    found = frames(recorded(tmp_path, [*imus(0.0, 1.5), *images()]))
    assert "it ends earlier; 10 images are left out" in only(found, "no_imu").message
    assert found[-1].t_ns <= T0 + 1_500 * MS


def test_a_pause_is_no_change_of_rate(tmp_path: Path) -> None:
    found = frames(recorded(tmp_path, [*imus(0, 9, 100), *images(0, 3), *images(6.5, 9)]))
    assert {a.kind for a in anomalies(found)} == {"dropped_image"}


def test_a_change_of_rate_is_told(tmp_path: Path) -> None:
    found = frames(recorded(tmp_path, [*imus(0.0, 2.0, 200.0), *imus(2.01, 4.0, 100.0), *images(0.0, 4.0)]))
    changes = [a for a in anomalies(found) if a.kind == "rate_change"]
    assert "from 200 to 100 Hz" in changes[-1].message


@pytest.mark.parametrize(
    ("gyro_scale", "accel_scale", "said"),
    [(1.0, 1 / 9.81, "looks like g"), (57.3, 1.0, "looks like deg/s"), (1.0, 1000.0, "expected about 9.8")],
)
def test_wrong_units_are_suspected(tmp_path: Path, gyro_scale: float, accel_scale: float, said: str) -> None:
    samples = [ImuMessage(s.t_ns, s.topic, s.gyro_rad_s * gyro_scale, s.accel_m_s2 * accel_scale) for s in imus()]
    anomaly = only(frames(recorded(tmp_path, [*samples, *images()])), "unit_suspicion")
    assert said in anomaly.message


def test_an_axis_that_never_changes_is_suspected(tmp_path: Path) -> None:
    samples = [replace(s, gyro_rad_s=s.gyro_rad_s * [1, 0, 1]) for s in imus()]
    anomaly = only(frames(recorded(tmp_path, [*samples, *images()])), "axis_suspicion")
    assert "gyroscope y never changes" in anomaly.message


def test_a_recording_without_imu_overlap_is_refused(tmp_path: Path) -> None:
    recording = recorded(tmp_path, [*imus(10.0, 12.0), *images()])
    with pytest.raises(RecordingError, match=r"/imu0 .* and /cam0/image_raw .* do not overlap in time"):
        frames(recording)


def test_a_chosen_time_without_frames_is_refused(plain: Recording) -> None:
    with pytest.raises(RecordingError, match=r"no image of /cam0/image_raw in the chosen time"):
        frames(plain, start_s=50.0)


def test_images_of_another_size_than_calibrated_are_refused(tmp_path: Path) -> None:
    large: list[Message] = [ImageMessage(m.t_ns, m.topic, "mono8", picture(0, (96, 128))) for m in images(0, 0.5)]
    recording = recorded(tmp_path, in_time_order([*imus(0, 0.5), *large]))
    message = r"images of /cam0/image_raw are 128x96, but the calibration \(config.yaml\) is for 64x48"
    with pytest.raises(CalibrationError, match=message):
        frames(recording)
