"""Append-only logs of checked blocks: what was written before a crash stays readable, a torn tail is recognised.

block = magic u32 | length u32 | crc32 of the payload u32 | zero u32 | payload
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from ..errors import OutputError, RunError

MAX_PAYLOAD = 256 * 1024 * 1024
_PIECE = 8 * 1024 * 1024
_HEAD = struct.Struct("<IIII")
_MAGIC = int.from_bytes(b"VINR", "little")


class Block(NamedTuple):
    """Where a payload lies in its log."""

    offset: int  # of the block's head
    length: int  # of the payload
    crc: int

    @property
    def end(self) -> int:
        return self.offset + _HEAD.size + self.length


class LogWriter:
    """Each block is handed to the system in one unbuffered write, so killing the process loses none."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._size = 0
        try:
            self._file = open(path, "xb", buffering=0)  # noqa: SIM115
        except OSError as problem:
            raise OutputError(f"cannot write {path}: {problem.strerror}") from None

    def append(self, payload: bytes) -> Block:
        if len(payload) > MAX_PAYLOAD:
            raise OutputError(f"a block of {len(payload)} bytes is too large for {self._path}")
        block = Block(self._size, len(payload), zlib.crc32(payload))
        data = memoryview(_HEAD.pack(_MAGIC, block.length, block.crc, 0) + payload)
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as problem:
            raise OutputError(f"cannot write {self._path}: {problem.strerror}") from None
        self._size = block.end
        return block

    def adopt(self, other: LogReader, end: int) -> None:
        """Begin with the first `end` bytes of another log, so that its blocks lie where they lay."""
        assert self._size == 0
        try:
            while self._size < end:
                piece = other.span(self._size, min(end - self._size, _PIECE))
                if not piece:
                    break
                self._size += self._file.write(piece)
        except OSError as problem:
            raise OutputError(f"cannot write {self._path}: {problem.strerror}") from None

    def fileno(self) -> int:
        return self._file.fileno()

    @property
    def closed(self) -> bool:
        return self._file.closed

    def close(self) -> None:
        self._file.close()


class LogReader:
    """Random access and scanning of a log that may still grow.  Safe to use from several threads."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = open(path, "rb", buffering=0)  # noqa: SIM115
        except OSError as problem:
            raise RunError(f"cannot read {path}: {problem.strerror}") from None

    def size(self) -> int:
        return os.fstat(self._file.fileno()).st_size

    def read(self, block: Block) -> bytes:
        """The payload; RunError when it is not what was written."""
        payload = self._payload(block)
        if payload is None:
            raise RunError(f"{self._path} is damaged at byte {block.offset}: its checksum does not match")
        return payload

    def scan(self, offset: int) -> Iterator[tuple[Block, bytes]]:
        """Whole blocks from `offset` on, up to the end or the first that is torn or damaged."""
        while True:
            head = os.pread(self._file.fileno(), _HEAD.size, offset)
            if len(head) < _HEAD.size:
                return
            magic, length, crc, _ = _HEAD.unpack(head)
            if magic != _MAGIC or length > MAX_PAYLOAD:
                return
            block = Block(offset, length, crc)
            payload = self._payload(block)
            if payload is None:
                return
            yield block, payload
            offset = block.end

    def span(self, offset: int, length: int) -> bytes:
        return os.pread(self._file.fileno(), length, offset)

    def _payload(self, block: Block) -> bytes | None:
        if not (0 <= block.length <= MAX_PAYLOAD and block.offset >= 0 and block.end <= self.size()):
            return None
        payload = os.pread(self._file.fileno(), block.length, block.offset + _HEAD.size)
        return payload if len(payload) == block.length and zlib.crc32(payload) == block.crc else None

    def fileno(self) -> int:
        return self._file.fileno()

    def close(self) -> None:
        self._file.close()
