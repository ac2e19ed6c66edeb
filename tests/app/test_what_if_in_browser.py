"""What a user can do with parameters, forks and runs, in headless Chromium on an estimated run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from chromium import OpenPage, Serve, move, open_tab, session_of, wait_for_frame, wait_until
from playwright.sync_api import Page, expect
from sample import INITIALISED

from app.runs import open_path
from app.server import Server
from vins_core.io.params_yaml import read_params
from vins_core.params import DECLARATIONS
from vins_core.record.reader import RunReader

pytestmark = pytest.mark.browser
FRAME = 25


@pytest.fixture
def server(serve: Serve, sample_run: Path) -> Server:
    """A server of its own for every test, because forks stay in the list."""
    return serve(open_path(sample_run))


@pytest.fixture
def page(server: Server, open_page: OpenPage) -> Page:
    page = open_page(server)
    page.evaluate(f"vi.send({{k: 'frame', i: {FRAME}}})")
    wait_for_frame(page, FRAME)
    return page


def test_every_parameter_is_a_knob_and_the_search_finds_them(page: Page) -> None:
    open_tab(page, "What-if")
    rows = page.locator("[data-knob]")
    expect(rows).to_have_count(len(DECLARATIONS))
    page.get_by_label("find a parameter").fill("robust loss")
    meant = [d for d in DECLARATIONS.values() if "robust loss" in f"{d.key} {d.doc}".lower()]
    assert 0 < len(meant) < len(DECLARATIONS)
    expect(page.locator("[data-knob]:visible")).to_have_count(len(meant))
    expect(page.locator("[data-knob='window.loss_scale']")).to_be_visible()
    page.get_by_label("find a parameter").fill("")
    expect(page.locator("[data-knob='window.max_error_px']")).to_be_visible()


def test_the_parameter_behind_a_gate_leads_to_its_knob(page: Page) -> None:
    open_tab(page, "Gates")
    page.locator("[data-vip=gates] .vi-knob", has_text="window.keyframe_parallax").first.click()
    knob = page.locator("[data-knob='window.keyframe_parallax']")
    expect(knob).to_have_class(re.compile("vi-focus"))
    expect(knob).to_be_in_viewport()


def test_a_slider_value_is_the_one_that_its_place_means(page: Page, server: Server) -> None:
    open_tab(page, "What-if")
    move(page, "window.pixel_sigma", 0)
    wait_until(page, lambda: session_of(server).experiment.changes == {"window.pixel_sigma": 0.1})
    page.locator("[data-knob='window.pixel_sigma'] .vi-num").fill("2.25")
    page.keyboard.press("Enter")
    wait_until(page, lambda: session_of(server).experiment.changes == {"window.pixel_sigma": 2.25})
    expect(page.locator("[data-knob='window.pixel_sigma']")).to_have_class(re.compile("vi-changed"))
    page.locator("[data-knob='window.pixel_sigma'] .vi-undo").click()
    wait_until(page, lambda: session_of(server).experiment.changes == {})
    expect(page.locator("[data-knob='window.pixel_sigma']")).not_to_have_class(re.compile("vi-changed"))


def test_moving_a_limit_counts_what_would_change_and_leads_there(page: Page) -> None:
    open_tab(page, "What-if")
    move(page, "window.keyframe_parallax", 900)
    panel = page.locator("[data-vip=what_if]").last
    expect(panel).to_contain_text("given the recorded trajectory")
    flips = panel.locator(".vi-flips").first
    expect(flips).to_contain_text("keyframe")
    link = flips.locator(".vi-link").first
    frame = int(link.inner_text())
    link.click()
    wait_for_frame(page, frame)


def test_the_window_is_solved_again_and_stands_beside_the_recorded_one(page: Page, server: Server) -> None:
    open_tab(page, "What-if")
    move(page, "window.pixel_sigma", 400)
    panel = page.locator("[data-vip=what_if]").last
    expect(panel).to_contain_text("states of the window", ignore_case=True)
    for words in ("visual", "IMU", "prior", "landmarks solved", "projections", "mean error, shared"):
        expect(panel).to_contain_text(words)
    solved = session_of(server).experiment.look(session_of(server).opened.view, FRAME, asking=False).solved
    assert solved is not None and not solved.reran_frontend
    assert solved.after.solve is not None and solved.before.solve is not None
    assert solved.after.solve.after.visual < solved.before.solve.after.visual


def test_with_the_front_end_run_again_tracks_that_differ_are_drawn_in_the_image(page: Page) -> None:
    open_tab(page, "What-if")
    page.get_by_label("find a parameter").fill("tracks kept")
    page.locator("[data-knob='frontend.max_cnt'] .vi-num").fill("60")
    page.keyboard.press("Enter")
    expect(page.get_by_label("run the front end again")).to_be_checked()
    page.locator("[data-vip=camera] [data-changes]").wait_for()
    assert page.locator("[data-vip=camera] [data-gone]").count() > 0


def test_stepping_goes_on_while_windows_are_solved_again(page: Page) -> None:
    open_tab(page, "What-if")
    move(page, "window.pixel_sigma", 400)
    for k in range(1, 6):
        page.keyboard.press("ArrowRight")
        wait_for_frame(page, FRAME + k)
    expect(page.locator("[data-vip=what_if]").last).to_contain_text(f"frame {FRAME + 5} again", ignore_case=True)


def test_changed_parameters_are_saved_for_a_run_and_loaded_back(page: Page, server: Server, tmp_path: Path) -> None:
    open_tab(page, "What-if")
    move(page, "window.pixel_sigma", 0)
    wait_until(page, lambda: bool(session_of(server).experiment.changes))
    with page.expect_download() as download:
        page.get_by_role("button", name="save", exact=True).click()
    file = tmp_path / "tuned.yaml"
    download.value.save_as(file)
    assert read_params(file)["window.pixel_sigma"] == 0.1
    page.get_by_role("button", name="reset all").click()
    wait_until(page, lambda: not session_of(server).experiment.changes)
    page.locator("input[type=file]").first.set_input_files(file)
    wait_until(page, lambda: session_of(server).experiment.changes == {"window.pixel_sigma": 0.1})
    expect(page.locator("[data-knob='window.pixel_sigma'] .vi-num")).to_have_value("0.1")
    bad = tmp_path / "bad.yaml"
    bad.write_text("window:\n  no_such: 3\n")
    page.locator("input[type=file]").first.set_input_files(bad)
    expect(page.get_by_text("unknown parameter 'window.no_such'").first).to_be_visible()


def forked(page: Page, server: Server, key: str = "window.loss", value: str = "'none'") -> str:
    """The id of a fork from FRAME on, finished."""
    page.evaluate(f"vi.send({{k: 'set', key: '{key}', v: {value}}})")
    page.keyboard.press("Control+Enter")
    wait_until(page, lambda: len(list(server.store)) == 2)
    fork = list(server.store)[1]
    wait_until(page, lambda: not fork.growing, 60)
    assert fork.view is not None, fork.error
    return fork.id


def test_a_fork_is_computed_drawn_and_compared(page: Page, server: Server) -> None:
    open_tab(page, "Runs")
    id = forked(page, server)
    entry = page.locator(f"[data-run='{id}']")
    expect(entry).to_contain_text(f"frame {FRAME}")
    expect(entry).to_contain_text("window.loss none")
    go = page.locator("button[data-first]")
    go.wait_for()
    frame = int(go.get_attribute("data-first") or -1)
    assert frame >= FRAME
    expect(page.locator("[data-setting='window.loss']")).to_be_visible()
    for metric in ("ATE, shared poses", "mean cost", "keyframes", "time of a frame"):
        expect(page.locator("[data-vip=runs] tr", has_text=metric)).to_be_visible()
    page.keyboard.press("Home")
    wait_for_frame(page, 0)
    go.click()
    wait_for_frame(page, frame)
    expect(page.locator("[data-vip=signals] .vi-otherval").first).to_be_visible()
    other = session_of(server).drawing.beside(session_of(server).opened.view)
    assert other is not None and other.at(frame) == frame


def test_a_fork_without_changes_has_no_first_difference(page: Page, server: Server) -> None:
    open_tab(page, "Runs")
    page.keyboard.press("Control+Enter")
    expect(page.locator("[data-first='none']")).to_contain_text("So is every number", timeout=60_000)


def test_a_fork_can_be_stopped(page: Page, server: Server) -> None:
    open_tab(page, "Runs")
    page.evaluate("vi.send({k: 'frame', i: 1})")
    slowly = {"window.max_iterations": 100, "solver.function_tolerance": 0, "frontend.max_cnt": 1000,
              "frontend.min_dist": 5, "frontend.klt_window": 41, "frontend.klt_iterations": 100}  # fmt: skip
    for key, value in slowly.items():
        page.evaluate(f"vi.send({{k: 'set', key: '{key}', v: {value}}})")
    wait_for_frame(page, 1)
    page.keyboard.press("Control+Enter")
    page.get_by_role("button", name="stop", exact=True).click(timeout=60_000)
    fork = list(server.store)[1]
    wait_until(page, lambda: not fork.growing)
    assert fork.view is not None and len(fork.view) < len(session_of(server).opened.view)
    assert not fork.error


def test_a_run_is_renamed_kept_opened_and_found_again(
    page: Page, server: Server, serve: Serve, open_page: OpenPage, sample_run: Path
) -> None:
    open_tab(page, "Runs")
    id = forked(page, server)
    name = page.locator(f"[data-run='{id}'] .vi-runname")
    name.fill("<b>no loss</b>")
    name.press("Enter")
    page.locator(f"[data-run='{id}']").get_by_role("button", name="keep").click()
    wait_until(page, lambda: server.store.notes(server.store.get(id)).kept)  # type: ignore[arg-type]
    page.locator(f"[data-run='{id}']").get_by_role("button", name="open", exact=True).click()
    wait_until(page, lambda: session_of(server).opened.id == id)
    wait_for_frame(page, FRAME)

    later = open_page(serve(open_path(sample_run)))
    open_tab(later, "Runs")
    again = later.locator(f"[data-run='{id}'] .vi-runname")
    expect(again).to_have_value("<b>no loss</b>")


def test_a_link_reproduces_a_view(page: Page, server: Server, open_page: OpenPage, browser: object) -> None:
    id = forked(page, server)
    page.evaluate(f"vi.send({{k: 'open', id: '{id}'}})")
    page.keyboard.press("Alt+5")
    page.evaluate("vi.send({k: 'frame', i: 30})")
    wait_for_frame(page, 30)
    page.wait_for_function("location.search.includes('frame=30') && location.search.includes('layout=compare')")
    address = page.evaluate("location.href")
    assert "run=" + id in address and str(FRAME) not in address.split("?")[0] and "/tmp" not in address
    other = open_page(server, query="?" + address.split("?")[1])
    wait_for_frame(other, 30)
    there = session_of(server)
    wait_until(other, lambda: there.opened.id == id and there.layout.name == "compare")


def test_control_enter_forks_with_what_has_just_been_typed(page: Page, server: Server) -> None:
    open_tab(page, "What-if")
    page.locator("[data-knob='window.pixel_sigma'] .vi-num").fill("2.25")
    page.keyboard.press("Control+Enter")
    wait_until(page, lambda: len(list(server.store)) == 2)
    fork = list(server.store)[1]
    wait_until(page, lambda: fork.view is not None, 60)
    assert fork.view is not None and fork.view.header.parent is not None
    assert dict(fork.view.header.parent.changes) == {"window.pixel_sigma": 2.25}
    assert fork.view.header.parent.frame == FRAME


def test_initialised_frames_have_a_window(sample_run: Path) -> None:
    """The tests above look at a frame that is solved."""
    with RunReader(sample_run) as run:
        assert INITIALISED < FRAME < len(run) - 6 and run.report(FRAME).solve is not None
