"""KITTI raw data as downloaded: `2011_09_26/2011_09_26_drive_0009_sync` with `calib_*.txt` in the folder above.

OXTS, the GPS/IMU unit, is read three times: as an IMU, as GPS fixes and as the ground truth.  Its x points forward, y
to the left and z up; it is the body.  In synced drives it comes at 10 Hz, too rarely to integrate.
Source: Geiger, Lenz, Stiller and Urtasun, Vision meets robotics: the KITTI dataset, IJRR 2013; dataformat.txt.
"""

from __future__ import annotations

import calendar
import heapq
import re
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import numpy as np
import pymap3d

from ..errors import CalibrationError, RecordingError
from ..geometry import se3, so3
from ..geometry.camera import camera_from_dict
from ..sensors import NO_IMU, Calibration, CameraCalibration
from . import images
from .messages import GpsMessage, ImageMessage, ImuMessage, TruthMessage
from .recording import ImageStub, Item, Recording, Role, Stream, TopicChoice, time_order

IMU, GPS, TRUTH = "/oxts/imu", "/oxts/gps", "/oxts/pose"
VALUES = 30
"""Numbers in an OXTS file: pose, velocities, accelerations, rates, accuracies, and states of the receiver."""
MAX_FILE_BYTES = 100_000


def find_drive(path: Path) -> Path | None:
    """The folder that holds `image_00`: `path`, or the only drive one or two folders below."""
    for pattern in ("", "*", "*/*"):
        found = [p for p in ([path] if not pattern else sorted(path.glob(pattern))) if _is_drive(p)]
        if len(found) > 1:
            names = ", ".join(p.name for p in found)
            raise RecordingError(f"{path}: {len(found)} KITTI drives; open one of them: {names}")
        if found:
            return found[0]
    return None


def _is_drive(path: Path) -> bool:
    return (path / "image_00" / "timestamps.txt").is_file()


class KittiRecording(Recording):
    """Topics are named by their folders: /image_00, /image_01 (grey), /image_02, /image_03 (colour), /oxts/..."""

    kind = "kitti"
    numbered = True

    def __init__(self, path: Path, drive: Path, topics: TopicChoice | Calibration | None = None) -> None:
        super().__init__(path, topics)
        self.drive = drive
        self._files: dict[str, list[tuple[int, Path]]] = {}
        streams = []
        for folder in sorted(drive.glob("image_*")):
            if (folder / "timestamps.txt").is_file():
                streams.append(self._add(f"/{folder.name}", "kitti/image", "image", _stamped(folder)))
        if (drive / "oxts" / "timestamps.txt").is_file():
            rows = _stamped(drive / "oxts")
            roles: tuple[tuple[str, Role], ...] = ((IMU, "imu"), (GPS, "gps"), (TRUTH, "truth"))
            streams += [self._add(topic, "kitti/oxts", role, rows) for topic, role in roles]
        self.streams = tuple(streams)

    def _add(self, topic: str, kind: str, role: Role, files: list[tuple[int, Path]]) -> Stream:
        self._files[topic] = files
        stamps = [t_ns for t_ns, _ in files]
        return Stream(topic, kind, role, len(files), min(stamps, default=None), max(stamps, default=None))

    def scan(self, topics: Collection[str]) -> Iterator[Item]:
        readers: dict[Role, Callable[[str], Iterator[Item]]] = {
            "image": self._stubs,
            "imu": self._imu,
            "gps": self._gps,
            "truth": self._truth,
        }
        return heapq.merge(*(readers[self.stream(t).role](t) for t in sorted(topics)), key=time_order)

    def close(self) -> None:
        """Nothing is held open."""

    def _stubs(self, topic: str) -> Iterator[Item]:
        for index, (t_ns, _) in enumerate(self._files[topic]):
            yield ImageStub(t_ns, topic, index, 0)

    def _imu(self, topic: str) -> Iterator[Item]:
        for t_ns, path in self._files[topic]:
            row = _oxts(path)
            yield ImuMessage(t_ns, topic, row[17:20], row[11:14])

    def _gps(self, topic: str) -> Iterator[Item]:
        """The accuracy that OXTS gives is taken as one sigma of each axis."""
        for t_ns, path in self._files[topic]:
            row = _oxts(path)
            latitude, longitude, altitude = row[:3].tolist()
            yield GpsMessage(t_ns, topic, latitude, longitude, altitude, np.eye(3) * row[23] ** 2)

    def _truth(self, topic: str) -> Iterator[Item]:
        """East, north and up from the first fix; R_w_b = Rz(yaw) Ry(pitch) Rx(roll), yaw from east."""
        origin: np.ndarray | None = None
        for t_ns, path in self._files[topic]:
            row = _oxts(path)
            origin = row[:3] if origin is None else origin
            position = np.array(pymap3d.geodetic2enu(*row[:3], *origin))
            roll, pitch, yaw = (so3.exp(angle * axis) for angle, axis in zip(row[3:6], np.eye(3)))
            attitude = so3.multiply(yaw, so3.multiply(pitch, roll))
            yield TruthMessage(t_ns, topic, position, attitude, np.array([row[7], row[6], row[10]]))

    def _image(self, stub: ImageStub) -> ImageMessage:
        files = self._files[stub.topic]
        if not 0 <= stub.index < len(files) or files[stub.index][0] != stub.t_ns:
            raise RecordingError(f"{self.path}: {stub.topic} has no image {stub.index} at {stub.t_ns} ns")
        path = files[stub.index][1]
        try:
            data = path.read_bytes()
        except OSError as error:
            raise RecordingError(f"{path}: the image at {stub.t_ns} ns cannot be read: {error.strerror}") from error
        return ImageMessage(stub.t_ns, stub.topic, images.sniff(data) or path.suffix[1:].lower(), data)

    # -- calibration ---------------------------------------------------------------------------------------------------

    def calibration(self) -> Calibration:
        """The rectified grey pair of a synced drive, in the body of the OXTS; the IMU is left out (see above).

        T_c0rect_b = R_rect_00 T_cam_velo T_velo_imu; the pair differs by P_rect_01[0, 3] / f along x.
        """
        root = self.drive.parent
        cameras, velo, imu = (root / f"calib_{n}.txt" for n in ("cam_to_cam", "velo_to_cam", "imu_to_velo"))
        rectified = _Table(cameras)
        T_c_b = np.eye(4)
        T_c_b[:3, :3] = rectified.matrix("R_rect_00", 3, 3)
        T_c_b = T_c_b @ _Table(velo).transform() @ _Table(imu).transform()
        found = []
        for i in range(2):
            name = f"{i:02d}"
            if f"/image_{name}" not in self._files:
                break
            P = rectified.matrix(f"P_rect_{name}", 3, 4)
            width, height = rectified.matrix(f"S_rect_{name}", 1, 2)[0]
            numbers = {"fx": P[0, 0], "fy": P[1, 1], "cx": P[0, 2], "cy": P[1, 2]}
            model = camera_from_dict(
                "pinhole-radtan", width=width, height=height, **numbers, **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
            )
            T_ci_c = np.eye(4)
            T_ci_c[0, 3] = P[0, 3] / P[0, 0]
            found.append(CameraCalibration(f"cam{i}", model, se3.inverse(T_ci_c @ T_c_b), f"/image_{name}"))
        return Calibration(
            tuple(found),
            NO_IMU,
            gravity_m_s2=9.81,
            sources=tuple(str(path) for path in (cameras, velo, imu)),
            has_imu=False,
            gps_topic=GPS if GPS in self._files else "",
            p_b_gps=(0.0, 0.0, 0.0),
        )


def _stamped(folder: Path) -> list[tuple[int, Path]]:
    """Stamps and files of a sensor: line n of timestamps.txt belongs to the file numbered n, as far as it is there."""
    there = {int(p.stem): p for p in (folder / "data").glob("*") if p.stem.isdigit()}
    table = folder / "timestamps.txt"
    try:
        lines = table.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{table}: cannot be read: {error}") from error
    return [(_stamp_ns(table, n, line), there[n]) for n, line in enumerate(lines) if n in there and line.strip()]


def _stamp_ns(table: Path, number: int, line: str) -> int:
    """`2011-09-26 13:08:24.973999360`, UTC."""
    match = re.fullmatch(r"(\d{4})-(\d\d)-(\d\d) (\d\d):(\d\d):(\d\d)(?:\.(\d{1,9}))?", line.strip(), re.ASCII)
    if match is None:
        raise RecordingError(
            f"{table}, line {number + 1}: expected a stamp like 2011-09-26 13:08:24.973999360, found {line[:40]!r}"
        )
    seconds = calendar.timegm(tuple(int(v) for v in match.groups()[:6]))
    return seconds * 10**9 + int((match[7] or "0").ljust(9, "0"))


def _oxts(path: Path) -> np.ndarray:
    """(30,) the numbers of one file."""
    try:
        values = np.array(_small_text(path).split(), float)
    except ValueError:
        values = np.empty(0)
    if len(values) < VALUES or not np.all(np.isfinite(values)):
        raise RecordingError(f"{path}: expected {VALUES} numbers of the OXTS unit, found {len(values)}")
    return values


def _small_text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise RecordingError(f"{path}: {path.stat().st_size} bytes; expected a short text file")
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error


class _Table:
    """`key: numbers` lines of a calib_*.txt."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise CalibrationError(
                f"{path}: missing, so this drive has no calibration; put the calib_*.txt of its day there, or give "
                "--calib"
            )
        rows = (line.partition(":") for line in _small_text(path).splitlines())
        self._rows = {key.strip(): values for key, _, values in rows}

    def matrix(self, key: str, rows: int, columns: int) -> np.ndarray:
        try:
            values = np.array(self._rows.get(key, "").split(), float)
        except ValueError:
            values = np.empty(0)
        if len(values) != rows * columns or not np.all(np.isfinite(values)):
            raise CalibrationError(f"{self.path}: key {key}: expected {rows * columns} numbers")
        return values.reshape(rows, columns)

    def transform(self) -> np.ndarray:
        return se3.from_rotation_translation(self.matrix("R", 3, 3), self.matrix("T", 1, 3)[0])
