from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import StrEnum

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from vins_core.errors import RunError
from vins_core.record.codec import DTYPES, Blob, Ledger, pack, pack_series


class Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Leaf:
    x: np.ndarray
    name: str = "leaf"


@dataclass(frozen=True)
class Tree:
    left: Leaf
    right: Leaf | None
    many: tuple[Leaf, ...]
    colour: Colour
    numbers: dict[str, float]


def bits(array: np.ndarray) -> tuple[str, tuple[int, ...], bytes]:
    return array.dtype.str, array.shape, array.tobytes()


arrays = st.sampled_from(sorted(DTYPES)).flatmap(
    lambda dtype: npst.arrays(np.dtype(dtype), npst.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5))
)


@given(arrays)
def test_any_array_comes_back_bit_for_bit(array: np.ndarray) -> None:
    back = Blob(pack({"a": Leaf(array)}), "blob").get("a", Leaf).x
    assert bits(back) == bits(array)
    assert not back.flags.writeable or back.size == 0
    assert back.flags.aligned


def test_nan_payloads_and_signed_zeros_survive() -> None:
    x = np.array([0x7FF80000DEADBEEF, 0x8000000000000000], np.uint64).view(np.float64)
    assert bits(Blob(pack({"a": Leaf(x)}), "blob").get("a", Leaf).x) == bits(x)


def test_the_order_of_a_matrix_survives_because_blas_adds_in_that_order() -> None:
    J = np.asfortranarray(np.random.default_rng(0).normal(size=(75, 75)))
    back = Blob(pack({"a": Leaf(J), "b": Leaf(np.ascontiguousarray(J))}), "blob")
    assert back.get("a", Leaf).x.flags.f_contiguous
    assert back.get("b", Leaf).x.flags.c_contiguous
    r = np.arange(75.0)
    assert bits(back.get("a", Leaf).x @ r) == bits(J @ r)


def test_a_tree_of_dataclasses_comes_back_with_its_types() -> None:
    tree = Tree(Leaf(np.eye(3)), None, (Leaf(np.zeros(0)), Leaf(np.ones(2), "b")), Colour.RED, {"k": float("inf")})
    back = Blob(pack({"t": tree}), "blob").get("t", Tree)
    assert (back.right, back.colour, back.numbers, type(back.many)) == (None, Colour.RED, {"k": float("inf")}, tuple)
    assert isinstance(back.colour, Colour) and back.many[1].name == "b"


def test_numpy_scalars_are_stored_as_the_numbers_they_are() -> None:
    back = Blob(pack({"n": {"a": np.float32(0.5), "b": np.int64(7)}}), "blob").get("n", dict[str, float])
    assert back == {"a": 0.5, "b": 7.0}


def test_equal_arrays_are_stored_once_in_a_blob() -> None:
    x = np.random.default_rng(0).normal(size=1000)
    assert len(pack({"a": Leaf(x), "b": Leaf(x.copy())})) < len(pack({"a": Leaf(x)})) + 100


@pytest.mark.parametrize("dtype", ["<f8", "<f4", "<i8", "|u1"])
def test_the_beginning_of_an_array_costs_next_to_nothing(dtype: str) -> None:
    long = np.random.default_rng(1).integers(0, 1 << 60, (500, 3)).astype(dtype)
    if dtype[1] == "f":
        long /= 7
    alone, both = pack({"long": long}), pack({"long": long, "short": long[:300]})
    assert len(both) < len(alone) + 100
    blob = Blob(both, "x")
    assert bits(blob.get("long", np.ndarray)) == bits(long)
    assert bits(blob.get("short", np.ndarray)) == bits(long[:300])


def test_an_unchanged_array_is_stored_once_in_a_series_and_found_from_any_distance() -> None:
    same, ledger, series = np.random.default_rng(0).normal(size=1000), Ledger(), []
    for k in range(5):
        data, ledger = pack_series({}, {"s": (Leaf(same), Leaf(np.full(10, float(k))))}, ledger)
        series.append(Blob(data, f"blob {k}"))
        assert len(data) > 7000 if k == 0 else len(data) < 1000
    for k, blob in enumerate(series):
        kept, new = blob.get("s", tuple[Leaf, Leaf], lambda back, k=k: series[k - back])
        assert bits(kept.x) == bits(same)
        assert new.x[0] == k


def test_an_array_that_was_replaced_by_an_equal_one_is_stored_again_not_mixed_up() -> None:
    ledger, series = Ledger(), []
    for _ in range(50):  # objects of the same size reuse addresses, hence ids
        data, ledger = pack_series({}, {"s": Leaf(np.random.default_rng(len(series)).normal(size=7))}, ledger)
        series.append(Blob(data, "blob"))
    for k, blob in enumerate(series):
        back = blob.get("s", Leaf, lambda n, k=k: series[k - n]).x
        assert bits(back) == bits(np.random.default_rng(k).normal(size=7))


def test_own_sections_never_refer_to_other_blobs() -> None:
    x, ledger = np.arange(500.0), Ledger()
    for _ in range(2):
        data, ledger = pack_series({"own": Leaf(x)}, {"s": Leaf(x)}, ledger)
    assert bits(Blob(data, "blob").get("own", Leaf).x) == bits(x)


@pytest.mark.parametrize("value", [object(), np.array(["text"]), np.array([object()]), np.zeros(2, complex)])
def test_what_cannot_be_stored_exactly_is_refused_when_writing(value: object) -> None:
    with pytest.raises(TypeError, match="cannot hold"):
        pack({"a": {"x": value}})


@settings(max_examples=400, deadline=None)
@given(st.data())
def test_a_blob_with_any_changed_or_missing_bytes_decodes_or_raises_run_error(data: st.DataObject) -> None:
    good = pack({"t": Tree(Leaf(np.eye(3)), None, (Leaf(np.arange(4)),), Colour.RED, {"k": 1.0})})
    bad = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4))):
        bad[data.draw(st.integers(0, len(bad) - 1))] = data.draw(st.integers(0, 255))
    bad = bad[: data.draw(st.integers(0, len(bad)))]
    try:
        Blob(bytes(bad), "blob").get("t", Tree)
    except RunError as problem:
        assert str(problem).startswith("blob ")


def hostile(arrays: list[object], reference: bytes = bytes(8), code: int = 1) -> bytes:
    section = msgspec.msgpack.encode({"x": msgspec.msgpack.Ext(code, reference)})
    directory = msgspec.msgpack.encode([{"a": section}, arrays])
    return packed(directory + bytes(-len(directory) % 16), len(directory), 0) + bytes(64)


def packed(content: bytes, directory: int, integers: int) -> bytes:
    stream = zlib.compress(content)
    return struct.pack("<III", len(stream), directory, integers) + stream


@pytest.mark.parametrize(
    "data",
    [
        hostile([["|O8", [1], 0]]),
        hostile([["<f8", [2**40], 0]]),
        hostile([["<f8", [2**62, 2**62], 0]]),
        hostile([["<f8", [-1], 0]]),
        hostile([["<f8", [-1, -8], 0]]),
        hostile([["<f8", [1], -8]]),
        hostile([["<f8", [1], 2**62]]),
        hostile([["<f8", [1] * 40, 0]]),
        hostile([["<f8", [0, 2**62], 0]]),
        hostile([]),
        hostile([["<f8", [1], 0]], reference=bytes(3)),
        hostile([["<f8", [1], 0]], code=99),
        hostile([["<f8", [1], 0]], reference=b"\x01\0\0\0\0\0\0\0"),
        hostile([["<i8", [1], 0]]),
        b"\xff\xff\xff\xff",
        b"\xff" * 12,
        b"\xff" * 100,
        packed(b"\xdd\xff\xff\xff\xff" + bytes(11), 5, 0),
        packed(b"\x91" * 10**6, 10**6, 0),
        packed(bytes(10**7), 16, 0),  # unpacks to more than it says
        packed(bytes(16), 16, 10**6),  # to less
        packed(bytes(16), 2**31, 2**31),
    ],
)
def test_a_forged_blob_is_refused_by_name(data: bytes) -> None:
    with pytest.raises(RunError, match=r"^frame 7 .*damaged"):
        Blob(data, "frame 7").get("a", Leaf)
