"""Writing recordings: the same messages in any of the formats that can be read, without losing a bit.

Stamps stay exact to the nanosecond, numbers to the last bit, and encoded images keep their bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Literal, Protocol, get_args

from ..errors import OutputError, VinspectError
from . import own_yaml
from .asl import AslRecording
from .calibration import Settings, read_calibration
from .messages import ImageMessage, Message
from .recording import WRITABLE, Recording
from .write_asl import AslWriter
from .write_ros import Ros1Writer, Ros2Writer

Format = Literal["asl", "ros1", "ros2", "mcap"]


class MessageWriter(Protocol):
    def write(self, message: Message) -> None: ...
    def close(self) -> None: ...
    def abort(self) -> None:
        """Stop and remove what was written."""
        ...


def write_recording(
    messages: Iterable[Message], out: Path | str, format: Format, *, settings: Settings | None = None
) -> Path:
    """Write messages, in time order, to a new folder (asl, ros2, mcap) or file (ros1, or a name ending in .mcap, .db3).

    The calibration goes into the sensor.yaml files of an ASL folder, and beside any other recording into `NAME.yaml`
    in vinspect's own format.  An existing output is refused; an incomplete one is removed.
    """
    out = Path(out)
    if format not in get_args(Format):
        raise OutputError(f"unknown format {format!r}; expected one of {', '.join(get_args(Format))}")
    beside = None if settings is None or format == "asl" else calibration_path(out)
    for path in (out, beside):
        if path is not None and path.exists():
            raise OutputError(f"{path}: exists already and is not overwritten; choose another name or remove it")
    makers: dict[str, Callable[[], MessageWriter]] = {
        "asl": lambda: AslWriter(out, settings.calibration, settings.notes) if settings else AslWriter(out, None),
        "ros1": lambda: Ros1Writer(out),
        "ros2": lambda: Ros2Writer(out, "sqlite3"),
        "mcap": lambda: Ros2Writer(out, "mcap"),
    }
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        writer = makers[format]()
        try:
            for message in messages:
                writer.write(message)
            writer.close()
        except BaseException:
            writer.abort()
            raise
    except OSError as error:
        raise OutputError(f"{out}: cannot be written: {error.strerror or error}") from error
    if beside is not None and settings is not None:
        own_yaml.write(beside, settings.calibration, settings.overrides, settings.notes)
    return out


def convert(
    recording: Recording,
    out: Path | str,
    format: Format,
    settings: Settings | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Path:
    """Everything in a recording, in another format; an EuRoC folder's own calibration goes along.

    `progress` gets the share that is done, after each image.
    """
    if settings is None and isinstance(recording, AslRecording):
        with suppress(VinspectError):  # a folder without complete sensor.yaml files has no calibration to pass on
            settings = read_calibration([], recording)
    total = sum(s.count for s in recording.streams if s.role in WRITABLE)

    def messages() -> Iterator[Message]:
        for done, message in enumerate(recording.messages(), 1):
            yield message
            if isinstance(message, ImageMessage):
                progress(done / total)

    return write_recording(messages(), out, format, settings=settings)


def calibration_path(out: Path) -> Path:
    """Where the calibration of a bag is written."""
    return out.with_suffix(".yaml") if out.suffix in (".bag", ".mcap", ".db3") else out.with_name(out.name + ".yaml")
