from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest
import record_samples as samples
from same import differences
from sample import CALIBRATION, INITIALISED, RECORDING

from vins_core.errors import OutputError, ParameterError, RecordingError, RunError
from vins_core.io.recording import open_recording
from vins_core.params import changed
from vins_core.record.compare import compare, first_difference
from vins_core.record.folder import END, HEADER, INTERRUPTED
from vins_core.record.fork import fork
from vins_core.record.header import from_json, to_json
from vins_core.record.reader import RunReader
from vins_core.record.writer import RunWriter
from vins_core.runner import run_recording
from vins_core.whatif import resolve, without_map


@pytest.fixture(scope="module")
def run(sample_run: Path) -> RunReader:
    return RunReader(sample_run)


def same_frames(a: RunReader, b: RunReader, frames: range) -> list[str]:
    return [
        f"frame {k}{d}"
        for k in frames
        for d in (
            *differences(a.report(k), b.report(k)),
            *differences(a.state(k), b.state(k)),
            *differences(a.packet(k), b.packet(k)),
        )
    ]


@pytest.mark.parametrize("at", [0, 5, INITIALISED, INITIALISED + 1, 30])
def test_a_fork_without_changes_is_the_run_again_bit_for_bit(run: RunReader, tmp_path: Path, at: int) -> None:
    result = fork(run, at, tmp_path / "fork", {}, frames=4)
    forked = RunReader(tmp_path / "fork")
    assert (result.frames, result.finished, result.notes) == (at + 4, True, ())
    assert forked.complete and len(forked) == at + 4
    assert same_frames(run, forked, range(at + 4)) == []
    assert first_difference(run, forked) == (None, None)


def test_frames_before_the_fork_are_copied_and_the_fork_needs_its_parent_no_more(
    run: RunReader, tmp_path: Path
) -> None:
    shutil.copytree(run.path, tmp_path / "parent")
    fork(RunReader(tmp_path / "parent"), 20, tmp_path / "fork", {"window.pixel_sigma": 2.0}, frames=3)
    shutil.rmtree(tmp_path / "parent")
    forked = RunReader(tmp_path / "fork")
    assert same_frames(run, forked, range(20)) == []
    assert [s.ms for s in forked.summaries[:20]] == [s.ms for s in run.summaries[:20]]
    assert differences(forked.truth, run.truth) == []
    assert fork(forked, 10, tmp_path / "again", {}, frames=2).frames == 12


def test_a_fork_names_its_parent_frame_and_changes(run: RunReader, tmp_path: Path) -> None:
    fork(run, 30, tmp_path / "fork", {"window.pixel_sigma": "2", "frontend.freq": 10}, frames=1)
    header = RunReader(tmp_path / "fork").header
    assert header.parent is not None
    assert (header.parent.id, header.parent.frame) == (run.header.id, 30)
    assert header.parent.changes == {"window.pixel_sigma": 2.0} == changed(header.params, run.header.params)
    assert header.id != run.header.id and run.header.parent is None
    assert header.origins["window.pixel_sigma"] == "fork"
    assert header.origins["frontend.min_dist"] == run.header.origins["frontend.min_dist"] == "config"
    assert header.recording == run.header.recording
    assert header.expected_frames == 31


def test_parameters_apply_from_the_fork_on_and_not_before(run: RunReader, tmp_path: Path) -> None:
    fork(run, 20, tmp_path / "fork", {"window.keyframe_parallax": 0.0}, frames=6)
    forked = RunReader(tmp_path / "fork")
    limits = [g.limit for s in range(15, 26) for g in forked.report(s).keyframe.gates if g.name == "parallax"]
    assert limits == [10.0] * 5 + [0.0] * 6
    assert all(s.is_keyframe for s in forked.summaries[20:])
    assert not all(s.is_keyframe for s in run.summaries[20:26])


def test_a_fork_of_a_fork_continues_with_both_changes(run: RunReader, tmp_path: Path) -> None:
    fork(run, 20, tmp_path / "a", {"window.pixel_sigma": 2.0}, frames=6)
    a = RunReader(tmp_path / "a")
    fork(a, 24, tmp_path / "b", {"window.max_iterations": 3})
    b = RunReader(tmp_path / "b")
    assert b.header.parent is not None and (b.header.parent.id, b.header.parent.frame) == (a.header.id, 24)
    assert changed(b.header.params, run.header.params) == {"window.pixel_sigma": 2.0, "window.max_iterations": 3}
    assert len(b) == 26 and same_frames(a, b, range(24)) == []
    assert all(s.n_iterations <= 3 for s in b.summaries[24:])
    for k in (0, 19, 20, 23, 24, 25):
        params = b.header.params_at(k)
        assert (params.window.pixel_sigma, params.window.max_iterations) == (1.5 if k < 20 else 2.0, 8 if k < 24 else 3)
        assert differences(resolve(b, k, params).after, without_map(b.report(k))) == []


def test_a_fork_that_begins_before_the_forks_own_changes_keeps_them(run: RunReader, tmp_path: Path) -> None:
    fork(run, 24, tmp_path / "a", {"window.pixel_sigma": 2.0}, frames=2)
    fork(RunReader(tmp_path / "a"), 20, tmp_path / "b", {})
    fork(run, 20, tmp_path / "c", {"window.pixel_sigma": 2.0}, frames=6)
    b, c = RunReader(tmp_path / "b"), RunReader(tmp_path / "c")
    assert same_frames(b, c, range(26)) == []
    assert b.header.parent is not None and b.header.parent.changes == {"window.pixel_sigma": 2.0}
    assert b.header.parent.before == {"window.pixel_sigma": 1.5} and b.header.parent.parent is None


def test_a_fork_from_the_first_frame_is_a_run_with_these_parameters(run: RunReader, tmp_path: Path) -> None:
    fork(run, 0, tmp_path / "fork", {"window.size": 7}, frames=12)
    run_recording(RECORDING, [CALIBRATION], out=tmp_path / "run", settings=["window.size=7"], duration_s=1.35)
    a, b = RunReader(tmp_path / "fork"), RunReader(tmp_path / "run")
    assert same_frames(a, b, range(12)) == []


@pytest.mark.parametrize("size", [6, 13])
def test_the_window_grows_or_shrinks_to_its_new_size(run: RunReader, tmp_path: Path, size: int) -> None:
    fork(run, 30, tmp_path / "fork", {"window.size": size}, frames=6)
    forked = RunReader(tmp_path / "fork")
    sizes = [len(forked.state(k).window.frames) for k in range(29, 36)]
    assert sizes[0] == 10 and sizes[-1] == size
    steps = np.diff(sizes)
    assert (steps[0] == size - 10) if size < 10 else set(steps.tolist()) <= {0, 1}
    assert all(s.pose is not None for s in forked.summaries[30:])


def test_a_window_that_fills_takes_its_new_size_too(run: RunReader, tmp_path: Path) -> None:
    fork(run, 9, tmp_path / "fork", {"window.size": 6}, frames=4)
    forked = RunReader(tmp_path / "fork")
    assert [len(forked.state(k).window.frames) for k in (8, 9)] == [8, 6]
    state = forked.state(9)
    assert state.history[0].frame == state.window.frames[0].frame and state.history[0].imu is None


def test_another_frame_rate_makes_other_frames_of_the_same_images(run: RunReader, tmp_path: Path) -> None:
    fork(run, 20, tmp_path / "fork", {"frontend.freq": 5.0})
    forked = RunReader(tmp_path / "fork")
    assert len(forked) == forked.header.expected_frames
    packets = [forked.packet(k) for k in range(20, len(forked))]
    assert {len(p.images) for p in packets} == {2}
    images = [ref for p in packets for ref in p.images]
    assert images == [ref for k in range(20, len(run)) for ref in run.packet(k).images][: len(images)]
    found, _ = first_difference(run, forked)
    assert found is not None and (found.frame, found.stage, found.knob) == (20, "input", "frontend.freq")


def test_embedded_images_stay_embedded(run: RunReader, tmp_path: Path) -> None:
    run_recording(RECORDING, [CALIBRATION], out=tmp_path / "run", duration_s=0.8, embed_images=True)
    moved = dataclasses.replace(RunReader(tmp_path / "run").header, recording="/gone")
    (tmp_path / "run" / HEADER).write_bytes(to_json(moved))
    fork(RunReader(tmp_path / "run"), 4, tmp_path / "fork", {})
    shutil.rmtree(tmp_path / "run")
    forked = RunReader(tmp_path / "fork")
    assert forked.has_images and same_frames(run, forked, range(len(forked))) == []
    with open_recording(RECORDING, forked.header.calibration) as source:
        for k in range(len(forked)):
            for ref in forked.report(k).images:
                assert forked.load(ref).tobytes() == source.load(ref).tobytes()


def test_a_cancelled_fork_keeps_its_frames(run: RunReader, tmp_path: Path) -> None:
    answers, told = iter([False, True]), []
    result = fork(run, 3, tmp_path / "fork", {}, progress=told.append, cancelled=lambda: next(answers))
    forked = RunReader(tmp_path / "fork")
    assert (result.finished, len(forked), forked.outcome) == (False, 5, INTERRUPTED)
    assert [p.frames for p in told] == [4, 5] and told[0].expected == len(run)


def test_poses_before_the_fork_are_counted(run: RunReader, tmp_path: Path) -> None:
    result = fork(run, 20, tmp_path / "fork", {}, frames=2)
    assert result.poses == 22 - INITIALISED == sum(s.pose is not None for s in RunReader(tmp_path / "fork").summaries)


@pytest.mark.parametrize(
    ("at", "changes", "frames", "error", "message"),
    [
        (36, {}, None, RunError, r"no frame 36 to fork at; it holds frames 0 to 35"),
        (-1, {}, None, RunError, "no frame -1"),
        (5, {}, 0, ParameterError, "at least 1"),
        (5, {"window.sise": 8}, None, ParameterError, "did you mean window.size"),
        (5, {"window.size": 800}, None, ParameterError, "from 4 to 20"),
    ],
)
def test_what_cannot_be_forked_is_refused_before_a_folder_is_made(
    run: RunReader, tmp_path: Path, at: int, changes: dict, frames: int | None, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        fork(run, at, tmp_path / "fork", changes, frames)
    assert not (tmp_path / "fork").exists()


def changed_header(run: RunReader, folder: Path, **changes: object) -> RunReader:
    shutil.copytree(run.path, folder)
    (folder / HEADER).write_bytes(to_json(dataclasses.replace(run.header, **changes)))
    return RunReader(folder)


def test_a_back_end_that_is_not_there_is_named(run: RunReader, tmp_path: Path) -> None:
    other = changed_header(run, tmp_path / "run", backend="abacus")
    with pytest.raises(RunError, match="computed by the back end 'abacus', which is not available here"):
        fork(other, 5, tmp_path / "fork", {})
    assert not (tmp_path / "fork").exists()


def test_images_that_are_gone_are_named(run: RunReader, tmp_path: Path) -> None:
    other = changed_header(run, tmp_path / "run", recording="/gone/room.bag")
    with pytest.raises(RecordingError, match=r"/gone/room\.bag: no such file"):
        fork(other, 5, tmp_path / "fork", {})
    assert not (tmp_path / "fork").exists()


def test_another_machine_is_noted(run: RunReader, tmp_path: Path) -> None:
    versions = {**run.header.versions, "numpy": "1.99"}
    other = changed_header(run, tmp_path / "run", versions=versions, cpu="Z80")
    result = fork(other, 5, tmp_path / "fork", {}, frames=1)
    assert any("numpy was 1.99 and is " in note for note in result.notes)
    assert any("processor was Z80" in note for note in result.notes)
    settings = {s.key for s in compare(run, other).environment}
    assert settings == {"versions.numpy", "cpu"}


def test_an_occupied_folder_is_refused(run: RunReader, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="never overwritten"):
        fork(run, 5, run.path, {})
    assert len(RunReader(run.path)) == len(run)


def test_a_record_without_states_cannot_be_forked(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "run", samples.header()) as writer:
        for report, ms, *_ in samples.frames(2):
            writer.append(report, ms)
    with pytest.raises(RunError, match="recorded without its"):
        fork(RunReader(tmp_path / "run"), 1, tmp_path / "fork", {})


def test_a_run_that_still_grows_is_forked_as_far_as_it_is(run: RunReader, tmp_path: Path) -> None:
    shutil.copytree(run.path, tmp_path / "run")
    (tmp_path / "run" / END).unlink()
    fork(RunReader(tmp_path / "run"), 33, tmp_path / "fork", {})
    assert len(RunReader(tmp_path / "fork")) == len(run)


def test_records_without_an_id_get_a_lasting_one(run: RunReader, tmp_path: Path) -> None:
    document = msgspec.json.decode(to_json(run.header))
    del document["id"], document["parent"], document["checksum"]
    old = msgspec.json.encode(document)
    assert from_json(old, "old").id == from_json(old, "old").id != run.header.id


def test_ids_name_runs(run: RunReader, tmp_path: Path) -> None:
    fork(run, 30, tmp_path / "a", {}, frames=1)
    fork(run, 30, tmp_path / "b", {}, frames=1)
    a, b = (RunReader(tmp_path / name).header.id for name in "ab")
    assert len({a, b, run.header.id}) == 3


def test_the_run_stays_as_it_was(run: RunReader, tmp_path: Path) -> None:
    before = {f.name: f.read_bytes() for f in run.path.rglob("*") if f.is_file()}
    fork(run, 30, tmp_path / "fork", {"window.pixel_sigma": 2.0}, frames=2)
    assert {f.name: f.read_bytes() for f in run.path.rglob("*") if f.is_file()} == before
