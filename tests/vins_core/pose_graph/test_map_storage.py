import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pose_graph_world import laps, settings, trajectory

from vins_core.errors import MapError, OutputError
from vins_core.geometry import poses
from vins_core.geometry.camera import CameraModel, camera_from_dict, camera_to_dict
from vins_core.pose_graph import graph as G
from vins_core.pose_graph.optimize import optimize
from vins_core.pose_graph.storage import load_map, save_map

CAMERA: CameraModel = camera_from_dict(
    "pinhole-radtan", width=752, height=480, fx=458.6, fy=457.3, cx=367.2, cy=248.4, k1=-0.28, k2=0.07, p1=0.0, p2=0.0
)


@pytest.fixture
def graph() -> G.PoseGraph:
    """Two merged sessions, one disabled and one forced edge, optimised."""
    graph = G.begin_session(laps().graph)
    for k, T in enumerate(trajectory(20, 50)):
        graph = G.add_keyframe(graph, k, k, T[:3] + 4.0, T[3:])
    T = poses.between(*trajectory(20, 50)[[3, 9]])
    graph = G.add_loop(settings(), graph, 3, 169, T[:3], T[3:])
    graph = G.force(G.disable(graph, 4, 5), *graph.loops[2].tolist())
    return optimize(settings(), graph)[0]


@pytest.fixture
def saved(graph, tmp_path) -> Path:
    save_map(tmp_path / "map", CAMERA, graph, {"descriptors": b"of another stage"})
    return tmp_path / "map"


def edit(folder: Path, **changes) -> None:
    header = json.loads((folder / "map.json").read_text())
    (folder / "map.json").write_text(json.dumps({**header, **changes}))


def part(folder: Path, name: str = "graph") -> Path:
    return folder / json.loads((folder / "map.json").read_text())["parts"][name]["file"]


def test_what_was_saved_comes_back_exactly_as_base_sessions(graph, saved):
    loaded, parts = load_map(saved, CAMERA)
    assert parts == {"descriptors": b"of another stage"}
    for name in ("frame", "t_ns", "session", "T_vio", "T_corrected", "loops", "T_loops"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(graph, name), err_msg=name)
    assert (loaded.disabled, loaded.forced) == (graph.disabled, graph.forced)
    for there, here in zip(loaded.sessions, graph.sessions, strict=True):
        assert there.base and not here.base
        assert (there.first, there.group) == (here.first, here.group)
        np.testing.assert_array_equal(there.drift, here.drift)


def test_an_empty_graph_is_a_map_too(tmp_path):
    save_map(tmp_path / "map", CAMERA, G.PoseGraph())
    assert len(load_map(tmp_path / "map", CAMERA)[0]) == 0


def test_saving_the_same_graph_twice_gives_the_same_bytes(graph, saved, tmp_path):
    save_map(tmp_path / "again", CAMERA, graph, {"descriptors": b"of another stage"})
    names = sorted(p.name for p in saved.iterdir())
    assert names == sorted(p.name for p in (tmp_path / "again").iterdir())
    assert all((saved / n).read_bytes() == (tmp_path / "again" / n).read_bytes() for n in names)


def test_saving_over_a_map_replaces_all_of_it(graph, saved):
    save_map(saved, CAMERA, laps().graph)
    assert len(load_map(saved, CAMERA)[0]) == len(laps().graph)
    assert sorted(p.name for p in saved.iterdir()) == sorted(["map.json", part(saved).name])


def test_a_second_session_merges_into_a_loaded_map_and_leaves_it_where_it_is(saved):
    loaded, _ = load_map(saved, CAMERA)
    n, lap = len(loaded), trajectory(60, 50)
    graph = G.begin_session(loaded)
    for k, T in enumerate(poses.compose(np.array([9.0, 2, 1, 0.6, 0, 0, 0.8]), lap)):
        graph = G.add_keyframe(graph, k, k, T[:3], T[3:])
    T = poses.between(loaded.T_corrected[10], lap[10])
    merged = G.add_loop(settings(), graph, 10, n + 10, T[:3], T[3:])
    np.testing.assert_allclose(merged.T_corrected[n:, :3], lap[:, :3], atol=1e-9)
    T = poses.between(loaded.T_corrected[30], lap[30])
    optimized, report = optimize(settings(), G.add_loop(settings(), merged, 30, n + 30, T[:3], T[3:]))
    np.testing.assert_array_equal(optimized.T_corrected[:n], loaded.T_corrected)
    assert report.first_free == n


@pytest.mark.parametrize("other", [{"fx": 460.0}, {"width": 640}])
def test_a_map_of_another_camera_is_refused_naming_what_differs(saved, other):
    values = {**camera_to_dict(CAMERA), **other}
    with pytest.raises(MapError, match=f"another camera: {next(iter(other))} ") as refusal:
        load_map(saved, camera_from_dict(values.pop("model"), **values))
    assert str(next(iter(other.values()))) in str(refusal.value)


def test_every_damaged_byte_is_noticed(saved):
    path = part(saved)
    good = path.read_bytes()
    for at in range(0, len(good), max(len(good) // 40, 1)):
        path.write_bytes(good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :])
        with pytest.raises(MapError, match="checksum"):
            load_map(saved, CAMERA)


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (lambda m: part(m).write_bytes(part(m).read_bytes()[:-8]), "bytes, expected"),
        (lambda m: part(m, "descriptors").unlink(), "lacks its part"),
        (lambda m: (m / "map.json").unlink(), "is not a map"),
        (lambda m: (m / "map.json").write_text("{"), "is damaged"),
        (lambda m: (m / "map.json").write_text("[" * 100_000), "is damaged"),
        (lambda m: (m / "map.json").write_text(" " * (2 << 20)), "too large"),
        (lambda m: edit(m, format="something else"), "not the header of a map"),
        (lambda m: edit(m, schema=99), "map schema 99"),
        (lambda m: edit(m, keyframes="many"), "is damaged"),
        (lambda m: edit(m, keyframes=1), "other keyframes"),
        (lambda m: edit(m, parts={}), "names no pose graph"),
        (lambda m: edit(m, parts={"graph": {"file": "../secret", "bytes": 1, "sha256": ""}}), "lacks its part"),
        (lambda m: edit(m, parts={"graph": {"file": "map.json", "bytes": -1, "sha256": ""}}), "bytes, expected"),
    ],
)
def test_a_damaged_map_is_refused_with_one_sentence(saved, harm, says):
    harm(saved)
    with pytest.raises(MapError, match=says) as refusal:
        load_map(saved, CAMERA)
    assert "\n" not in str(refusal.value) and str(saved) in str(refusal.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"T_vio": np.zeros((180, 7))}, "no pose"),
        ({"T_corrected": np.full((180, 7), np.nan)}, "no pose"),
        ({"T_corrected": np.zeros((3, 7))}, "expected"),
        ({"frame": np.zeros(180)}, "expected"),
        ({"loops": np.array([[5, 999]]), "T_loops": poses.IDENTITY[None]}, "do not exist"),
        ({"loops": np.array([[5, 2]]), "T_loops": poses.IDENTITY[None]}, "do not exist"),
        ({"session": np.ones(180, np.int32)}, "sessions"),
        ({"sessions": ()}, "sessions"),
        ({"sessions": (G.Session(0, poses.IDENTITY, 5), G.Session(160, poses.IDENTITY, 0))}, "grouped"),
    ],
)
def test_contents_that_contradict_themselves_are_refused(graph, tmp_path, monkeypatch, change, says):
    """Checksums protect against accidents; a map made by hand must not bring the program down either."""
    from vins_core.pose_graph import storage

    plain = storage._contents
    monkeypatch.setattr(storage, "_contents", lambda g: replace(plain(g), **change))
    save_map(tmp_path / "map", CAMERA, graph)
    with pytest.raises(MapError, match=says):
        load_map(tmp_path / "map", CAMERA)


def test_a_folder_with_other_things_in_it_is_left_alone(graph, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match="is not a map"):
        save_map(tmp_path, CAMERA, graph)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]
