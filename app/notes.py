"""What users say about a run, in a small file beside its record."""

from __future__ import annotations

import contextlib
from pathlib import Path

import msgspec

FILE = "notes.json"
MAX_BYTES = 64 * 1024
MAX_NAME = 80


class RunNotes(msgspec.Struct, frozen=True):
    """What users said about a run."""

    name: str = ""
    kept: bool = False  # not removed from the cache when newer runs come


def read_notes(folder: Path | None) -> RunNotes:
    """Nothing when there are none, or when they are not ours."""
    try:
        if folder is None or (folder / FILE).stat().st_size > MAX_BYTES:
            return RunNotes()
        notes = msgspec.json.decode((folder / FILE).read_bytes(), type=RunNotes)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return RunNotes()
    return msgspec.structs.replace(notes, name=notes.name[:MAX_NAME])


def write_notes(folder: Path, notes: RunNotes) -> None:
    """A run in a read-only place has its name for this session only."""
    with contextlib.suppress(OSError):
        (folder / FILE).write_bytes(msgspec.json.encode(notes))
