from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import record_samples as samples
from same import differences

from vins_core.errors import OutputError, RunError
from vins_core.params import Params, replace
from vins_core.record.folder import FRAMES, HEADER, IMAGES, INDEX, INTERRUPTED, TRUTH, is_run
from vins_core.record.header import RunHeader
from vins_core.record.reader import RunReader
from vins_core.record.writer import RunWriter
from vins_core.report import FrameSummary, summarize
from vins_core.sensors import ImageRef


def without_times(summary: FrameSummary) -> FrameSummary:
    return dataclasses.replace(summary, ms={})


def summaries(frames: list) -> list[FrameSummary]:
    return [summarize(report, ms) for report, ms, _, _ in frames]


FRAME_COUNT = 25


@pytest.fixture(scope="module")
def frames() -> list:
    return list(samples.frames(FRAME_COUNT))


@pytest.fixture
def run(tmp_path: Path, frames: list) -> Path:
    with RunWriter(tmp_path / "run", samples.header(), samples.truth()) as writer:
        for frame in frames:
            writer.append(*frame)
    return tmp_path / "run"


def test_every_frame_comes_back_bit_for_bit_in_any_order(run: Path, frames: list) -> None:
    reader = RunReader(run, keep=3)
    assert len(reader) == FRAME_COUNT and reader.complete and reader.outcome == "finished"
    for k in np.random.default_rng(0).permutation(FRAME_COUNT):
        report, timings, packet, state = frames[k]
        assert differences(reader.report(k), report) == []
        assert reader.timings(k).items() >= timings.items() and reader.timings(k)["record"] > 0
        assert differences(reader.packet(k), packet) == []
        assert differences(reader.state(k), state) == []
        assert differences(*(without_times(s) for s in (reader.summary(k), summarize(report, timings)))) == []


def test_what_is_read_cannot_be_changed_by_mistake(run: Path) -> None:
    with pytest.raises(ValueError, match="read-only"):
        RunReader(run).state(20).window.frames[0].p_w_b[0] = 1.0


def test_a_frame_costs_less_than_100_kb(run: Path) -> None:
    assert sum(f.stat().st_size for f in run.iterdir()) / FRAME_COUNT < 100_000


def test_header_and_truth_come_back_exactly(tmp_path: Path) -> None:
    params = replace(Params(), {"window.max_iterations": 4, "window.loss": "huber", "frontend.equalize": False})
    header = samples.header(
        origins={"window.max_iterations": "set"},
        recording="a \"bag\" 'of' <b>bytes</b>\n.bag",
        recording_kind="ros1",
        topics={"imu": "/imu0"},
        start_s=0.7,
        expected_frames=FRAME_COUNT,
        backend="tape",
    )
    header = dataclasses.replace(header, params=params)
    with RunWriter(tmp_path / "run", header, samples.truth()):
        pass
    reader = RunReader(tmp_path / "run")
    assert differences(reader.header, header) == []
    assert differences(reader.truth, samples.truth()) == []
    assert json.loads((tmp_path / "run" / HEADER).read_text())["params"]["window.max_iterations"] == 4


def test_a_run_without_truth_says_so(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "run", samples.header()):
        pass
    assert RunReader(tmp_path / "run").truth is None


def test_a_growing_run_can_be_followed(tmp_path: Path, frames: list) -> None:
    writer = RunWriter(tmp_path / "run", samples.header())
    reader = RunReader(tmp_path / "run")
    assert len(reader) == 0 and reader.growing and not reader.complete
    for k, frame in enumerate(frames[:5]):
        writer.append(*frame)
        assert reader.refresh() == 1
        assert differences(reader.state(k), frame[3]) == []
    assert reader.refresh() == 0 and not reader.complete
    writer.close()
    assert reader.complete and not reader.growing


def test_an_exception_ends_the_run_with_its_sentence_and_keeps_the_frames(tmp_path: Path, frames: list) -> None:
    with pytest.raises(ZeroDivisionError), RunWriter(tmp_path / "a", samples.header()) as writer:
        writer.append(*frames[0])
        1 / 0  # noqa: B018
    with pytest.raises(KeyboardInterrupt), RunWriter(tmp_path / "b", samples.header()) as writer:
        writer.append(*frames[0])
        raise KeyboardInterrupt
    a, b = RunReader(tmp_path / "a"), RunReader(tmp_path / "b")
    assert (a.outcome, b.outcome) == ("division by zero", INTERRUPTED)
    assert len(a) == len(b) == 1 and a.complete and b.complete


@pytest.mark.parametrize("name", [INDEX, "end.json", TRUTH])
def test_a_lost_file_costs_no_frame(run: Path, frames: list, name: str) -> None:
    (run / name).unlink()
    reader = RunReader(run)
    assert len(reader) == FRAME_COUNT
    assert differences(*([without_times(s) for s in rows] for rows in (reader.summaries, summaries(frames)))) == []
    assert differences(reader.state(20), frames[20][3]) == []


@pytest.mark.parametrize("at", [0, 5, 100, 5000, -1, -300])
def test_a_damaged_index_costs_no_frame(run: Path, frames: list, at: int) -> None:
    data = bytearray((run / INDEX).read_bytes())
    data[at] ^= 0xFF
    (run / INDEX).write_bytes(data)
    reader = RunReader(run)
    assert differences(*([without_times(s) for s in rows] for rows in (reader.summaries, summaries(frames)))) == []


@pytest.mark.parametrize("kept", [0, 7, 3000, 10_000])
def test_an_index_that_is_behind_costs_no_frame(run: Path, kept: int) -> None:
    os.truncate(run / INDEX, kept)
    assert len(RunReader(run)) == FRAME_COUNT


def test_a_torn_tail_costs_only_the_frame_that_was_being_written(run: Path, frames: list) -> None:
    whole = (run / FRAMES).stat().st_size
    for cut in (1, 20_000):
        os.truncate(run / FRAMES, whole - cut)
        reader = RunReader(run)
        assert len(reader) == FRAME_COUNT - 1 and not reader.complete
        assert differences(reader.state(FRAME_COUNT - 2), frames[FRAME_COUNT - 2][3]) == []


def test_a_flipped_bit_is_found_named_and_confined_to_its_frame(run: Path, frames: list) -> None:
    data = bytearray((run / FRAMES).read_bytes())
    data[len(data) // 2] ^= 1
    (run / FRAMES).write_bytes(data)
    reader, bad = RunReader(run), []
    for k in range(FRAME_COUNT):
        try:
            reader.report(k)
        except RunError as problem:
            bad.append(k)
            assert FRAMES in str(problem) and "checksum" in str(problem)
    assert len(bad) == 1


def test_frames_must_follow_each_other(tmp_path: Path, frames: list) -> None:
    writer = RunWriter(tmp_path / "run", samples.header())
    writer.append(*frames[0])
    with pytest.raises(ValueError, match="frame 2 cannot follow 0"):
        writer.append(*frames[2])
    writer.append(*frames[1])
    assert len(RunReader(tmp_path / "run")) == 2


def test_a_run_is_never_overwritten(run: Path) -> None:
    before = {f.name: f.read_bytes() for f in run.iterdir()}
    with pytest.raises(OutputError, match="is not empty; a run is never overwritten"):
        RunWriter(run, samples.header())
    assert {f.name: f.read_bytes() for f in run.iterdir()} == before


def test_a_place_that_cannot_hold_a_run_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match=r"cannot create the run folder .*file/run"):
        RunWriter(tmp_path / "file" / "run", samples.header())


def test_frames_recorded_without_their_state_say_so(tmp_path: Path, frames: list) -> None:
    with RunWriter(tmp_path / "run", samples.header()) as writer:
        writer.append(*frames[0][:2])
    with pytest.raises(RunError, match=r"frame 0 of .* was recorded without its state"):
        RunReader(tmp_path / "run").state(0)
    with pytest.raises(RunError, match="no frame 1; it holds 1 frames"):
        RunReader(tmp_path / "run").report(1)


class Noise:
    """Images that differ in every pixel."""

    def load(self, ref: ImageRef) -> np.ndarray:
        return np.random.default_rng(ref.index).integers(0, 256, (480, 752), np.uint8)


def test_embedded_images_come_back_bit_for_bit(tmp_path: Path, frames: list) -> None:
    with RunWriter(tmp_path / "run", samples.header(embedded_images=True), images=Noise()) as writer:
        for frame in frames[:4]:
            writer.append(*frame)
    (tmp_path / "run" / INDEX).unlink()
    reader = RunReader(tmp_path / "run")
    assert reader.has_images
    for report, *_ in frames[:4]:
        for ref in report.images:
            np.testing.assert_array_equal(reader.load(ref), Noise().load(ref))
    with pytest.raises(RunError, match="holds no image 99"):
        reader.load(ImageRef(frames[0][0].t_ns, 0, 99))
    data = bytearray((tmp_path / "run" / IMAGES).read_bytes())
    data[100] ^= 1
    (tmp_path / "run" / IMAGES).write_bytes(data)
    with pytest.raises(RunError, match=r"images.log is damaged at byte 0"):
        reader.load(frames[0][0].images[0])


def test_an_image_of_a_forged_size_is_refused_before_it_takes_memory(
    tmp_path: Path, frames: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    forged = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (2**15).to_bytes(4, "big") * 2 + bytes(20)
    monkeypatch.setattr("vins_core.record.writer.encode", lambda image: forged)
    with RunWriter(tmp_path / "run", samples.header(embedded_images=True), images=Noise()) as writer:
        writer.append(*frames[0])
    with pytest.raises(RunError, match=r"an image of 32768x32768 where 752x480 is calibrated"):
        RunReader(tmp_path / "run").load(frames[0][0].images[0])


def test_images_are_not_embedded_unless_asked_for(run: Path, frames: list) -> None:
    reader = RunReader(run)
    assert not reader.has_images
    with pytest.raises(RunError, match="made without --embed-images"):
        reader.load(frames[0][0].images[0])


def test_many_threads_read_one_run(run: Path, frames: list) -> None:
    reader = RunReader(run, keep=2)

    def work(seed: int) -> list[str]:
        order = np.random.default_rng(seed).integers(0, FRAME_COUNT, 20)
        return [d for k in order for d in differences(reader.state(int(k)), frames[k][3])]

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(work, range(4))) == [[], [], [], []]


def edited(document: dict, key: str, value: object) -> str:
    *path, last = key.split("/")
    inner = document
    for part in path:
        inner = inner[int(part) if part.isdigit() else part]
    inner[last] = value
    return json.dumps(document)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("format", "other", "not the header of a run"),
        ("schema", 99, "record schema 99 but this version reads 3"),
        ("params", {"window.size": 10_000}, "window.size"),
        ("params", {"from.the_future": 1}, "another version"),
        ("params", 5, "damaged"),
        ("topics", 5, "damaged"),
        ("start_s", "soon", "damaged"),
        ("calibration/cameras/0/model/model", "periscope", "unknown camera model 'periscope'"),
        ("calibration/cameras/0/T_b_c", [[1.0]], r"shape \(1, 1\)"),
        ("calibration/cameras/0/model", ["pinhole-radtan"], "damaged"),
        ("calibration/cameras", 4, "damaged"),
        ("calibration/noise/acc_n", None, "damaged"),
        ("calibration/gravity_m_s2", "strong", "damaged"),
        ("calibration/sources", 3, "damaged"),
    ],
)
def test_a_forged_header_is_refused_by_name(run: Path, key: str, value: object, message: str) -> None:
    document = json.loads((run / HEADER).read_text())
    (run / HEADER).write_text(edited(document, key, value))
    with pytest.raises(RunError, match=message) as problem:
        RunReader(run)
    assert HEADER in str(problem.value)


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 10**5, b'{"format": "vinspect run", "schema": 1}']
)
def test_a_header_that_is_no_json_of_ours_is_refused(run: Path, content: bytes) -> None:
    (run / HEADER).write_bytes(content)
    with pytest.raises(RunError, match=HEADER):
        RunReader(run)


def test_what_is_not_a_run_is_refused_by_name(tmp_path: Path, run: Path) -> None:
    with pytest.raises(RunError, match="not a folder"):
        RunReader(tmp_path / "nowhere")
    with pytest.raises(RunError, match=r"is not a run: it has no header.json"):
        RunReader(tmp_path)
    assert is_run(run) and not is_run(tmp_path)
    (run / FRAMES).unlink()
    with pytest.raises(RunError, match=r"cannot read .*frames.log"):
        RunReader(run)


def test_killing_the_writer_loses_no_frame_it_had_finished(tmp_path: Path, frames: list) -> None:
    """The child says how many frames it appended; kill -9 takes it in the middle of its work."""
    code = (
        "import sys, itertools; sys.path.insert(0, sys.argv[1])\n"
        "import record_samples as samples\n"
        "from vins_core.record.writer import RunWriter\n"
        "writer = RunWriter(sys.argv[2], samples.header())\n"
        "for frame in samples.frames(10_000):\n"
        "    writer.append(*frame)\n"
        "    print(len(writer), flush=True)\n"
    )
    support = str(Path(samples.__file__).parent)
    child = subprocess.Popen([sys.executable, "-c", code, support, str(tmp_path / "run")], stdout=subprocess.PIPE)
    assert child.stdout is not None
    told = [int(child.stdout.readline()) for _ in range(20)]
    child.send_signal(signal.SIGKILL)
    told += [int(line) for line in child.stdout.read().split()]
    child.wait()
    reader = RunReader(tmp_path / "run")
    assert len(reader) >= told[-1]
    assert not reader.complete and not reader.growing and reader.outcome is None
    for k in range(20):
        assert differences(reader.state(k), frames[k][3]) == []


def test_package_versions_and_cpu_are_recorded() -> None:
    header = RunHeader(Params(), samples.calibration())
    assert {"python", "numpy", "casadi", "vinspect"} <= header.versions.keys()
    assert header.cpu
