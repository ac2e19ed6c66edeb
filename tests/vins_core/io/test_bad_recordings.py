"""What bad input gets: one sentence that names the file and what to do (SPEC 14)."""

import shutil
from pathlib import Path

import numpy as np
import pytest
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
    recorded,
    truth,
    write,
)

from vins_core.errors import RecordingError
from vins_core.io.messages import ImageMessage
from vins_core.io.recording import TopicChoice, open_recording
from vins_core.io.sync import packets
from vins_core.params import Params
from vins_core.sensors import ImageRef

REPAIR = {"ros1": "rosbag reindex", "ros2": "ros2 bag reindex", "mcap": "mcap recover"}


def storage(path: Path) -> Path:
    """The file with the messages."""
    return path if path.is_file() else next(p for p in path.iterdir() if p.suffix in (".db3", ".mcap"))


def read_everything(path: Path) -> None:
    with open_recording(path) as recording:
        for _ in packets(recording, CALIBRATION, Params()):
            pass
        for _ in recording.messages():
            pass


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.6, 0.95])
@pytest.mark.parametrize("format", REPAIR)
def test_a_truncated_bag_is_refused_with_the_repair_command(tmp_path: Path, format: str, share: float) -> None:
    path = write(tmp_path, in_time_order([*imus(), *images()]), format)
    file = storage(path)
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(RecordingError, match=REPAIR[format]) as told:
        read_everything(path)
    assert str(path) in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("format", REPAIR)
def test_a_bag_whose_last_bytes_are_missing_is_refused_with_the_repair_command(tmp_path: Path, format: str) -> None:
    path = write(tmp_path, in_time_order([*imus(), *images()]), format)
    file = storage(path)
    file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(RecordingError, match=REPAIR[format]):
        read_everything(path)


def test_a_ros1_bag_without_index_is_refused_whatever_its_name(tmp_path: Path) -> None:
    path = write(tmp_path, imus(0, 0.1), "ros1")
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = bytes(8)
    active = tmp_path / "a.bag.active"
    active.write_bytes(data)
    with pytest.raises(RecordingError, match=r"not indexed.*rosbag reindex"):
        open_recording(active)


@pytest.mark.parametrize("format", REPAIR)
def test_garbage_inside_a_bag_is_told_as_damage(tmp_path: Path, format: str) -> None:
    path = write(tmp_path, in_time_order([*imus(), *images()]), format)
    file = storage(path)
    data = np.frombuffer(file.read_bytes(), np.uint8).copy()
    middle = slice(len(data) // 4, len(data) // 2)
    data[middle] = np.random.default_rng(0).integers(0, 256, middle.stop - middle.start)
    file.write_bytes(data.tobytes())
    with pytest.raises(RecordingError, match=str(path)):
        read_everything(path)


@pytest.mark.parametrize("format", ["ros2", "mcap"])
def test_a_ros2_folder_without_metadata_is_refused_with_the_repair_command(tmp_path: Path, format: str) -> None:
    path = write(tmp_path, imus(0, 0.1), format)
    (path / "metadata.yaml").unlink()
    with pytest.raises(RecordingError, match=r"metadata.yaml is missing.*ros2 bag reindex"):
        open_recording(path)


def test_a_path_that_does_not_exist_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere: no such file or folder"):
        open_recording(tmp_path / "nowhere")


def test_an_empty_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"an empty folder; expected mav0"):
        open_recording(tmp_path)


def test_a_file_of_another_kind_is_told(tmp_path: Path) -> None:
    (tmp_path / "film.mp4").write_bytes(b"film")
    with pytest.raises(RecordingError, match=r"film.mp4: not a recording; expected a ROS 1 .bag"):
        open_recording(tmp_path / "film.mp4")


def test_a_folder_of_bags_asks_for_one(tmp_path: Path) -> None:
    write(tmp_path, [imu(T0)], "ros1")
    with pytest.raises(RecordingError, match=r"open one of them: a.bag"):
        open_recording(tmp_path)


@pytest.mark.parametrize("format", FORMATS)
def test_a_missing_topic_is_told_with_those_that_are_there(tmp_path: Path, format: str) -> None:
    recording = recorded(tmp_path, in_time_order([*imus(0, 0.2), *images(0, 0.2)]), format)
    recording.use(TopicChoice(imu="/mavros/imu"))
    with pytest.raises(RecordingError, match=r"there is no imu topic /mavros/imu; the recording has /imu0"):
        recording.imu()
    recording.use(TopicChoice(images=("/front",)))
    with pytest.raises(RecordingError, match=r"there is no image topic /front; the recording has /cam0/image_raw"):
        next(recording.images())


def test_a_recording_without_images_is_told(tmp_path: Path) -> None:
    recording = recorded(tmp_path, imus(0, 0.1), "mcap")
    with pytest.raises(
        RecordingError, match=r"there is no image topic; the recording has /imu0 \(sensor_msgs/msg/Imu\)"
    ):
        next(recording.images())


def test_ambiguous_topics_are_told_with_the_candidates_and_how_to_choose(tmp_path: Path) -> None:
    messages = in_time_order([*imus(0, 0.2), imu(T0, "/imu1"), *images(0, 0.2), *images(0, 0.2, topic="/cam1")])
    recording = recorded(tmp_path, messages, "ros1")
    with pytest.raises(
        RecordingError, match=r"2 imu topics \(/imu0, /imu1\): name one of them in the calibration file"
    ):
        recording.imu()
    with pytest.raises(RecordingError, match=r"2 image topics \(/cam0/image_raw/compressed, /cam1/compressed\)"):
        next(recording.images())


def test_a_calibration_settles_what_is_ambiguous(tmp_path: Path) -> None:
    messages = in_time_order([*imus(0, 0.2), imu(T0, "/imu1"), *images(0, 0.2), *images(0, 0.2, topic="/cam1")])
    recording = recorded(tmp_path, messages, "ros1").use(CALIBRATION)
    assert (recording.imu_topic, *recording.image_topics) == ("/imu0", "/cam0/image_raw/compressed")


def test_an_unclear_truth_is_none_and_a_choice_settles_it(tmp_path: Path) -> None:
    messages = [truth(T0, "/mocap"), truth(T0, "/odometry"), gps(T0)]
    recording = recorded(tmp_path, messages, "mcap")
    assert recording.truth() is None and len(recording.gps()) == 1
    chosen = recording.use(TopicChoice(truth="/mocap")).truth()
    assert chosen is not None and chosen.p_w_b.tobytes() == messages[0].p_w_b.tobytes()  # type: ignore[union-attr]


@pytest.mark.parametrize("format", FORMATS)
def test_an_unreadable_image_is_told_with_topic_and_stamp(tmp_path: Path, format: str) -> None:
    broken = ImageMessage(T0, "/cam0/image_raw", "jpeg", encoded(0)[:40])
    recording = recorded(tmp_path, [broken], format)
    with pytest.raises(RecordingError, match=rf"the image of /cam0/image_raw.* at {T0} ns cannot be read: 40 bytes"):
        recording.load(next(recording.images()))


def test_a_missing_image_file_is_told_by_its_path(tmp_path: Path) -> None:
    recording = recorded(tmp_path, images(0, 0.1))
    next((tmp_path / "folder").rglob(f"{T0}.jpg")).unlink()
    with pytest.raises(RecordingError, match=rf"{T0}.jpg: the image at {T0} ns cannot be read: No such file"):
        recording.load(next(recording.images()))


@pytest.mark.parametrize("format", FORMATS)
def test_a_reference_to_no_image_is_told(tmp_path: Path, format: str) -> None:
    recording = recorded(tmp_path, images(0, 0.1), format)
    with pytest.raises(RecordingError, match="has no image 7"):
        recording.load(ImageRef(T0 + 1, 0, 7, T0 + 1))


def test_an_image_name_that_leaves_the_folder_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, images(0, 0.1))
    (path / "mav0" / "cam0" / "data.csv").write_text(f"{T0},../../../secret.jpg\n")
    with pytest.raises(RecordingError, match=r"data.csv, line 1: expected the name of a file in data/"):
        open_recording(path)


@pytest.mark.parametrize("line", ["1403,1,2,3,4,5", "1403,1,2,3,4,5,six", "soon,1,2,3,4,5,6"])
def test_a_broken_line_of_a_table_is_told_by_file_and_line(tmp_path: Path, line: str) -> None:
    path = write(tmp_path, [*imus(0, 0.1), *images(0, 0.1)])
    table = path / "mav0" / "imu0" / "data.csv"
    table.write_text("#timestamp\n" + line + "\n")
    with pytest.raises(RecordingError, match=r"imu0/data.csv, line 2: expected a stamp in ns"):
        open_recording(path).imu()


def test_a_folder_without_image_table_is_read_by_its_file_names(tmp_path: Path) -> None:
    path = write(tmp_path, [*imus(0, 0.1), *images(0, 0.1)])
    (path / "mav0" / "cam0" / "data.csv").unlink()
    assert [i.t_ns for i in open_recording(path / "mav0").images()] == [m.t_ns for m in images(0, 0.1)]


def test_a_moved_storage_file_of_a_ros2_folder_is_told(tmp_path: Path) -> None:
    path = write(tmp_path, imus(0, 0.1), "ros2")
    shutil.move(storage(path), tmp_path / "elsewhere.db3")
    with pytest.raises(RecordingError, match=str(path)):
        open_recording(path)
