"""Any frame of a record can be restored and repeated bit for bit: at once, from disk, in another process (SPEC 9.2)."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest
from same import differences
from sample import CALIBRATION, RECORDING

from vins_core.pipeline import step
from vins_core.record.codec import pack
from vins_core.record.fork import recorded_images, state_before
from vins_core.record.reader import RunReader
from vins_core.record.writer import state_sections
from vins_core.runner import run_recording


def replay(run: RunReader, at: int, frames: int) -> list[str]:
    """Where `frames` frames repeated from the restored state before frame `at` differ from the recorded ones."""
    header, found = run.header, []
    state = state_before(run, at)
    with recorded_images(run) as images:
        for k in range(at, min(at + frames, len(run))):
            state, report, _ = step(header.params, header.calibration, images, state, run.packet(k), run.places)
            found += [f"frame {k}{d}" for d in differences(report, run.report(k)) + differences(state, run.state(k))]
    return found


@pytest.mark.parametrize("at", [0, 1, 6, 10, 11, 12, 13, 20, 27, 33])
def test_a_restored_frame_and_three_more_are_the_recorded_ones(sample_run: Path, at: int) -> None:
    assert replay(RunReader(sample_run), at, 3) == []


def test_a_replay_to_the_end_is_the_record(sample_run: Path) -> None:
    assert replay(RunReader(sample_run), 5, 100) == []


@pytest.mark.parametrize("at", [24, 40, 58, 67])
def test_loops_go_on_from_any_frame_as_they_did(looping_run: Path, at: int) -> None:
    assert replay(RunReader(looping_run), at, 3) == []


def digest(run: RunReader, at: int) -> str:
    """One hash over all that frames from `at` on report and leave behind, repeated here and now."""
    state, found = run.state(at - 1), hashlib.sha256()
    with recorded_images(run) as images:
        for k in range(at, len(run)):
            packet, header = run.packet(k), run.header
            state, report, _ = step(header.params, header.calibration, images, state, packet, run.places)
            found.update(pack({"report": report, **state_sections(state)}))
    return found.hexdigest()


@pytest.mark.parametrize(("name", "at"), [("sample_run", 25), ("looping_run", 60)])
def test_another_process_repeats_the_same_bits(name: str, at: int, request: pytest.FixtureRequest) -> None:
    run = request.getfixturevalue(name)
    code = f"import sys; from test_time_travel import RunReader, digest; print(digest(RunReader(sys.argv[1]), {at}))"
    folders = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]
    code = f"import sys; sys.path[:0] = {folders!r}; {code}"
    other = subprocess.run([sys.executable, "-c", code, str(run)], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == digest(RunReader(run), at)


@pytest.mark.slow
def test_every_frame_of_the_sample_repeats_with_three_more_and_five_to_the_end(tmp_path: Path) -> None:
    run_recording(RECORDING, [CALIBRATION], out=tmp_path / "run")
    run = RunReader(tmp_path / "run")
    assert [d for at in range(len(run)) for d in replay(run, at, 3)] == []
    assert [d for at in (0, 50, 111, 178, 240) for d in replay(run, at, len(run))] == []
