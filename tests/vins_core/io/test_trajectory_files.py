"""Trajectories keep their nanoseconds and their last bits on the way through a file."""

from pathlib import Path

import numpy as np
import pytest
from tiny_recording import T0, truth

from vins_core.errors import OutputError, RecordingError
from vins_core.io.trajectory import EUROC_HEADER, euroc_row, from_messages, read_trajectory, write_tum

TRAJECTORY = from_messages(truth(T0 + 7 * k) for k in range(20))


def test_tum_keeps_stamps_and_poses_to_the_last_bit(tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", TRAJECTORY)
    found = read_trajectory(tmp_path / "a.tum")
    assert np.array_equal(found.t_ns, TRAJECTORY.t_ns)
    assert found.p_w_b.tobytes() == TRAJECTORY.p_w_b.tobytes() and found.q_w_b.tobytes() == TRAJECTORY.q_w_b.tobytes()


def test_tum_writes_the_quaternion_with_w_last(tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", TRAJECTORY)
    first = (tmp_path / "a.tum").read_text().splitlines()[0].split()
    assert first[0] == f"{T0 // 10**9}.{T0 % 10**9:09d}"
    assert float(first[7]) == TRAJECTORY.q_w_b[0, 0] and float(first[4]) == TRAJECTORY.q_w_b[0, 1]


def test_euroc_csv_keeps_everything_to_the_last_bit(tmp_path: Path) -> None:
    rows = [euroc_row(truth(T0 + 7 * k)) for k in range(20)]
    (tmp_path / "data.csv").write_text("\n".join([EUROC_HEADER, *rows]))
    found = read_trajectory(tmp_path / "data.csv")
    for name in ("t_ns", "p_w_b", "q_w_b", "v_w_b", "b_g", "b_a"):
        assert getattr(found, name).tobytes() == getattr(TRAJECTORY, name).tobytes()


def test_poses_without_velocity_have_none(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text("1403636580838555648,4.6,-1.7,0.7,0.5,-0.1,-0.8,-0.08\n")
    found = read_trajectory(tmp_path / "data.csv")
    assert found.v_w_b is None and found.t_ns.tolist() == [1403636580838555648]


def test_later_rows_with_old_stamps_are_dropped() -> None:
    assert from_messages(truth(T0 + k) for k in (0, 2, 1, 2, 3)).t_ns.tolist() == [T0, T0 + 2, T0 + 3]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,2,3\n", r"line 1: expected an integer stamp in ns and 3, 7, 10 or 16 numbers"),
        ("# t x y z\n1.0 2 3 4\n", r"line 2: expected `t x y z qx qy qz qw` \(TUM\)"),
        ("1.0 a 3 4 5 6 7 8\n", r"line 1: expected `t x y z qx qy qz qw`"),
        ("# nothing\n", r"no poses; expected EuRoC csv or TUM"),
    ],
)
def test_a_file_that_is_no_trajectory_is_told(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "file.txt").write_text(text)
    with pytest.raises(RecordingError, match=said):
        read_trajectory(tmp_path / "file.txt")


def test_a_trajectory_that_does_not_exist_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"none.tum: cannot be read: No such file"):
        read_trajectory(tmp_path / "none.tum")


def test_a_trajectory_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"a.tum: cannot be written: No such file or directory"):
        write_tum(tmp_path / "nowhere" / "a.tum", TRAJECTORY)
