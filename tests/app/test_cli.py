"""The command line as a contract: names, outputs, exit codes, one sentence for each mistake."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import record_samples as samples

from app.__main__ import main
from app.commands.arguments import describe
from app.commands.simulate import NAMES
from vins_core.errors import RunError
from vins_core.io.trajectory import read_trajectory
from vins_core.params import DECLARATIONS
from vins_core.record.reader import RunReader
from vins_core.record.writer import RunWriter
from vins_core.simulation.scenarios import SCENARIOS

POSES, EVAL_KEYS = (
    20,
    ["poses", "pairs", "ate_rmse_m", "ate_max_m", "rotation_rmse_deg", "scale", "rpe_rmse_m", "first_pose_s"],
)


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated recording and its run, made by the commands under test."""
    folder = tmp_path_factory.mktemp("cli")
    simulate = ["simulate", "room_loop", "--out", f"{folder}/room.bag", "--format", "ros1", "--duration", "4"]
    assert main([*simulate, "--seed", "3"]) == 0
    assert main(["run", f"{folder}/room.bag", "--calib", f"{folder}/room.yaml", "--out", f"{folder}/run"]) == 0
    return folder


def poses(run: Path) -> list[bytes]:
    pose = [s.pose for s in RunReader(run).summaries]
    return [b"".join(np.asarray(v).tobytes() for v in vars(p).values()) if p else b"" for p in pose]


def test_run_writes_a_run_that_initialises(work: Path) -> None:
    reader = RunReader(work / "run")
    assert reader.complete and reader.outcome == "finished"
    assert sum(s.pose is not None for s in reader.summaries) >= POSES


def test_eval_prints_only_json_with_the_promised_keys(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", f"{work}/run", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found)[: len(EVAL_KEYS)] == EVAL_KEYS
    assert found["poses"] == found["pairs"] >= POSES
    assert found["first_pose_s"] == pytest.approx(RunReader(work / "run").header.params.window.size / 10, abs=0.5)
    assert 0 < found["ate_rmse_m"] <= found["ate_max_m"]


def test_eval_takes_truth_from_a_file_and_defaults_to_the_recordings_own(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = RunReader(work / "run").truth
    assert truth is not None
    rows = np.column_stack([truth.p_w_b, np.roll(truth.q_w_b, -1, 1)])
    tum = [
        f"{t // 10**9}.{t % 10**9:09d} " + " ".join(map(repr, r)) for t, r in zip(truth.t_ns.tolist(), rows.tolist())
    ]
    (tmp_path / "truth.tum").write_text("\n".join(tum))
    rows = np.column_stack([truth.p_w_b, truth.q_w_b])
    csv = ["#t, p, q"] + [",".join([str(t), *map(repr, r)]) for t, r in zip(truth.t_ns.tolist(), rows.tolist())]
    (tmp_path / "truth.csv").write_text("\n".join(csv))
    found = []
    for extra in ([], ["--truth", f"{tmp_path}/truth.tum"], ["--truth", f"{tmp_path}/truth.csv", "--max-dt", "0.001"]):
        assert main(["eval", f"{work}/run", "--json", *extra]) == 0
        found.append(json.loads(capsys.readouterr().out))
    assert found[0] == found[1] == found[2]


def test_eval_without_json_names_every_number(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", f"{work}/run"]) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) == len(EVAL_KEYS) and "ATE rmse" in out


def test_export_writes_the_poses_as_they_were_right_after_their_own_solve(work: Path, tmp_path: Path) -> None:
    assert main(["export", f"{work}/run", "--tum", f"{tmp_path}/run.tum"]) == 0
    written, reader = read_trajectory(tmp_path / "run.tum"), RunReader(work / "run")
    kept = [(s.t_ns, s.pose) for s in reader.summaries if s.pose]
    assert written.t_ns.tolist() == [t for t, _ in kept]
    assert written.p_w_b.tobytes() == np.array([p.p_w_b for _, p in kept]).tobytes()
    assert written.q_w_b.tobytes() == np.array([p.q_w_b for _, p in kept]).tobytes()


def test_the_body_is_exported_and_evaluated_at_every_imu_sample(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", f"{work}/run", "--tum", f"{tmp_path}/run.tum", "--trajectory", "imu_rate"]) == 0
    written, reader = read_trajectory(tmp_path / "run.tum"), RunReader(work / "run")
    assert len(written) > 10 * sum(s.pose is not None for s in reader.summaries)
    capsys.readouterr()
    assert main(["eval", f"{work}/run", "--json", "--trajectory", "imu_rate"]) == 0
    assert json.loads(capsys.readouterr().out)["poses"] == len(written)


def test_info_prints_only_json(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", f"{work}/room.bag", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    imu = next(s for s in found["streams"] if s["role"] == "imu")
    assert (imu["topic"], imu["rate_hz"]) == ("/imu0", pytest.approx(200.0))
    assert found["duration_s"] == pytest.approx(4.0)
    assert found["backend"] and "numpy" in found["versions"] and found["anomalies"] == []


def test_info_shows_every_topic_with_type_and_rate(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", f"{work}/room.bag"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"/imu0 +sensor_msgs/msg/Imu +imu +801 +200.00", out)
    assert "0 anomalies" in out and "back end: " in out


@pytest.mark.parametrize("format", ["asl", "ros2", "mcap"])
def test_a_converted_recording_gives_bit_identical_poses(work: Path, tmp_path: Path, format: str) -> None:
    calib = ["--calib", f"{work}/room.yaml"]
    assert main(["convert", f"{work}/room.bag", f"{tmp_path}/room", "--format", format]) == 0
    assert main(["run", f"{tmp_path}/room", *calib, "--out", f"{tmp_path}/run"]) == 0
    assert poses(tmp_path / "run") == poses(work / "run")


def test_set_start_and_duration_reach_the_run(work: Path, tmp_path: Path) -> None:
    window = ["--start", "0.5", "--duration", "1", "--set", "window.size=8", "--set", "frontend.max_cnt=100"]
    assert main(["run", f"{work}/room.bag", "--calib", f"{work}/room.yaml", "--out", f"{tmp_path}/run", *window]) == 0
    reader = RunReader(tmp_path / "run")
    assert (reader.header.params.window.size, reader.header.params.frontend.max_cnt) == (8, 100)
    assert reader.summaries[-1].t_ns - reader.report(0).images[0].t_ns <= 1_000_000_000


@pytest.fixture
def lost(tmp_path: Path) -> Path:
    """A run without a single pose and without truth."""
    with RunWriter(tmp_path / "lost", samples.header()):
        pass
    return tmp_path / "lost"


MISTAKES = {
    "recording that is not there": (["run", "no.bag", "--out", "{tmp}/o"], r"no\.bag: no such file or folder"),
    "calibration left out": (["run", "{work}/room.bag", "--out", "{tmp}/o"], r"a calibration is needed .*--calib"),
    "calibration that is not there": (
        ["run", "{work}/room.bag", "--calib", "no.yaml", "--out", "{tmp}/o"],
        r"no\.yaml",
    ),
    "unknown parameter": (
        ["run", "{work}/room.bag", "--calib", "{work}/room.yaml", "--out", "{tmp}/o", "--set", "window.iterations=3"],
        r"unknown parameter 'window\.iterations'; did you mean window\.max_iterations",
    ),
    "parameter out of range": (
        ["run", "{work}/room.bag", "--calib", "{work}/room.yaml", "--out", "{tmp}/o", "--set", "window.size=99"],
        r"window\.size='99': expected int from 4 to 20",
    ),
    "parameter without a value": (
        ["run", "{work}/room.bag", "--calib", "{work}/room.yaml", "--out", "{tmp}/o", "--set", "window.size"],
        r"not of the form section\.name=value",
    ),
    "run folder in use": (
        ["run", "{work}/room.bag", "--calib", "{work}/room.yaml", "--out", "{work}/run"],
        r"run is not empty; a run is never overwritten",
    ),
    "run folder that cannot be made": (
        ["run", "{work}/room.bag", "--calib", "{work}/room.yaml", "--out", "{work}/room.bag/run"],
        r"cannot create the run folder .*Not a directory",
    ),
    "something that is no recording": (["info", "{work}/room.yaml"], r"room\.yaml: not a recording; expected"),
    "empty folder": (["info", "{tmp}"], r"an empty folder; expected"),
    "recording in place of a run": (["eval", "{work}/room.bag"], r"room\.bag is not a folder; a run is the folder"),
    "folder that is no run": (["export", "{tmp}", "--tum", "{tmp}/x"], r"is not a run: it has no header\.json"),
    "truth missing": (["eval", "{lost}"], r"has no ground truth; give one with --truth FILE"),
    "truth that cannot be read": (["eval", "{work}/run", "--truth", "{work}/room.yaml"], r"room\.yaml, line \d+: "),
    "truth of another time": (["eval", "{work}/run", "--truth", "{tmp}/old.tum"], r"only 0 of \d+ poses have truth"),
    "export of a run without poses": (["export", "{lost}", "--tum", "{tmp}/x.tum"], r"has no poses: it never init"),
    "export to nowhere": (["export", "{work}/run", "--tum", "{tmp}/no/x.tum"], r"no/x\.tum: cannot be written"),
    "conversion onto something": (
        ["convert", "{work}/room.bag", "{work}/room.yaml", "--format", "asl"],
        r"exists already and is not overwritten",
    ),
    "unknown scenario": (
        ["simulate", "moon", "--out", "{tmp}/o", "--format", "asl"],
        r"unknown scenario 'moon'; expected one of room_loop",
    ),
    "page of something that is not there": (["open", "no.bag", "--no-browser"], r"no\.bag: no such file or folder"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_answered_by_one_sentence_and_exit_code_2(
    mistake: str, work: Path, lost: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "old.tum").write_text("1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0 1\n")
    folder = tmp_path / "empty" if mistake == "empty folder" else tmp_path
    folder.mkdir(exist_ok=True)
    arguments, message = MISTAKES[mistake]
    capsys.readouterr()
    assert main([a.format(work=work, tmp=folder, lost=lost) for a in arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert re.search(message, printed.err)
    assert printed.err.startswith("vinspect: ") and printed.err.count("\n") == 1
    assert not (folder / "o").exists()


@pytest.mark.parametrize(
    "arguments", [["rn"], ["run"], ["run", "x"], ["run", "x", "--out", "y", "--start", "soon"], ["info", "--csv", "x"]]
)
def test_a_command_line_that_cannot_be_parsed_exits_with_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_a_run_that_never_initialised_evaluates_to_no_poses(
    lost: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "truth.tum").write_text("1.0 0 0 0 0 0 0 1\n")
    assert main(["eval", str(lost), "--truth", f"{tmp_path}/truth.tum", "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out) == dict.fromkeys(EVAL_KEYS) | {"poses": 0, "pairs": 0}
    assert "never initialised" in printed.err


def test_run_help_names_every_parameter(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--help"]) == 0
    out = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
    for declared in DECLARATIONS.values():
        assert re.sub(r"\s+", " ", describe(declared))[:40] in out


def test_simulate_names_every_scenario() -> None:
    assert set(NAMES.split(", ")) == set(SCENARIOS)


def test_every_command_of_the_contract_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"• {name} " in out for name in ("run", "info", "eval", "export", "convert", "simulate", "open"))


def test_without_arguments_the_sample_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    import app.server

    calls: list[tuple] = []
    monkeypatch.setattr(app.server, "open_browser", lambda *a: calls.append(a))
    assert main([]) == 0
    assert main(["open", str(Path(__file__)), "--calib", "a.yaml", "--port", "9", "--host", "::1", "--no-browser"]) == 0
    assert calls == [
        (None, (), "127.0.0.1", 8080, False),
        (Path(__file__), (Path("a.yaml"),), "::1", 9, True),
    ]


def python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_help_is_fast_because_it_imports_nothing_heavy() -> None:
    code = "import sys; from app.__main__ import main; main(['run', '--help']); print(*sys.modules, file=sys.stderr)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr.split()
    assert "tyro" in loaded
    assert not {"numpy", "cv2", "casadi", "scipy", "viser", "rosbags"} & set(loaded)


def test_linear_algebra_has_one_thread_whatever_the_environment_says() -> None:
    code = "import app.__main__, os; print(os.environ['OPENBLAS_NUM_THREADS'], os.environ['OMP_NUM_THREADS'])"
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "8", "OMP_NUM_THREADS": "8"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.split() == ["1", "1"]


def test_as_a_program_a_mistake_exits_with_2_without_a_traceback() -> None:
    done = subprocess.run([sys.executable, "-m", "app", "info", "no.bag"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "vinspect: no.bag: no such file or folder\n"


@pytest.mark.parametrize(("blow", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_a_run_that_is_stopped_leaves_every_frame_it_had(work: Path, tmp_path: Path, blow: int, code: int) -> None:
    command = [sys.executable, "-m", "app", "run", f"{work}/room.bag", "--calib", f"{work}/room.yaml"]
    child = subprocess.Popen([*command, "--out", f"{tmp_path}/run"], stderr=subprocess.PIPE, text=True)
    while (seen := frames_so_far(tmp_path / "run")) < 3:
        assert child.poll() is None
        time.sleep(0.005)
    child.send_signal(blow)
    _, said = child.communicate()
    assert child.returncode == code and "Traceback" not in said
    reader = RunReader(tmp_path / "run")
    assert len(reader) >= seen
    assert reader.outcome == ("interrupted" if blow == signal.SIGINT else None)
    assert poses(tmp_path / "run") == poses(work / "run")[: len(reader)]
    reader.state(len(reader) - 1)
    assert main(["export", f"{tmp_path}/run", "--tum", f"{tmp_path}/x"]) in (0, 2)


def frames_so_far(run: Path) -> int:
    try:
        with RunReader(run) as reader:
            return len(reader)
    except RunError:  # not there yet
        return 0
