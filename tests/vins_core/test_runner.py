from __future__ import annotations

from pathlib import Path

import pytest

from vins_core.errors import CalibrationError, OutputError, ParameterError, RecordingError
from vins_core.io.write import calibration_path, write_recording
from vins_core.record.folder import INTERRUPTED
from vins_core.record.reader import RunReader
from vins_core.runner import Progress, choose_parameters, run_recording
from vins_core.simulation.simulate import simulate


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    simulation = simulate("room_loop", duration_s=2.4)
    out = tmp_path_factory.mktemp("recording") / "room.bag"
    return write_recording(simulation.messages(), out, "ros1", settings=simulation.settings)


def test_a_recording_becomes_a_run_with_all_that_is_needed_to_repeat_it(recording: Path, tmp_path: Path) -> None:
    told: list[Progress] = []
    calibration = calibration_path(recording)
    result = run_recording(
        recording, [calibration], out=tmp_path / "run", settings=["window.max_iterations=5"], progress=told.append
    )
    reader = RunReader(tmp_path / "run")
    assert result.finished and reader.outcome == "finished"
    assert [p.frames for p in told] == list(range(1, result.frames + 1))
    assert len(reader) == result.frames == told[-1].expected
    assert told[-1].poses == result.poses == sum(s.pose is not None for s in reader.summaries)
    header = reader.header
    assert (header.recording, header.recording_kind) == (str(recording.resolve()), "ros1")
    assert header.topics == {"cam0": "/cam0/image_raw/compressed", "imu": "/imu0", "truth": "/groundtruth"}
    assert header.params.window.max_iterations == 5
    assert header.origins["window.max_iterations"] == "set" and header.origins["window.size"] == "default"
    assert header.calibration.sources == (str(calibration),)
    assert header.backend and header.cpu
    assert reader.truth is not None and len(reader.truth) > 100
    stages = {"decode", "track", "preintegrate", "record"}
    assert all(stages <= s.ms.keys() and min(s.ms.values()) >= 0 for s in reader.summaries)


def test_start_and_duration_count_from_the_first_image(recording: Path, tmp_path: Path) -> None:
    calibration = [calibration_path(recording)]
    run_recording(recording, calibration, out=tmp_path / "all")
    run_recording(recording, calibration, out=tmp_path / "part", start_s=0.5, duration_s=1.0)
    first_ns = RunReader(tmp_path / "all").report(0).images[0].t_ns
    part = RunReader(tmp_path / "part")
    assert part.report(0).images[0].t_ns == first_ns + 500_000_000
    assert first_ns + 1_300_000_000 < part.summaries[-1].t_ns <= first_ns + 1_500_000_000
    assert (part.header.start_s, part.header.duration_s) == (0.5, 1.0)


def test_a_cancelled_run_keeps_its_frames_and_says_so(recording: Path, tmp_path: Path) -> None:
    answers = iter([False, False, True])
    result = run_recording(
        recording, [calibration_path(recording)], out=tmp_path / "run", cancelled=lambda: next(answers)
    )
    reader = RunReader(tmp_path / "run")
    assert (result.finished, result.frames, len(reader), reader.outcome) == (False, 3, 3, INTERRUPTED)


def test_embedded_images_are_those_of_the_recording(recording: Path, tmp_path: Path) -> None:
    from vins_core.io.recording import open_recording

    answers = iter([False, True])
    run_recording(
        recording,
        [calibration_path(recording)],
        out=tmp_path / "run",
        embed_images=True,
        cancelled=lambda: next(answers),
    )
    reader = RunReader(tmp_path / "run")
    with open_recording(recording, reader.header.calibration) as source:
        for k in range(2):
            for ref in reader.report(k).images:
                assert reader.load(ref).tobytes() == source.load(ref).tobytes()


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"settings": ["window.size=999"]}, ParameterError),
        ({"settings": ["window.size"]}, ParameterError),
        ({"calib": []}, CalibrationError),
        ({"recording": Path("nowhere.bag")}, RecordingError),
        ({"start_s": 1000.0}, RecordingError),
    ],
)
def test_no_folder_is_made_when_the_input_is_at_fault(
    recording: Path, tmp_path: Path, changes: dict, error: type[Exception]
) -> None:
    call = {"recording": recording, "calib": [calibration_path(recording)], "out": tmp_path / "run"} | changes
    with pytest.raises(error):
        run_recording(call.pop("recording"), call.pop("calib"), **call)
    assert not (tmp_path / "run").exists()


def test_an_occupied_folder_is_refused_before_anything_is_estimated(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("data")
    with pytest.raises(OutputError, match="never overwritten"):
        run_recording(recording, [calibration_path(recording)], out=tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["precious"]


def test_set_wins_over_config_wins_over_default() -> None:
    params, origins = choose_parameters({"frontend.max_cnt": 120, "frontend.min_dist": 25}, {"frontend.max_cnt": "140"})
    frontend = params.frontend
    assert (frontend.max_cnt, frontend.min_dist, frontend.freq) == (140, 25, 10.0)
    keys = ("frontend.max_cnt", "frontend.min_dist", "frontend.freq")
    assert [origins[k] for k in keys] == ["set", "config", "default"]
