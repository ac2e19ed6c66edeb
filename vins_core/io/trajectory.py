"""Trajectories as files: EuRoC csv and TUM, read and written without losing a nanosecond."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from ..errors import OutputError, RecordingError
from ..sensors import Trajectory
from .messages import TruthMessage

EUROC_HEADER = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], "
    "b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]"
)


def read_trajectory(path: Path | str) -> Trajectory:
    """EuRoC csv (ns, p, q wxyz [, v [, b_g, b_a]]) or TUM (s, p, q xyzw), told apart by their separators."""
    path = Path(path)
    rows = _euroc_rows(path, "truth") if "," in _first_row(path) else _tum_rows(path)
    trajectory = from_messages(rows)
    if not len(trajectory):
        raise RecordingError(f"{path}: no poses; expected EuRoC csv or TUM (t x y z qx qy qz qw)")
    return trajectory


def from_messages(messages: Iterable[TruthMessage]) -> Trajectory:
    """Poses with strictly increasing stamps; where a stamp repeats or goes back the later row is dropped."""
    rows: list[TruthMessage] = []
    for message in messages:
        if not rows or message.t_ns > rows[-1].t_ns:
            rows.append(message)

    def column(name: str) -> np.ndarray | None:
        values = [getattr(m, name) for m in rows]
        return None if not rows or any(v is None for v in values) else np.array(values, float)

    return Trajectory(
        np.array([m.t_ns for m in rows], np.int64),
        np.array([m.p_w_b for m in rows], float).reshape(-1, 3),
        np.array([m.q_w_b for m in rows], float).reshape(-1, 4),
        column("v_w_b"),
        column("b_g"),
        column("b_a"),
    )


def read_euroc_truth(path: Path, topic: str) -> Iterator[TruthMessage]:
    """Rows of an EuRoC `state_groundtruth_estimate0/data.csv`, streaming."""
    return _euroc_rows(path, topic)


def write_tum(path: Path | str, trajectory: Trajectory) -> None:
    """`t x y z qx qy qz qw`, seconds with nine decimals, shortest text that reads back to the same float64."""
    path = Path(path)
    try:
        with path.open("w", encoding="utf-8") as file:
            for t_ns, p, (w, x, y, z) in zip(
                trajectory.t_ns.tolist(), trajectory.p_w_b.tolist(), trajectory.q_w_b.tolist()
            ):
                numbers = " ".join(repr(value) for value in (*p, x, y, z, w))
                file.write(f"{t_ns // 10**9}.{t_ns % 10**9:09d} {numbers}\n")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error


def euroc_row(message: TruthMessage) -> str:
    """One line of an EuRoC truth csv; velocity and biases only where known."""
    parts = [message.p_w_b, message.q_w_b]
    for extra in (message.v_w_b, message.b_g, message.b_a):
        if extra is None:
            break
        parts.append(extra)
    return ",".join([str(message.t_ns), *(repr(float(v)) for part in parts for v in part)])


def _first_row(path: Path) -> str:
    for _, row in _lines(path):
        return row
    return ""


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                line = line.strip()
                if line and not line.startswith("#"):
                    yield number, line
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: not a text file; expected EuRoC csv or TUM") from error


def _euroc_rows(path: Path, topic: str) -> Iterator[TruthMessage]:
    for number, line in _lines(path):
        cells = next(csv.reader([line]))
        try:
            t_ns, values = int(cells[0]), np.array([float(c) for c in cells[1:] if c.strip()])
        except ValueError:
            values = np.empty(0)
        if len(values) not in (3, 7, 10, 16):
            raise RecordingError(
                f"{path}, line {number}: expected an integer stamp in ns and 3, 7, 10 or 16 numbers "
                f"(p, q wxyz, v, b_g, b_a), found {line[:60]!r}"
            )
        n = len(values)
        yield TruthMessage(
            t_ns,
            topic,
            values[0:3],
            values[3:7] if n >= 7 else np.full(4, np.nan),
            values[7:10] if n >= 10 else None,
            values[10:13] if n == 16 else None,
            values[13:16] if n == 16 else None,
        )


def _tum_rows(path: Path) -> Iterator[TruthMessage]:
    for number, line in _lines(path):
        cells = line.split()
        try:
            if len(cells) != 8:
                raise ValueError
            t_ns = int((Decimal(cells[0]) * 10**9).to_integral_value())
            x, y, z, qx, qy, qz, qw = map(float, cells[1:])
        except (ValueError, InvalidOperation, OverflowError):
            raise RecordingError(
                f"{path}, line {number}: expected `t x y z qx qy qz qw` (TUM), found {line[:60]!r}"
            ) from None
        yield TruthMessage(t_ns, "truth", np.array([x, y, z]), np.array([qw, qx, qy, qz]))
