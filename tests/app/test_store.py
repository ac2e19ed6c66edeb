"""The runs a server knows, two of them on one clock, and the list as a page: without a browser."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest
from fake_reports import context, parse
from fake_run import FRAMES, fake_run

from app.comparison import OtherRun, in_world_of, related, same_instants
from app.context import RunView
from app.notes import FILE, MAX_NAME, RunNotes, read_notes
from app.panels import runs as panel
from app.runs import open_path
from app.store import RunStore
from app.worker import KEEP_RUNS, cache_folder, new_run_folder
from vins_core.record.compare import compare
from vins_core.record.header import Parent
from vins_core.record.reader import RunReader

EVIL = """<img src=x onerror="alert('1')">'"`</div>"""


def write(folder: Path, parent: Parent | None = None, frames: int = 30, id: str = "") -> Path:
    run = fake_run(frames)
    run.header = dataclasses.replace(run.header, parent=parent, **({"id": id} if id else {}))
    return run.write(folder)


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    return RunStore(open_path(write(tmp_path / "first", id="a" * 12)))


def fork_in_cache(store: RunStore, name: str = "fork", at: int = 20) -> str:
    first = store.first.id
    cache_folder().mkdir(parents=True, exist_ok=True)
    write(cache_folder() / name, Parent(first, "/elsewhere", at, {"window.loss": "none"}), id="f" * 12)
    store.scan()
    return "f" * 12


def test_runs_in_the_cache_are_found_once(store: RunStore) -> None:
    id = fork_in_cache(store)
    store.scan()
    assert [run.id for run in store] == [store.first.id, id]
    assert store.get(id) is not None and store.get("") is None and store.get("../../etc") is None


def test_what_is_no_run_is_not_listed(store: RunStore) -> None:
    (cache_folder() / "junk").mkdir(parents=True)
    (cache_folder() / "junk" / "header.json").write_text("{}")
    store.scan()
    assert len(list(store)) == 1


def test_a_fork_stands_below_its_run_with_what_was_changed(store: RunStore) -> None:
    fork_in_cache(store)
    first, fork = store.entries()
    assert first.parent is None and fork.parent is not None and fork.parent.frame == 20
    assert fork.name == "fork at 20" and fork.changes == {"window.loss": "none"}
    assert fork.frames == 30 and fork.poses > 0 and np.isfinite(fork.ate_m)


def test_names_and_keeping_survive_the_server(store: RunStore) -> None:
    store.rename(store.first, "  best \n so far " + "x" * 200)
    store.keep(store.first, True)
    assert store.first.folder is not None
    again = RunStore(open_path(store.first.folder))
    assert again.name(again.first).startswith("best so far xxx") and len(again.name(again.first)) == MAX_NAME
    assert again.notes(again.first).kept


def test_damaged_notes_are_none(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"\xff{" * 50_000)
    assert read_notes(tmp_path) == RunNotes() == read_notes(None)


def test_kept_runs_are_not_removed_when_newer_ones_come(monkeypatch: pytest.MonkeyPatch) -> None:
    cache_folder().mkdir(parents=True)
    for k in range(KEEP_RUNS + 3):
        folder = cache_folder() / f"old-{k}"
        folder.mkdir()
        if k == 0:
            (folder / FILE).write_bytes(msgspec.json.encode(RunNotes("mine", kept=True)))
    later = (cache_folder() / "old-0").stat().st_mtime + 7200
    monkeypatch.setattr("app.worker.time.time", lambda: later)
    new_run_folder(Path("room.bag"))
    left = sorted(p.name for p in cache_folder().iterdir())
    assert "old-0" in left and len(left) == KEEP_RUNS


# Two runs on one clock


def views(tmp_path: Path) -> tuple[RunView, RunView]:
    first = write(tmp_path / "a", id="a" * 12)
    second = write(tmp_path / "b", Parent("a" * 12, "", 20, {}), frames=25)
    return RunView(RunReader(first)), RunView(RunReader(second))


def test_frames_meet_by_stamp(tmp_path: Path) -> None:
    a, b = views(tmp_path)
    rows = same_instants(a, b)
    assert rows.tolist() == [*range(25), *[-1] * 5]
    assert same_instants(b, a).tolist() == list(range(25))


def test_a_fork_lives_in_the_world_of_its_run_others_are_aligned(tmp_path: Path) -> None:
    a, b = views(tmp_path)
    assert related(a, b)
    np.testing.assert_array_equal(in_world_of(a, b), b.series.p_w_b)
    run = fake_run(30)
    c, s = np.cos(0.7), np.sin(0.7)
    R, t = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.array([3.0, -2.0, 1.0])
    run.summaries = [
        s if s.pose is None else dataclasses.replace(s, pose=dataclasses.replace(s.pose, p_w_b=R @ s.pose.p_w_b + t))
        for s in run.summaries
    ]
    stranger = RunView(run)  # type: ignore[arg-type]
    assert not related(a, stranger)
    np.testing.assert_allclose(in_world_of(a, stranger), a.series.p_w_b, atol=1e-9)


def test_values_of_the_other_run_stand_on_the_clock_of_this_one(tmp_path: Path) -> None:
    a, b = views(tmp_path)
    other = OtherRun(b, "b", "b", False, same_instants(a, b), in_world_of(a, b))
    values = other.on_clock(b.series.t_s)
    np.testing.assert_allclose(values[:25], a.series.t_s[:25])
    assert np.isnan(values[25:]).all() and other.at(24) == 24 and other.at(25) is None and other.at(FRAMES) is None


# The page


def listed(store: RunStore, **changes: object):
    view = store.first.view
    assert view is not None
    return context(12, run=view, runs=store.entries(), run_id=store.first.id, **changes)


def test_the_list_marks_the_run_shown_and_the_one_compared(store: RunStore) -> None:
    id = fork_in_cache(store)
    fork, first = store.get(id), store.first
    assert fork is not None and fork.view is not None and first.view is not None
    found = compare(first.view.reader, fork.view.reader)
    other = OtherRun(
        fork.view, id, "f", False, same_instants(first.view, fork.view), in_world_of(first.view, fork.view), found
    )
    page = parse(panel.render(listed(store, other=other)))
    sides = {e.attributes["data-run"]: e.children[0].children[0].text for e in page.all(cls="vi-run")}
    assert sides == {store.first.id: "A", id: "B"}
    assert page.one(data_first="none")
    assert "ATE, shared poses" in page.text and "mean cost" in page.text


def test_alone_the_list_says_how_to_fork(store: RunStore) -> None:
    assert "Nothing to compare with yet" in parse(panel.render(listed(store))).text


def test_hostile_names_and_ids_stay_text(store: RunStore) -> None:
    store.rename(store.first, EVIL)
    ctx = listed(store)
    forged = dataclasses.replace(ctx.runs[0], id="');alert(1)//", error=EVIL)
    html = panel.render(dataclasses.replace(ctx, runs=(*ctx.runs, forged)))
    assert "<img src=x" not in html
    page = parse(html)
    assert page.all("input", cls="vi-runname")[0].attributes["value"] == EVIL
    for element in page.all():
        for name, value in element.attributes.items():
            if name.startswith("on"):
                assert "alert(1)" not in value or (value.startswith("vi.send({") and '"id":"\');alert(1)//"' in value)
