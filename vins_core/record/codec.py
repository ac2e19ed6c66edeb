"""Trees of frozen dataclasses with numpy arrays to bytes and back, exactly, without ever executing what is read.

A blob holds named sections (msgpack, typed when decoded) and one table of arrays that the sections refer to:

    sizes 3 x u32 | zlib (directory in msgpack, integer arrays) | floating-point arrays

Each array is aligned to 16.  Integers (ids, stamps, indices) shrink to a sixth in no time; measured floats do not.

An array that occurs twice in a blob is stored once.  Since state is immutable, one that is still the same object as
in an earlier blob of a series is not stored at all: it is referred to by (blobs back, index).  So a sliding window
costs what changed, and every field added to the state is recorded without a line of code here.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import prod
from typing import Any, TypeVar

import msgspec
import numpy as np

from ..errors import OutputError, RunError

T = TypeVar("T")

ALIGNMENT = 16
DTYPES = frozenset(("|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f4", "<f8"))
_EXT_ARRAY = 1
_REFERENCE = struct.Struct("<II")  # blobs back, index in that blob's table
_SIZES = struct.Struct("<III")  # bytes of: the zlib stream, the directory in it, the integers in it
_MAX_UNPACKED = 64 * 1024 * 1024
MAX_DIRECTORY = 16 * 1024 * 1024
"""Bytes of msgpack in a blob: objects made of them take up to eight times as much."""


class _Spec(msgspec.Struct, array_like=True, frozen=True):
    """One row of the array table."""

    dtype: str
    shape: tuple[int, ...]
    offset: int  # from the start of the integers or of the floats
    fortran: bool = False  # column-major: BLAS may add in another order, so the layout is part of the value


class _Directory(msgspec.Struct, array_like=True, frozen=True):
    sections: dict[str, bytes]
    arrays: list[_Spec]


@dataclass(frozen=True)
class Ledger:
    """Where the arrays of the previous blob's shared sections are stored: `id(array) -> (array, blob, index)`.

    It keeps those arrays alive, hence an id names the same array for as long as it is in here.
    """

    blob: int = 0  # number of the next blob in the series
    known: Mapping[int, tuple[np.ndarray, int, int]] = field(default_factory=dict)


def pack(sections: Mapping[str, Any]) -> bytes:
    """A self-contained blob."""
    return pack_series(sections, {}, Ledger())[0]


def pack_series(own: Mapping[str, Any], shared: Mapping[str, Any], ledger: Ledger) -> tuple[bytes, Ledger]:
    """The next blob of a series; only the `shared` sections may refer to arrays of earlier blobs."""
    table = _Table(ledger)
    encoded = {name: table.encode(value, own_only=True) for name, value in own.items()}
    encoded |= {name: table.encode(value, own_only=False) for name, value in shared.items()}
    directory = msgspec.msgpack.encode(_Directory(encoded, table.specs))
    if len(directory) > MAX_DIRECTORY:
        raise OutputError(f"{len(directory)} bytes of names and numbers are too many for one block of a record")
    integers, floats = (b"".join(pool) for pool in (table.integers, table.floats))
    packed = zlib.compress(_aligned(directory) + integers, 1)
    head = _SIZES.pack(len(packed), len(directory), len(integers)) + packed
    return _aligned(head) + floats, Ledger(ledger.blob + 1, table.seen)


def _aligned(data: bytes) -> bytes:
    return data + bytes(-len(data) % ALIGNMENT)


def _is_integer(dtype: str) -> bool:
    return dtype[1] != "f"


class _Table:
    """Collects the arrays of one blob while it is written."""

    def __init__(self, ledger: Ledger) -> None:
        self.specs: list[_Spec] = []
        self.integers: list[bytes] = []
        self.floats: list[bytes] = []
        self.seen: dict[int, tuple[np.ndarray, int, int]] = {}  # what the shared sections hold: the next ledger
        self._ledger = ledger
        self._by_content: dict[tuple[str, tuple[int, ...], bool, bytes], int] = {}
        self._sizes = [0, 0]  # of floats, of integers

    def encode(self, value: Any, own_only: bool) -> bytes:
        def hook(leaf: Any) -> Any:
            if isinstance(leaf, np.ndarray):
                blob, index = (self._ledger.blob, self._store(leaf)) if own_only else self._locate(leaf)
                return msgspec.msgpack.Ext(_EXT_ARRAY, _REFERENCE.pack(self._ledger.blob - blob, index))
            if isinstance(leaf, np.generic):
                return leaf.item()
            raise TypeError(f"a record cannot hold a {type(leaf).__name__}")

        return msgspec.msgpack.encode(value, enc_hook=hook)

    def _locate(self, array: np.ndarray) -> tuple[int, int]:
        entry = self.seen.get(id(array)) or self._ledger.known.get(id(array))
        if entry is None:
            entry = (array, self._ledger.blob, self._store(array))
        self.seen[id(array)] = entry
        return entry[1], entry[2]

    def _store(self, array: np.ndarray) -> int:
        dtype = array.dtype.newbyteorder("<").str
        if dtype not in DTYPES:
            raise TypeError(f"a record cannot hold arrays of dtype {array.dtype}")
        fortran = array.flags.fnc
        data = array.astype(dtype, copy=False).tobytes("F" if fortran else "C")
        key = (dtype, array.shape, fortran, data)
        index = self._by_content.get(key)
        if index is None:
            index = self._by_content[key] = len(self.specs)
            integer = _is_integer(dtype)
            self.specs.append(_Spec(dtype, array.shape, self._sizes[integer], fortran))
            chunk = _aligned(data)
            (self.integers if integer else self.floats).append(chunk)
            self._sizes[integer] += len(chunk)
        return index


class Blob:
    """A blob that was read.  Arrays are read-only views into it; RunError where it contradicts itself."""

    def __init__(self, data: bytes, where: str, max_directory: int = MAX_DIRECTORY) -> None:
        self._where = where
        if len(data) < _SIZES.size:
            raise self._damaged("is too short")
        packed, directory, integers = _SIZES.unpack_from(data)
        if directory > max_directory:
            raise self._damaged(f"announces a directory of {directory} bytes")
        end = _SIZES.size + packed
        inside = self._unpack(memoryview(data)[_SIZES.size : end], directory + -directory % ALIGNMENT + integers)
        table = self._decode(_Directory, inside[:directory], None)
        self._sections, self._arrays = table.sections, table.arrays
        self._integers = inside[len(inside) - integers :]
        self._floats = memoryview(data)[end + -end % ALIGNMENT :]
        self.cost = len(data) + len(inside) + 8 * directory
        """Bytes that it and what is decoded from it may occupy."""

    def _unpack(self, packed: memoryview, size: int) -> memoryview:
        if size > _MAX_UNPACKED:
            raise self._damaged(f"announces {size} bytes of integers")
        try:
            inside = zlib.decompressobj().decompress(packed, size + 1)
        except zlib.error as problem:
            raise self._damaged(f"cannot be unpacked ({problem})") from None
        if len(inside) != size:
            raise self._damaged("does not unpack to the size it announces")
        return memoryview(inside)

    def __contains__(self, section: str) -> bool:
        return section in self._sections

    def get(self, section: str, kind: type[T], earlier: Callable[[int], Blob] | None = None) -> T:
        """Decode a section; `earlier(n)` gives the blob n places before this one in its series."""
        if section not in self._sections:
            raise self._damaged(f"has no section {section!r}")

        def hook(code: int, payload: memoryview) -> np.ndarray:
            if code != _EXT_ARRAY or len(payload) != _REFERENCE.size:
                raise self._damaged(f"holds an unknown extension {code}")
            back, index = _REFERENCE.unpack(payload)
            if back == 0:
                return self.array(index)
            if earlier is None:
                raise self._damaged(f"section {section!r} refers to another blob")
            return earlier(back).array(index)

        return self._decode(kind, self._sections[section], hook)

    def array(self, index: int) -> np.ndarray:
        if index >= len(self._arrays):
            raise self._damaged(f"has no array {index}")
        spec = self._arrays[index]
        if spec.dtype not in DTYPES or len(spec.shape) > 8 or min(spec.shape, default=0) < 0 or spec.offset < 0:
            raise self._damaged(f"describes array {index} wrongly")
        data = self._integers if _is_integer(spec.dtype) else self._floats
        count = prod(spec.shape)
        if spec.offset + count * np.dtype(spec.dtype).itemsize > len(data):
            raise self._damaged(f"ends before its array {index}")
        if count == 0:
            return np.zeros(spec.shape, spec.dtype)
        flat = np.frombuffer(data, spec.dtype, count, spec.offset)
        return flat.reshape(spec.shape, order="F" if spec.fortran else "C")

    def _decode(self, kind: type[T], data: Any, hook: Any) -> T:
        try:
            return msgspec.msgpack.decode(data, type=kind, ext_hook=hook)
        except (msgspec.MsgspecError, RecursionError, ValueError, OverflowError, MemoryError) as problem:
            raise self._damaged(f"cannot be decoded ({problem})") from None

    def _damaged(self, what: str) -> RunError:
        return RunError(f"{self._where} {what}; the record is damaged or not a vinspect record")
