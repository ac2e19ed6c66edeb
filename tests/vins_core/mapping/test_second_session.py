"""A map outlives its run: a second session finds itself in it and ends in its frame (REFERENCE U1-U5)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from looping import SETTINGS
from same import differences
from sample import CALIBRATION, RECORDING

from vins_core.errors import MapError, OutputError, RunError
from vins_core.evaluation.align import Similarity, align
from vins_core.evaluation.associate import associate
from vins_core.geometry.camera import camera_from_dict, camera_to_dict
from vins_core.io.write import write_recording
from vins_core.loop.consistency import Way
from vins_core.loop.keyframe import LoopKeyframe
from vins_core.mapping import maps
from vins_core.mapping.conclusion import final_graph, optimized_trajectory, save_map
from vins_core.mapping.study import LoopStudy
from vins_core.record.reader import RunReader
from vins_core.runner import run_recording
from vins_core.sensors import Trajectory
from vins_core.simulation.simulate import simulate


@pytest.fixture(scope="module")
def folder(looping_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of a run."""
    path = tmp_path_factory.mktemp("maps") / "map"
    save_map(RunReader(looping_run), path)
    return path


@pytest.fixture(scope="module")
def second(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> RunReader:
    """A run of later seconds of the same walk that begins with that map."""
    out = tmp_path_factory.mktemp("second") / "run"
    run_recording(RECORDING, [CALIBRATION], out=out, start_s=3.0, duration_s=4.0, settings=SETTINGS, map_folder=folder)
    return RunReader(out)


def against_truth(path: Trajectory, truth: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    i, j = associate(truth.t_ns, path.t_ns, 0.006)
    return path.p_w_b[j], truth.p_w_b[i]


def errors_m(path: Trajectory, truth: Trajectory, frame: Similarity) -> np.ndarray:
    found, true = against_truth(path, truth)
    return np.linalg.norm(frame.apply(found) - true, axis=1)


def test_a_map_holds_what_its_run_knew(looping_run: Path, folder: Path) -> None:
    run, loaded = RunReader(looping_run), maps.read(folder)
    graph = final_graph(run)
    np.testing.assert_array_equal(loaded.graph.T_corrected, graph.T_corrected)
    np.testing.assert_array_equal(loaded.graph.loops, graph.loops)
    assert all(session.base for session in loaded.graph.sessions)
    assert [d for a, b in zip(loaded.keyframes, run.keyframes, strict=True) for d in differences(a, b)] == []
    assert run.places is not None
    assert differences(loaded.vocabulary, run.places.vocabulary) == []


def test_all_loops_are_in_the_optimised_trajectory(looping_run: Path) -> None:
    run = RunReader(looping_run)
    assert run.truth is not None
    path, graph = optimized_trajectory(run), final_graph(run)
    accepted = [(r.accepted.match, r.accepted.query) for r in _judged(run) if r.accepted]
    assert sorted(map(tuple, graph.loops.tolist())) == sorted(accepted)
    assert len(path) == len(graph) and np.array_equal(path.t_ns, graph.t_ns)
    found, true = against_truth(path, run.truth)
    assert errors_m(path, run.truth, align(found, true)).max() < 0.03


def test_two_sessions_end_in_one_frame(looping_run: Path, second: RunReader) -> None:
    first = RunReader(looping_run)
    assert first.truth is not None and second.truth is not None and second.places is not None
    n_base = len(second.places.keyframes)
    assert n_base == len(first.keyframes)
    frame = align(*against_truth(optimized_trajectory(first), first.truth))
    path, graph = optimized_trajectory(second), final_graph(second)
    assert len(path) == len(graph) - n_base > 15
    assert errors_m(path, second.truth, frame).max() < 0.05
    assert len({session.group for session in graph.sessions}) == 1
    np.testing.assert_array_equal(graph.T_corrected[:n_base], second.places.graph.T_corrected)


def test_the_second_session_closes_loops_with_the_first(second: RunReader) -> None:
    study = LoopStudy(second)
    assert study.advance(10**6) == 0
    accepted = [r.accepted for r in study.judged() if r.accepted]
    assert any(c.match < study.first <= c.query for c in accepted)
    recorded = [row.match for row in study.rows() if row.number >= 0]
    assert [r.accepted.match if r.accepted else -1 for r in study.judged()] == recorded
    assert study.truth(accepted[0].query, accepted[0].match) is None  # the clocks of sessions have nothing in common


def test_a_second_session_is_saved_with_the_first(second: RunReader, tmp_path: Path) -> None:
    graph = save_map(second, tmp_path / "both")
    both = maps.read(tmp_path / "both")
    assert len(both.graph) == len(both.keyframes) == len(graph) and len(both.graph.sessions) == 2


def test_the_map_of_another_camera_is_refused(folder: Path, looping_run: Path) -> None:
    camera = RunReader(looping_run).header.calibration.cameras[0]
    other = camera_from_dict(**{**camera_to_dict(camera.model), "fx": 300.0})
    with pytest.raises(MapError, match=r"was made with another camera: fx .* in the map, fx 300.0 in this calibration"):
        maps.load(folder, replace(camera, model=other))


def test_a_damaged_map_is_refused_before_a_run_begins(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "map"
    copy.mkdir()
    for file in folder.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    part = copy / json.loads((copy / "map.json").read_text())["parts"]["keyframes-0"]["file"]
    data = bytearray(part.read_bytes())
    data[len(data) // 2] ^= 1
    part.write_bytes(bytes(data))
    with pytest.raises(MapError, match="is damaged: its checksum does not match; save the map again"):
        run_recording(RECORDING, [CALIBRATION], out=tmp_path / "run", duration_s=1.0, map_folder=copy)
    assert not (tmp_path / "run").exists()
    with pytest.raises(MapError, match=r"is not a map: it has no map.json"):
        maps.read(tmp_path)


def test_a_map_is_saved_only_where_there_is_one_and_over_nothing_else(looping_run: Path, tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "thesis.txt").write_text("irreplaceable")
    with pytest.raises(OutputError, match="exists and is not a map"):
        save_map(RunReader(looping_run), tmp_path / "notes")
    run_recording(RECORDING, [CALIBRATION], out=tmp_path / "run", duration_s=0.5)
    with pytest.raises(RunError, match="has no keyframes yet"):
        save_map(RunReader(tmp_path / "run"), tmp_path / "map")
    run_recording(RECORDING, [CALIBRATION], out=tmp_path / "off", duration_s=0.5, settings=["loop.enabled=off"])
    for ask in (final_graph, optimized_trajectory):
        with pytest.raises(RunError, match="has no loops: it was made with --loops off"):
            ask(RunReader(tmp_path / "off"))


def _judged(run: RunReader) -> list:
    study = LoopStudy(run)
    study.advance(10**6)
    return list(study.judged())


def _on(way: Way, **changes: int) -> Way:
    return replace(way, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "forge",
    [
        lambda k: replace(k, descriptors=k.descriptors[1:]),
        lambda k: replace(k, bag=replace(k.bag, words=k.bag.words + 10**6)),
        lambda k: replace(k, points_w=k.points_w[:, :2]),
        lambda k: replace(k, odometry=np.zeros((3, 3))),
        lambda k: replace(k, node=replace(k.node, tied=_on(k.node.tied, chain=30, tie=30))),
        lambda k: replace(k, node=replace(k.node, tied=_on(k.node.tied, chain=99, tie=98))),
        lambda k: replace(k, node=replace(k.node, odometry=_on(k.node.odometry, tree=5, chain=7, tie=4))),
    ],
)
def test_a_keyframe_that_no_loop_stage_made_is_refused(looping_run: Path, forge: Callable[..., LoopKeyframe]) -> None:
    """Ways that lead back to no root would never end."""
    run = RunReader(looping_run)
    assert run.places is not None
    for number, keyframe in enumerate(run.keyframes):
        maps.check_keyframe(number, keyframe, run.places.vocabulary)
    with pytest.raises(ValueError, match=r"keyframe 30 (contradicts itself|is reached from no earlier one)"):
        maps.check_keyframe(30, forge(run.keyframes[30]), run.places.vocabulary)


@pytest.mark.slow
def test_two_sessions_of_a_building_end_in_one_frame(tmp_path: Path) -> None:
    """Entered by another room and walked the other way."""
    for name in ("building_first", "building_second"):
        simulation = simulate(name, seed=1)
        write_recording(simulation.messages(), tmp_path / f"{name}.rec", "asl", settings=simulation.settings)
    run_recording(tmp_path / "building_first.rec", out=tmp_path / "first")
    first = RunReader(tmp_path / "first")
    save_map(first, tmp_path / "map")
    run_recording(tmp_path / "building_second.rec", out=tmp_path / "second", map_folder=tmp_path / "map")
    second = RunReader(tmp_path / "second")
    assert first.truth is not None and second.truth is not None
    frame = align(*against_truth(optimized_trajectory(first), first.truth))
    for run in (first, second):
        errors = errors_m(optimized_trajectory(run), run.truth, frame)
        assert np.sqrt(np.mean(np.square(errors))) < 0.05
