"""A record that was damaged by chance says so or is right; one that was forged does no harm."""

from __future__ import annotations

import hashlib
import pickle
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import record_samples as samples

from vins_core.errors import RunError
from vins_core.record.codec import _SIZES, MAX_DIRECTORY, Blob, pack
from vins_core.record.folder import END, FRAMES, HEADER, IMAGES, INDEX, TRUTH
from vins_core.record.header import to_json
from vins_core.record.log import _HEAD, _MAGIC, LogWriter
from vins_core.record.reader import MAX_INDEX_DIRECTORY, RunReader
from vins_core.record.recent import Recent
from vins_core.record.writer import RunWriter
from vins_core.sensors import ImageRef

NAMES = (FRAMES, INDEX, IMAGES, TRUTH, HEADER, END)
N_FRAMES = 3


class Noise:
    """Images that differ in every pixel."""

    def load(self, ref: ImageRef) -> np.ndarray:
        return np.random.default_rng(ref.index).integers(0, 256, (480, 752), np.uint8)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fuzz") / "run"
    with RunWriter(path, samples.header(embedded_images=True), samples.truth(), Noise()) as writer:
        for frame in samples.frames(N_FRAMES):
            writer.append(*frame)
    return path


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four accidents: flipped bits, noise, something inserted, lost, torn off, repeated, or a forged number."""

    def noise() -> bytes:
        return rng.bytes(int(rng.integers(1, 200)))

    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(data) + 1))
        before, after, lost = data[:at], data[at:], int(rng.integers(1, 200))
        forged = int(rng.choice([0, 1, 0x7FFFFFFF, 0xFFFFFFFF])).to_bytes(4, "little")
        data = (
            before + bytes([(after[0] if after else 0) ^ (1 << int(rng.integers(8)))]) + after[1:],
            before + noise() + after[lost:],
            before + noise() + after,
            before + after[lost:],
            before,
            before + after[:500] + after,
            before + forged + after[4:],
        )[rng.integers(7)]
    return data


def repair_checksums(data: bytes) -> bytes:
    """What a forger does, and chance does not."""
    repaired, at = bytearray(data), 0
    while at + _HEAD.size <= len(repaired):
        magic, length, _, _ = _HEAD.unpack_from(repaired, at)
        payload = bytes(repaired[at + _HEAD.size : at + _HEAD.size + length])
        if magic != _MAGIC or len(payload) != length:
            break
        _HEAD.pack_into(repaired, at, magic, length, zlib.crc32(payload), 0)
        at += _HEAD.size + length
    return bytes(repaired)


def readings(path: Path) -> dict[str, str]:
    """A hash of everything that can be read, or the sentence that says why it cannot."""
    found: dict[str, str] = {}

    def read(name: str, what: Callable[[], bytes]) -> None:
        try:
            found[name] = hashlib.sha256(what()).hexdigest()
        except RunError as problem:
            found[name] = str(problem)
            assert str(path) in str(problem), "an error names its file"

    try:
        reader = RunReader(path)
    except RunError as problem:
        assert str(path) in str(problem)
        return {"header": str(problem)}
    read("header", lambda: to_json(reader.header))
    read("truth", lambda: pack({"truth": reader.truth}))
    for k in range(len(reader)):
        read(f"report {k}", lambda k=k: pack({"report": reader.report(k)}))  # type: ignore[misc]
        read(f"state {k}", lambda k=k: pack({"state": reader.state(k)}))  # type: ignore[misc]
        read(f"packet {k}", lambda k=k: pack({"packet": reader.packet(k)}))  # type: ignore[misc]
        summary = reader.summary(k)
        summary.ms.pop("record", None)  # known to the index alone
        read(f"summary {k}", lambda s=summary: pack({"summary": s}))  # type: ignore[misc]
        for n in range(2):
            read(f"image {k} {n}", lambda k=k, n=n: reader.load(reader.report(k).images[n]).tobytes())  # type: ignore[misc]
    if reader.outcome is not None:
        read("outcome", lambda: str(reader.outcome).encode())
    reader.close()
    return found


def is_hash(text: str) -> bool:
    return len(text) == 64 and " " not in text


def damaged_by_chance(run: Path, seeds: range) -> None:
    whole = readings(run)
    assert all(map(is_hash, whole.values())) and len(whole) == 3 + N_FRAMES * 6
    refused = 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        name = NAMES[seed % len(NAMES)]
        original = (run / name).read_bytes()
        (run / name).write_bytes(mutate(original, rng))
        try:
            found = readings(run)
        finally:
            (run / name).write_bytes(original)
        for what, value in found.items():
            if is_hash(value):
                assert value == whole[what], f"seed {seed}: {what} is wrong after an accident to {name}"
        refused += found != whole
    assert refused > len(seeds) / 3  # the accidents were no trifles


def forged(run: Path, seeds: range) -> None:
    for seed in seeds:
        rng = np.random.default_rng(seed)
        name = (FRAMES, INDEX, IMAGES, TRUTH)[seed % 4]
        original = (run / name).read_bytes()
        (run / name).write_bytes(repair_checksums(mutate(original, rng)))
        try:
            readings(run)
        finally:
            (run / name).write_bytes(original)


def test_an_accident_is_told_or_does_no_harm(run: Path) -> None:
    damaged_by_chance(run, range(120))


def test_a_forgery_never_crashes_the_reader(run: Path) -> None:
    forged(run, range(80))


@pytest.mark.slow
def test_a_thousand_accidents_are_told_or_do_no_harm(run: Path) -> None:
    damaged_by_chance(run, range(1000, 2000))


@pytest.mark.slow
def test_a_thousand_forgeries_never_crash_the_reader(run: Path) -> None:
    forged(run, range(1000, 2000))


def bomb(directory: int, integers: int = 0) -> bytes:
    """A small blob that unpacks to much."""
    packed = zlib.compress(bytes(directory + integers), 9)
    return _SIZES.pack(len(packed), directory, integers, 0, 0) + packed


@pytest.mark.parametrize("sizes", [(MAX_DIRECTORY + 1, 0), (16, 2**26)])
def test_a_bomb_is_refused_before_it_goes_off(sizes: tuple[int, int]) -> None:
    blob = bomb(*sizes)
    assert len(blob) < 100_000
    tracemalloc.start()
    with pytest.raises(RunError, match=r"somewhere announces .* bytes"):
        Blob(blob, "somewhere")
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_bombs_in_the_index_cost_nothing(run: Path) -> None:
    whole, original = readings(run), (run / INDEX).read_bytes()
    (run / INDEX).unlink()
    log = LogWriter(run / INDEX)
    for _ in range(50):
        log.append(bomb(MAX_INDEX_DIRECTORY + 1))
    log.close()
    try:
        assert readings(run) == whole
    finally:
        (run / INDEX).write_bytes(original)


def test_a_state_cannot_gather_more_than_memory_holds(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vins_core.record.reader.MAX_BYTES", 300_000)
    with pytest.raises(RunError, match="refers to more than a state can hold"):
        RunReader(run).state(N_FRAMES - 1)


def test_what_is_kept_is_bounded_in_number_and_in_bytes() -> None:
    made: list[int] = []

    def make(k: int) -> tuple[str, int]:
        made.append(k)
        return str(k), k

    few = Recent(make, keep=3, max_bytes=100)
    assert [few(k) for k in (1, 2, 3, 1, 2, 3)] == ["1", "2", "3"] * 2 and made == [1, 2, 3]
    few(4)
    few(1)  # had to go for 4
    assert made == [1, 2, 3, 4, 1]
    few(95)  # pushes out all but what fits beside it
    few(4)
    assert made == [1, 2, 3, 4, 1, 95] and few(1) == "1" and made[-1] == 95
    few(1000)  # too large to keep at all
    few(1000)
    assert made[-2:] == [1000, 1000]


class Evil:
    """A pickle of it creates a file when it is loaded."""

    def __init__(self, witness: Path) -> None:
        self.witness = witness

    def __reduce__(self) -> tuple[Callable[..., None], tuple[Path]]:
        return Path.touch, (self.witness,)


def test_a_hostile_record_executes_nothing(run: Path, tmp_path: Path) -> None:
    witness = tmp_path / "witness"
    evil = pickle.dumps(Evil(witness))
    pickle.loads(evil)
    assert witness.exists()  # it would work
    witness.unlink()
    for name in NAMES:
        original = (run / name).read_bytes()
        log = b"".join(_HEAD.pack(_MAGIC, len(evil), zlib.crc32(evil), 0) + evil for _ in range(2))
        for content in (evil, log):
            (run / name).write_bytes(content)
            try:
                readings(run)
            finally:
                (run / name).write_bytes(original)
    assert not witness.exists()
