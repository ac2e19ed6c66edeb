"""Trees of frozen dataclasses with numpy arrays to bytes and back, exactly, without ever executing what is read.

A blob holds named sections (msgpack, typed when decoded) and one table of arrays that the sections refer to:

    sizes 5 x u32 | zlib (directory in msgpack, integers, tops of doubles, singles) | rest of doubles

Integers (ids, stamps, indices) shrink to a sixth in no time.  Of measured floats only sign, exponent and first digits
do, once bytes of equal rank stand together: of doubles the upper two go to zlib, of singles, often pixels, all four.

An array that occurs twice in a blob, or begins another one, is stored once.  Since state is immutable, one that is
still the same object as in an earlier blob of a series is not stored at all: it is referred to by (blobs back, index).
So a sliding window costs what changed, and every field added to the state is recorded without a line of code here.
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
_SIZES = struct.Struct("<IIIII")  # bytes of: the zlib stream; in it the directory, integers, tops, singles
_TOP, _REST = 2, 6  # bytes of a double
_BEGINNING = 64  # bytes that two arrays must share at least for one to be the beginning of the other
_Content = tuple[str, tuple[int, ...], bool, bytes]  # dtype, shape, fortran, bytes in this order
_MAX_UNPACKED = 64 * 1024 * 1024
MAX_DIRECTORY = 16 * 1024 * 1024
"""Bytes of msgpack in a blob: objects made of them take up to eight times as much."""


class _Spec(msgspec.Struct, array_like=True, frozen=True):
    """One row of the array table."""

    dtype: str
    shape: tuple[int, ...]
    offset: int  # bytes from the start of the integers; values from that of the singles or doubles
    fortran: bool = False  # column-major: BLAS may add in another order, so the layout is part of the value
    run: int = 0  # values in the row of bytes that holds it, when it is the beginning of a longer one


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
    inside = [b"".join(pool) for pool in (table.integers, table.tops, table.singles)]
    packed = zlib.compress(b"".join([_aligned(directory), *inside]), 1)
    head = _SIZES.pack(len(packed), len(directory), *map(len, inside))
    return b"".join([head, packed, *table.rests]), Ledger(ledger.blob + 1, table.seen)


def _aligned(data: bytes) -> bytes:
    return data + bytes(-len(data) % ALIGNMENT)


def _by_rank(data: bytes, itemsize: int) -> np.ndarray:
    """(itemsize, n) uint8: the lowest byte of every value, then the second lowest, and so on."""
    return np.frombuffer(data, np.uint8).reshape(-1, itemsize).T


class _Table:
    """Collects the arrays of one blob while it is written."""

    def __init__(self, ledger: Ledger) -> None:
        self.specs: list[_Spec] = []
        self.integers: list[bytes] = []
        self.tops: list[bytes] = []
        self.rests: list[bytes] = []
        self.singles: list[bytes] = []
        self.seen: dict[int, tuple[np.ndarray, int, int]] = {}  # what the shared sections hold: the next ledger
        self._ledger = ledger
        self._by_content: dict[_Content, int] = {}
        self._by_beginning: dict[tuple[str, bytes], tuple[_Spec, bytes]] = {}
        self._sizes = {"integers": 0, "<f4": 0, "<f8": 0}

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
            self.specs.append(self._beginning(key) or self._new(key))
        return index

    def _beginning(self, key: _Content) -> _Spec | None:
        """Where `key` is the beginning of what is stored already."""
        dtype, shape, fortran, data = key
        spec, stored = self._by_beginning.get((dtype, data[:_BEGINNING]), (None, b""))
        if spec is None or len(data) < _BEGINNING or not stored.startswith(data):
            return None
        return _Spec(dtype, shape, spec.offset, fortran, prod(spec.shape))

    def _new(self, key: _Content) -> _Spec:
        dtype, shape, fortran, data = key
        pool = dtype if dtype in self._sizes else "integers"
        spec = _Spec(dtype, shape, self._sizes[pool], fortran)
        if pool == "integers":
            self.integers.append(_aligned(data))
            self._sizes[pool] += len(self.integers[-1])
        else:
            self._split(data, np.dtype(dtype).itemsize)
            self._sizes[pool] += prod(shape)
        self._by_beginning[dtype, data[:_BEGINNING]] = spec, data
        return spec

    def _split(self, data: bytes, itemsize: int) -> None:
        rows = _by_rank(data, itemsize)
        if itemsize == _TOP + _REST:
            self.tops.append(rows[_REST:].tobytes())
            self.rests.append(rows[:_REST].tobytes())
        else:
            self.singles.append(rows.tobytes())


class Blob:
    """A blob that was read.  Its arrays are read-only; RunError where it contradicts itself."""

    def __init__(self, data: bytes, where: str, max_directory: int = MAX_DIRECTORY) -> None:
        self._where = where
        if len(data) < _SIZES.size:
            raise self._damaged("is too short")
        packed, directory, *sizes = _SIZES.unpack_from(data)
        if directory > max_directory:
            raise self._damaged(f"announces a directory of {directory} bytes")
        end = _SIZES.size + packed
        start = directory + -directory % ALIGNMENT
        inside = self._unpack(memoryview(data)[_SIZES.size : end], start + sum(sizes))
        table = self._decode(_Directory, inside[:directory], None)
        self._sections, self._arrays = table.sections, table.arrays
        self._integers, self._tops, self._singles = (
            inside[start + sum(sizes[:k]) : start + sum(sizes[: k + 1])] for k in range(len(sizes))
        )
        self._rests = memoryview(data)[end:]
        self.cost = len(data) + len(inside) + 8 * directory
        """Bytes that it and what is decoded from it may occupy."""

    def _unpack(self, packed: memoryview, size: int) -> memoryview:
        if size > _MAX_UNPACKED:
            raise self._damaged(f"announces {size} bytes")
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
        if (
            spec.dtype not in DTYPES
            or len(spec.shape) > 8
            or min(spec.shape, default=0) < 0
            or spec.offset < 0
            or spec.run < 0
        ):
            raise self._damaged(f"describes array {index} wrongly")
        count = prod(spec.shape)
        flat = self._flat(index, spec, count)
        flat.flags.writeable = False
        return flat.reshape(spec.shape, order="F" if spec.fortran else "C")

    def _flat(self, index: int, spec: _Spec, count: int) -> np.ndarray:
        """The values of an array, one after the other."""
        if count == 0:
            return np.zeros(0, spec.dtype)
        if spec.dtype == "<f8":
            rest, top = (
                self._take(index, pool, spec, count, k) for pool, k in ((self._rests, _REST), (self._tops, _TOP))
            )
            return np.concatenate([rest, top]).T.copy().view(spec.dtype).ravel()
        if spec.dtype == "<f4":
            return self._take(index, self._singles, spec, count, 4).T.copy().view(spec.dtype).ravel()
        if spec.offset + count * np.dtype(spec.dtype).itemsize > len(self._integers):
            raise self._damaged(f"ends before its array {index}")
        return np.frombuffer(self._integers, spec.dtype, count, spec.offset)

    def _take(self, index: int, pool: memoryview, spec: _Spec, count: int, ranks: int) -> np.ndarray:
        """(ranks, count) uint8"""
        run = max(spec.run, count)
        if (spec.offset + run) * ranks > len(pool):
            raise self._damaged(f"ends before its array {index}")
        return np.frombuffer(pool, np.uint8, run * ranks, spec.offset * ranks).reshape(ranks, run)[:, :count]

    def _decode(self, kind: type[T], data: Any, hook: Any) -> T:
        try:
            return msgspec.msgpack.decode(data, type=kind, ext_hook=hook)
        except (msgspec.MsgspecError, RecursionError, ValueError, OverflowError, MemoryError) as problem:
            raise self._damaged(f"cannot be decoded ({problem})") from None

    def _damaged(self, what: str) -> RunError:
        return RunError(f"{self._where} {what}; the record is damaged or not a vinspect record")
