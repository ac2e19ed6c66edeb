"""Bags as other programs write them."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2 import Writer as Writer2
from tiny_recording import T0, images, imus, in_time_order, picture, recorded, truth, write

from vins_core.errors import RecordingError
from vins_core.geometry import so3
from vins_core.io.messages import ImageMessage, ImuMessage
from vins_core.io.recording import Recording, open_recording
from vins_core.io.ros_messages import Codec


def bag(path: Path, messages: Sequence[tuple[str, int, Any]], codec: Codec) -> Recording:
    """A bag of (topic, record time, message)."""
    writer: Any = (
        Writer1(path) if codec.generation == 1 else Writer2(path, version=8, storage_plugin=StoragePlugin.MCAP)
    )
    with writer:
        connections: dict[str, Any] = {}
        for topic, record_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=codec.store)
            writer.write(connections[topic], record_ns, codec.encode(message))
    return open_recording(path)


def vector(codec: Codec, name: str, *values: float) -> Any:
    return codec.store.types[f"geometry_msgs/msg/{name}"](*values)


def raw_image(codec: Codec, t_ns: int, pixels: np.ndarray, encoding: str, pad: int = 0, big: bool = False) -> Any:
    rows = np.ascontiguousarray(pixels, pixels.dtype.newbyteorder(">" if big else "<")).view(np.uint8)
    rows = np.pad(rows.reshape(len(pixels), -1), ((0, 0), (0, pad)), constant_values=255)
    return codec.make(
        "sensor_msgs/msg/Image",
        t_ns,
        "camera",
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(big),
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


@pytest.fixture(params=[1, 2], ids=["ros1", "mcap"])
def codec(request: pytest.FixtureRequest) -> Codec:
    return Codec(request.param)


def name(codec: Codec) -> str:
    return "a.bag" if codec.generation == 1 else "a"


def test_header_stamps_count_and_not_the_time_of_recording(tmp_path: Path, codec: Codec) -> None:
    late = [("/cam", T0 + 10**9 + k, raw_image(codec, T0 + k * 10**7, picture(k), "mono8")) for k in range(3)]
    recording = bag(tmp_path / name(codec), late, codec)
    assert [r.t_ns for r in recording.images()] == [T0, T0 + 10**7, T0 + 2 * 10**7]
    assert np.array_equal(recording.load(list(recording.images())[2]), picture(2))


def test_images_that_share_a_record_time_are_told_apart_by_their_stamps(tmp_path: Path, codec: Codec) -> None:
    burst = [("/cam", T0, raw_image(codec, T0 + k, picture(k), "mono8")) for k in range(3)]
    recording = bag(tmp_path / name(codec), burst, codec)
    for k, ref in enumerate(recording.images()):
        assert np.array_equal(recording.load(ref), picture(k))


def test_padded_rows_and_big_endian_pixels_are_understood(tmp_path: Path, codec: Codec) -> None:
    pixels = picture(5, dtype=np.uint16)
    messages = [
        ("/cam", T0, raw_image(codec, T0, pixels, "mono16", pad=6)),
        ("/cam", T0 + 1, raw_image(codec, T0 + 1, pixels, "mono16", pad=2, big=True)),
    ]
    found = list(bag(tmp_path / name(codec), messages, codec).messages())
    assert all(isinstance(m, ImageMessage) and np.array_equal(m.data, pixels) for m in found)


def test_an_image_with_too_few_bytes_is_told(tmp_path: Path, codec: Codec) -> None:
    short = raw_image(codec, T0, picture(0), "mono8")
    short.height = 100
    recording = bag(tmp_path / name(codec), [("/cam", T0, short)], codec)
    with pytest.raises(
        RecordingError, match=rf"the image of /cam at {T0} ns cannot be read: 3072 bytes for 64x100 mono8"
    ):
        recording.load(next(recording.images()))


def test_an_unknown_encoding_is_told_with_the_known_ones(tmp_path: Path, codec: Codec) -> None:
    recording = bag(tmp_path / name(codec), [("/cam", T0, raw_image(codec, T0, picture(0), "yuv422"))], codec)
    with pytest.raises(RecordingError, match=r"has encoding 'yuv422'; expected one of mono8"):
        recording.load(next(recording.images()))


def test_the_velocity_of_an_odometry_is_turned_into_the_world(tmp_path: Path, codec: Codec) -> None:
    q, v = so3.exp(np.array([0.3, -0.2, 0.5])), np.array([1.0, 2.0, 3.0])
    types = codec.store.types
    pose = types["geometry_msgs/msg/Pose"](
        vector(codec, "Point", 1.0, 2.0, 3.0), vector(codec, "Quaternion", q[1], q[2], q[3], q[0])
    )
    twist = types["geometry_msgs/msg/Twist"](vector(codec, "Vector3", *v), vector(codec, "Vector3", 0.0, 0.0, 0.0))
    odometry = codec.make(
        "nav_msgs/msg/Odometry",
        T0,
        "world",
        child_frame_id="body",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )
    found = bag(tmp_path / name(codec), [("/odometry", T0, odometry)], codec).truth()
    assert found is not None and found.v_w_b is not None
    assert found.p_w_b.tolist() == [[1.0, 2.0, 3.0]] and found.q_w_b[0].tolist() == q.tolist()
    np.testing.assert_allclose(found.v_w_b[0], so3.to_matrix(q) @ v, atol=1e-14)


def test_transforms_and_points_are_ground_truth(tmp_path: Path, codec: Codec) -> None:
    turn = codec.store.types["geometry_msgs/msg/Transform"](
        vector(codec, "Vector3", 1.0, 2.0, 3.0), vector(codec, "Quaternion", 0.0, 0.0, 0.6, 0.8)
    )
    messages = [
        (
            "/leica",
            T0,
            codec.make("geometry_msgs/msg/PointStamped", T0, "w", point=vector(codec, "Point", 9.0, 9.0, 9.0)),
        ),
        ("/vicon", T0, codec.make("geometry_msgs/msg/TransformStamped", T0, "w", child_frame_id="b", transform=turn)),
    ]
    recording = bag(tmp_path / name(codec), messages, codec)
    found = recording.truth()
    assert recording.truth_topic == "/vicon", "full poses win over bare positions"
    assert found is not None and found.q_w_b[0].tolist() == [0.8, 0.0, 0.0, 0.6]


def test_topics_of_other_types_are_listed_and_named_as_left_out(tmp_path: Path, codec: Codec) -> None:
    said = codec.store.types["std_msgs/msg/String"]("hello")
    recording = bag(tmp_path / name(codec), [("/chatter", T0, said)], codec)
    assert [(s.topic, s.role, s.count, s.first_ns) for s in recording.streams] == [("/chatter", "other", 1, T0)]
    assert recording.left_out == ("/chatter",)
    assert recorded(tmp_path / "written", [truth(T0)], "mcap").left_out == ()


def test_the_imu_comes_before_the_image_of_the_same_stamp(tmp_path: Path) -> None:
    for format in ("ros1", "ros2", "mcap"):
        events = list(recorded(tmp_path, [*images(0, 0.1), *imus(0, 0.1)], format).events())
        order = [(e.t_ns, not isinstance(e, ImuMessage)) for e in events]
        assert order == sorted(order)


@pytest.mark.parametrize("compression", ["LZ4", "BZ2"])
def test_compressed_ros1_bags_are_read(tmp_path: Path, compression: str) -> None:
    plain = write(tmp_path, in_time_order([*imus(0, 1), *images(0, 1)]), "ros1")
    writer = Writer1(tmp_path / "small.bag")
    writer.set_compression(Writer1.CompressionFormat[compression])
    with Reader1(plain) as reader, writer:
        copies = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest)
            for c in reader.connections
        }
        for connection, record_ns, raw in reader.messages():
            writer.write(copies[connection.id], record_ns, raw)
    assert_same_images(open_recording(tmp_path / "small.bag"), open_recording(plain))


@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_compressed_ros2_bags_are_read(tmp_path: Path, mode: CompressionMode) -> None:
    plain = write(tmp_path, in_time_order([*imus(0, 1), *images(0, 1)]), "ros2")
    writer = Writer2(tmp_path / "small", version=8)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with Reader2(plain) as reader, writer:
        copies = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest)
            for c in reader.connections
        }
        for connection, record_ns, raw in reader.messages():
            writer.write(copies[connection.id], record_ns, raw)
    assert_same_images(open_recording(tmp_path / "small"), open_recording(plain))


def assert_same_images(ours: Recording, theirs: Recording) -> None:
    refs = list(ours.images())
    assert [r.t_ns for r in refs] == [r.t_ns for r in theirs.images()] and len(refs) == 21
    assert [ours.encoded(r) for r in reversed(refs)] == [theirs.encoded(r) for r in reversed(list(theirs.images()))]
    assert ours.imu().gyro_rad_s.tobytes() == theirs.imu().gyro_rad_s.tobytes()


@pytest.mark.parametrize("format", ["ros1", "ros2", "mcap"])
def test_images_can_be_loaded_by_others_while_one_reads_on(tmp_path: Path, format: str) -> None:
    recording = recorded(tmp_path, in_time_order([*imus(), *images()]), format)
    expected = [recording.load(r) for r in recording.images()]
    alone = [e.t_ns for e in recording.events()]
    refs = list(recording.images())
    with ThreadPoolExecutor(4) as others:
        loads = [others.submit(recording.load, ref) for ref in refs for _ in range(3)]
        together = [e.t_ns for e in recording.events()]
        found = [load.result() for load in loads]
    assert together == alone
    assert all(np.array_equal(image, expected[k // 3]) for k, image in enumerate(found))
