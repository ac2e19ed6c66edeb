"""Writer of EuRoC ASL folders."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np

from ..sensors import Calibration, CameraCalibration
from . import euroc_yaml, images, own_yaml
from .messages import GpsMessage, ImageMessage, ImuMessage, Message, TruthMessage
from .trajectory import EUROC_HEADER, euroc_row

HEADERS = {
    "cam": "#timestamp [ns],filename",
    "depth": "#timestamp [ns],filename",
    "imu": (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
    ),
    "gps": (
        "#timestamp [ns],latitude [deg],longitude [deg],altitude [m],"
        + ",".join(f"covariance_enu_{a}{b} [m^2]" for a in "xyz" for b in "xyz")
        + ",status"
    ),
    "state_groundtruth_estimate": EUROC_HEADER,
}
KINDS: dict[type, str] = {
    ImageMessage: "cam",
    ImuMessage: "imu",
    GpsMessage: "gps",
    TruthMessage: "state_groundtruth_estimate",
}
SENSOR_TYPES = {
    "cam": "camera",
    "depth": "depth",
    "imu": "imu",
    "gps": "gps",
    "state_groundtruth_estimate": "visual-inertial",
}


class AslWriter:
    """One folder a topic, each with data.csv and a sensor.yaml that keeps the topic's name."""

    def __init__(self, out: Path, calibration: Calibration | None, notes: Sequence[str] = ()) -> None:
        self._root = out / "mav0"
        self._root.mkdir(parents=True)
        self._calibration = calibration
        self._notes = notes
        self._tables: dict[str, TextIO] = {}
        self._folders: dict[str, Path] = {}

    def write(self, message: Message) -> None:
        if message.topic not in self._folders:
            self._add(message.topic, _kind(message))
        self._tables[message.topic].write(self._row(message) + "\n")

    def close(self) -> None:
        for table in self._tables.values():
            table.close()

    def abort(self) -> None:
        self.close()
        shutil.rmtree(self._root.parent, ignore_errors=True)

    def _add(self, topic: str, kind: str) -> None:
        """A folder for a topic: cam0, imu0 ... as the topic says, else the next free number."""
        taken = {folder.name for folder in self._folders.values()}
        said = re.match(rf"/?({kind}\d+)(/|$)", topic)
        name = said[1] if said else ""
        number = 0
        while not name or name in taken:
            name = f"{kind}{number}"
            number += 1
        folder = self._root / name
        (folder / "data" if kind in ("cam", "depth") else folder).mkdir(parents=True)
        self._folders[topic] = folder
        self._tables[topic] = (folder / "data.csv").open("w", encoding="utf-8")
        self._tables[topic].write(HEADERS[kind] + "\n")
        own_yaml.dump(folder / "sensor.yaml", self._description(topic, kind), self._notes)

    def _description(self, topic: str, kind: str) -> dict[str, Any]:
        content: dict[str, Any] = {"sensor_type": SENSOR_TYPES[kind], "topic": topic}
        if self._calibration is None:
            return content
        if kind == "imu" and _same(topic, self._calibration.imu_topic):
            content |= euroc_yaml.imu_to_dict(self._calibration)
        if kind == "gps" and self._calibration.p_b_gps and _same(topic, self._calibration.gps_topic or topic):
            content |= euroc_yaml.antenna_to_dict(self._calibration.p_b_gps)
        for camera in self._calibration.cameras:
            if kind == "cam" and _same(topic, camera.topic):
                content |= self._camera(camera)
        return content

    def _camera(self, camera: CameraCalibration) -> dict[str, Any]:
        assert self._calibration is not None
        return euroc_yaml.camera_to_dict(camera, self._calibration.td_s)

    def _row(self, message: Message) -> str:
        if isinstance(message, ImageMessage):
            return f"{message.t_ns},{self._store(message)}"
        if isinstance(message, TruthMessage):
            return euroc_row(message)
        if isinstance(message, ImuMessage):
            values = [*message.gyro_rad_s, *message.accel_m_s2]
        else:
            values = [message.latitude_deg, message.longitude_deg, message.altitude_m]
            values += message.covariance_enu_m2.ravel().tolist()
        cells = [str(message.t_ns), *(repr(float(v)) for v in values)]
        return ",".join([*cells, str(message.status)] if isinstance(message, GpsMessage) else cells)

    def _store(self, message: ImageMessage) -> str:
        """Write the image's file and return its name; a repeated stamp gets a suffix."""
        data, suffix = _file_content(message)
        folder = self._folders[message.topic] / "data"
        name, copy = f"{message.t_ns}.{suffix}", 0
        while (folder / name).exists():
            copy += 1
            name = f"{message.t_ns}_{copy}.{suffix}"
        (folder / name).write_bytes(data)
        return name


def _kind(message: Message) -> str:
    return "depth" if isinstance(message, ImageMessage) and images.is_depth(message) else KINDS[type(message)]


def _same(topic: str, other: str) -> bool:
    return topic.strip("/").removesuffix("/compressed") == other.strip("/").removesuffix("/compressed")


def _file_content(message: ImageMessage) -> tuple[bytes, str]:
    """Encoded images as they are; pixels as PNG, Bayer patterns as the grey image that they give; metres as TIFF."""
    if isinstance(message.data, bytes):
        if images.is_depth(message):
            return images.without_depth_header(message.data), "png"
        return message.data, {"jpeg": "jpg"}.get(message.format, message.format)
    pixels = message.data
    if message.format in ("rgb8", "rgba8"):
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR if message.format == "rgb8" else cv2.COLOR_RGBA2BGRA)
    elif message.format.startswith("bayer"):
        pixels = images.grey(message, message.topic)
    suffix = "tiff" if pixels.dtype == np.float32 else "png"
    done, data = cv2.imencode(f".{suffix}", np.ascontiguousarray(pixels))
    assert done
    return data.tobytes(), suffix
