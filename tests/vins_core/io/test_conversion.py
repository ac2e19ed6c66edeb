"""Whatever is written can be read back, in every format, to the last bit."""

import math
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tiny_recording import (
    CALIBRATION,
    FORMATS,
    T0,
    encoded,
    gps,
    images,
    imu,
    imus,
    in_time_order,
    picture,
    recorded,
    truth,
    write,
)

from vins_core.errors import OutputError
from vins_core.io.calibration import Settings, read_calibration
from vins_core.io.messages import GpsMessage, ImageMessage, ImuMessage, Message, TruthMessage
from vins_core.io.recording import open_recording
from vins_core.io.sync import packets
from vins_core.io.write import calibration_path, convert, write_recording
from vins_core.params import Params


def bits(message: Message) -> tuple:
    """All a message says, comparable, with its topic as ROS names it for either kind of image."""
    topic = message.topic.removesuffix("/compressed")
    match message:
        case ImageMessage(data=bytes()):
            return message.t_ns, topic, message.format, message.data
        case ImageMessage():
            return message.t_ns, topic, message.format, message.data.shape, message.data.tobytes()
        case ImuMessage():
            return message.t_ns, topic, message.gyro_rad_s.tobytes(), message.accel_m_s2.tobytes()
        case GpsMessage():
            place = message.latitude_deg, message.longitude_deg, message.altitude_m, message.status
            return message.t_ns, topic, place, message.covariance_enu_m2.tobytes()
        case TruthMessage():
            known = (message.p_w_b, message.q_w_b, message.v_w_b, message.b_g, message.b_a)
            return message.t_ns, topic, *(None if v is None else v.tobytes() for v in known)


def assert_same(found: list[Message], expected: list[Message]) -> None:
    """Each topic in its order, and all merged by time with the IMU first."""
    for topic in {m.topic for m in expected}:
        ours, theirs = ([bits(m) for m in ms if bits(m)[1] == topic] for ms in (found, expected))
        assert ours == theirs
    assert len(found) == len(expected)


def a_bit_of_everything() -> list[Message]:
    steps = range(0, 1_000_000_000, 100_000_000)
    return in_time_order(
        [
            *imus(0.0, 1.0),
            *images(0.0, 1.0),
            *images(0.0, 1.0, topic="/cam1/image_raw"),
            *(truth(T0 + k) for k in steps),
            *(gps(T0 + 7 + k) for k in steps),
        ]
    )


EVERY_STEP = [
    ("asl", "ros1", "mcap", "ros2"),
    ("ros1", "ros2", "asl", "mcap"),
    ("ros2", "mcap", "ros1", "asl"),
    ("mcap", "asl", "ros2", "ros1"),
]
"""Together all twelve ways from one format to another."""


@pytest.mark.parametrize("chain", EVERY_STEP, ids="-".join)
def test_a_chain_of_conversions_through_all_formats_keeps_every_bit(tmp_path: Path, chain: tuple[str, ...]) -> None:
    messages = a_bit_of_everything()
    source = recorded(tmp_path, messages, chain[0])
    for format in chain[1:]:
        source = open_recording(convert(source, tmp_path / FORMATS[format], format))
    assert_same(list(source.messages()), messages)


finite = st.floats(allow_nan=False, allow_infinity=False)
stamps = st.integers(0, 2**31 * 10**9 - 1)


@st.composite
def odd_messages(draw: st.DrawFn) -> list[Message]:
    """Any stamps, also repeated and going back; any numbers; IMU values that are none."""
    vector = st.lists(finite, min_size=3, max_size=3).map(np.array)
    number = st.lists(finite | st.sampled_from([math.nan, math.inf, -math.inf]), min_size=3, max_size=3).map(np.array)
    imu_message = st.builds(ImuMessage, stamps, st.just("/imu0"), number, number)
    image_message = st.builds(
        lambda t, k: ImageMessage(t, "/cam0/image_raw", "png", encoded(k, ".png")), stamps, st.integers(0, 3)
    )
    truth_message = st.builds(
        lambda t, p, v: TruthMessage(t, "/state_groundtruth_estimate0", p, np.array([1.0, 0, 0, 0]), v, -v, p),
        stamps,
        vector,
        vector,
    )
    lists = [draw(st.lists(m, min_size=1, max_size=6)) for m in (imu_message, image_message)]
    truths = sorted(draw(st.lists(truth_message, max_size=4, unique_by=lambda m: m.t_ns)), key=lambda m: m.t_ns)
    return [m for messages in (*lists, truths) for m in messages]


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(odd_messages())
def test_odd_stamps_and_numbers_survive_every_format(messages: list[Message]) -> None:
    for format in FORMATS:
        with TemporaryDirectory() as folder, recorded(Path(folder), messages, format) as recording:
            assert_same(list(recording.messages()), messages)


@pytest.mark.parametrize("format", ["ros1", "ros2", "mcap"])
@pytest.mark.parametrize(
    ("encoding", "shape", "dtype"),
    [
        ("mono8", (48, 64), np.uint8),
        ("mono16", (48, 64), np.uint16),
        ("bgr8", (48, 64, 3), np.uint8),
        ("rgb8", (48, 64, 3), np.uint8),
        ("bgra8", (48, 64, 4), np.uint8),
        ("bayer_grbg8", (48, 64), np.uint8),
    ],
)
def test_raw_images_stay_raw_in_bags_and_look_the_same_in_folders(
    tmp_path: Path, format: str, encoding: str, shape: tuple[int, ...], dtype: type
) -> None:
    message = ImageMessage(T0, "/cam0/image_raw", encoding, picture(1, shape, dtype))
    bag = recorded(tmp_path, [message], format)
    assert [bits(m) for m in bag.messages()] == [bits(message)]
    folder = open_recording(convert(bag, tmp_path / "asl", "asl"))
    seen, in_folder = (r.load(next(r.images())) for r in (bag, folder))
    assert np.array_equal(seen, in_folder)


def test_a_position_without_orientation_stays_one(tmp_path: Path) -> None:
    messages = [TruthMessage(T0 + k, "/leica", np.array([k, 0.5, 0.25]), np.full(4, np.nan)) for k in range(3)]
    for format in ("ros1", "mcap"):
        bag = recorded(tmp_path, messages, format)
        assert [bits(m) for m in bag.messages()] == [bits(m) for m in messages]
        found = bag.truth()
        assert found is not None and np.isnan(found.q_w_b).all() and found.v_w_b is None


def test_all_formats_give_bit_identical_packets(tmp_path: Path) -> None:
    messages = a_bit_of_everything()
    seen = {}
    for format in FORMATS:
        recording = recorded(tmp_path, messages, format)
        seen[format] = [
            (
                p.t_ns,
                [(i.t_ns, i.index, recording.load(i).tobytes()) for i in p.images],
                p.imu.t_ns.tobytes(),
                p.imu.gyro_rad_s.tobytes(),
                p.imu.accel_m_s2.tobytes(),
            )
            for p in packets(recording, CALIBRATION, Params())
        ]
    assert all(s == seen["asl"] for s in seen.values()) and len(seen["asl"]) == 10


def test_a_topic_name_that_no_folder_can_have_survives_a_folder(tmp_path: Path) -> None:
    topic = "/camera/infra1/image_rect_raw"
    folder = recorded(tmp_path, [*imus(0, 0.1), *images(0, 0.1, topic=topic)])
    assert folder.image_topics == (topic,)


def test_names_ending_in_mcap_or_db3_give_a_single_file(tmp_path: Path) -> None:
    for format, name in (("mcap", "x.mcap"), ("ros2", "x.db3")):
        out = write_recording(a_bit_of_everything(), tmp_path / name, format)  # type: ignore[arg-type]
        assert out.is_file()
        assert_same(list(open_recording(out).messages()), a_bit_of_everything())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["x.db3", "x.mcap"]


@pytest.mark.parametrize("format", FORMATS)
def test_the_calibration_goes_along_to_the_last_bit(tmp_path: Path, format: str) -> None:
    out = tmp_path / FORMATS[format]
    write_recording(a_bit_of_everything(), out, format, settings=Settings(CALIBRATION, {"frontend.max_cnt": 99}))  # type: ignore[arg-type]
    recording = open_recording(out)
    found = read_calibration([] if format == "asl" else [calibration_path(out)], recording)
    camera, given = found.calibration.cameras[0], CALIBRATION.cameras[0]
    assert camera.model == given.model and np.array_equal(camera.T_b_c, given.T_b_c)
    assert (found.calibration.noise, found.calibration.gravity_m_s2) == (CALIBRATION.noise, CALIBRATION.gravity_m_s2)
    if format != "asl":
        assert found.overrides == {"frontend.max_cnt": 99}


@pytest.mark.parametrize("format", FORMATS)
def test_an_existing_output_is_refused_and_kept(tmp_path: Path, format: str) -> None:
    out = tmp_path / FORMATS[format]
    out.write_text("precious")
    with pytest.raises(OutputError, match="exists already and is not overwritten"):
        write_recording([imu(T0)], out, format)  # type: ignore[arg-type]
    assert out.read_text() == "precious"


@pytest.mark.parametrize("format", FORMATS)
def test_an_output_that_cannot_be_written_is_told(tmp_path: Path, format: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"file.* cannot be written"):
        write_recording([imu(T0)], tmp_path / "file" / FORMATS[format], format)  # type: ignore[arg-type]


@pytest.mark.parametrize("format", FORMATS)
def test_an_incomplete_output_is_removed(tmp_path: Path, format: str) -> None:
    def breaking_off():
        yield imu(T0)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(tmp_path, breaking_off(), format)
    assert list(tmp_path.iterdir()) == []


def test_a_stamp_that_ros_cannot_express_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"/imu0 has the stamp -1 ns, which ROS cannot express"):
        write(tmp_path, [imu(-1)], "ros1")
