"""EuRoC ASL folders: `mav0/cam0/data.csv`, `mav0/imu0/data.csv`, images as files beside them."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..errors import CalibrationError, RecordingError
from ..sensors import Calibration
from . import images
from .messages import GpsMessage, ImageMessage, ImuMessage
from .recording import ImageStub, Item, Recording, Role, Stream, TopicChoice, time_order
from .trajectory import read_euroc_truth
from .yaml_file import read_yaml

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".pgm", ".tif", ".tiff"}


def find_mav0(path: Path) -> Path | None:
    """The folder that holds `imu0` and `cam0`: `path/mav0` or `path` itself."""
    for root in (path / "mav0", path):
        if any((root / name).is_dir() for name in ("cam0", "imu0")):
            return root
    return None


class AslRecording(Recording):
    """Topics are named as in EuRoC's own bags: /cam0/image_raw, /imu0, /state_groundtruth_estimate0, /gps0.

    A `topic` key in a sensor.yaml, which `vinspect convert` writes, overrides the name.
    """

    kind = "asl"
    numbered = True

    def __init__(self, path: Path, root: Path, topics: TopicChoice | Calibration | None = None) -> None:
        super().__init__(path, topics)
        self.root = root
        self._folders: dict[str, Path] = {}
        self._images: dict[str, list[tuple[int, str]]] = {}
        streams = []
        for folder in sorted(p for p in root.iterdir() if p.is_dir()):
            role = _role(folder.name)
            if role == "other" and not (folder / "data.csv").exists():
                continue
            topic = _topic(folder, role)
            self._folders[topic] = folder
            if role in ("image", "depth"):
                self._images[topic] = _image_list(folder)
                stamps = [t for t, _ in self._images[topic]]
            else:
                stamps = [t for _, t, _ in _rows(folder / "data.csv")]
            first, last = (min(stamps), max(stamps)) if stamps else (None, None)
            streams.append(Stream(topic, f"asl/{folder.name.rstrip('0123456789')}", role, len(stamps), first, last))
        self.streams = tuple(streams)

    def folder(self, topic: str) -> Path:
        """The sensor's folder, where its sensor.yaml is."""
        return self._folders[topic]

    def scan(self, topics: Collection[str]) -> Iterator[Item]:
        readers: dict[Role, Callable[[str], Iterator[Item]]] = {
            "imu": self._imu,
            "gps": self._gps,
            "truth": lambda topic: read_euroc_truth(self._folders[topic] / "data.csv", topic),
            "image": self._stubs,
            "depth": self._stubs,
        }
        return heapq.merge(*(readers[self.stream(t).role](t) for t in sorted(topics)), key=time_order)

    def _imu(self, topic: str) -> Iterator[Item]:
        path = self._folders[topic] / "data.csv"
        for number, t_ns, cells in _rows(path):
            try:
                values = np.array([float(c) for c in cells])
            except ValueError:
                values = np.empty(0)
            if len(values) != 6:
                raise RecordingError(
                    f"{path}, line {number}: expected a stamp in ns, three rad/s and three m/s^2, "
                    f"found {len(cells)} values"
                )
            yield ImuMessage(t_ns, topic, values[:3], values[3:])

    def _gps(self, topic: str) -> Iterator[Item]:
        path = self._folders[topic] / "data.csv"
        for number, t_ns, cells in _rows(path):
            try:
                values = [float(c) for c in cells]
            except ValueError:
                values = []
            if len(values) == 4:  # latitude, longitude, altitude, sigma
                covariance, status = np.eye(3) * values[3] ** 2, 0
            elif len(values) == 13:  # latitude, longitude, altitude, covariance, status
                covariance, status = np.array(values[3:12]).reshape(3, 3), int(values[12])
            else:
                raise RecordingError(
                    f"{path}, line {number}: expected a stamp in ns, latitude, longitude, altitude and sigma "
                    f"(or nine covariances and a status), found {len(cells)} values"
                )
            yield GpsMessage(t_ns, topic, values[0], values[1], values[2], covariance, status)

    def _stubs(self, topic: str) -> Iterator[Item]:
        for index, (t_ns, _) in enumerate(self._images[topic]):
            yield ImageStub(t_ns, topic, index, 0)

    def close(self) -> None:
        """Nothing is held open."""

    def _image(self, stub: ImageStub) -> ImageMessage:
        names = self._images[stub.topic]
        if not 0 <= stub.index < len(names) or names[stub.index][0] != stub.t_ns:
            raise RecordingError(f"{self.path}: {stub.topic} has no image {stub.index} at {stub.t_ns} ns")
        path = self._folders[stub.topic] / "data" / names[stub.index][1]
        try:
            data = path.read_bytes()
        except OSError as error:
            raise RecordingError(f"{path}: the image at {stub.t_ns} ns cannot be read: {error.strerror}") from error
        if self.stream(stub.topic).role == "depth":
            return images.raw_depth(stub.t_ns, stub.topic, data, str(path))
        return ImageMessage(stub.t_ns, stub.topic, images.sniff(data) or path.suffix[1:].lower(), data)


def _role(name: str) -> Role:
    kinds: dict[str, Role] = {
        "cam": "image",
        "imu": "imu",
        "gps": "gps",
        "depth": "depth",
        "state_groundtruth": "truth",
        "mocap": "truth",
    }
    return next((role for start, role in kinds.items() if name.startswith(start)), "other")


def _topic(folder: Path, role: Role) -> str:
    with suppress(CalibrationError):  # what is wrong with it is told when it is needed as a calibration
        topic = read_yaml(folder / "sensor.yaml").get("topic")
        if isinstance(topic, str) and topic:
            return topic
    return f"/{folder.name}/image_raw" if role in ("image", "depth") else f"/{folder.name}"


def _image_list(folder: Path) -> list[tuple[int, str]]:
    """(stamp, file name) of data.csv, or of the files themselves where there is none."""
    table = folder / "data.csv"
    if not table.exists():
        files = sorted(p.name for p in (folder / "data").glob("*") if p.suffix.lower() in IMAGE_SUFFIXES)
        stamps = ((_stamp_ns(Path(name).stem), name) for name in files)
        return sorted((t_ns, name) for t_ns, name in stamps if t_ns is not None)
    found = []
    for number, t_ns, cells in _rows(table):
        name = cells[0].strip() if cells else ""
        if not name or Path(name).name != name:
            raise RecordingError(f"{table}, line {number}: expected the name of a file in data/, found {name!r}")
        found.append((t_ns, name))
    return found


def _stamp_ns(stem: str) -> int | None:
    """A file's stamp by its name: nanoseconds (EuRoC), or seconds with decimals (TUM)."""
    seconds, point, decimals = stem.partition(".")
    if not seconds.isdigit() or (point and not decimals.isdigit()):
        return None
    return int(seconds) * 10**9 + int(decimals.ljust(9, "0")[:9]) if point else int(seconds)


def _rows(path: Path) -> Iterator[tuple[int, int, list[str]]]:
    """(line number, stamp in ns, the other cells) of a csv file with `#` comments."""
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                cells = line.strip().split(",")
                if line.startswith("#") or cells == [""]:
                    continue
                if not cells[0].strip().lstrip("-").isdigit():
                    raise RecordingError(f"{path}, line {number}: expected a stamp in ns, found {cells[0][:40]!r}")
                yield number, int(cells[0]), cells[1:]
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: not a text file; expected comma-separated values") from error
