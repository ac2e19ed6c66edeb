"""What a user can do with parameters, forks and runs, in headless Chromium on an estimated run."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from chromium import OpenPage, Serve, wait_for_frame
from playwright.sync_api import Page, expect
from sample import INITIALISED

from app.runs import open_path
from app.server import Server
from app.session import Session
from vins_core.io.params_yaml import read_params
from vins_core.params import OFFERED
from vins_core.record.recording import RunReader

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


def session_of(server: Server) -> Session:
    return list(server.sessions.values())[-1]


def open_tab(page: Page, name: str) -> None:
    page.get_by_role("tab", name=name, exact=True).click()


def move(page: Page, key: str, place: int) -> None:
    """Put the slider of a knob at `place` of 1000."""
    page.get_by_role("slider", name=key).fill(str(place))


def wait_until(page: Page, holds: Callable[[], bool], seconds: float = 30) -> None:
    for _ in range(int(seconds / 0.05)):
        if holds():
            return
        page.wait_for_timeout(50)
    raise AssertionError("it never came")


def test_every_parameter_is_a_knob_and_the_search_finds_them(page: Page) -> None:
    open_tab(page, "What-if")
    rows = page.locator("[data-knob]")
    expect(rows).to_have_count(len(OFFERED))
    page.get_by_label("find a parameter").fill("robust loss")
    meant = [d for d in OFFERED.values() if "robust loss" in f"{d.key} {d.doc}".lower()]
    assert 0 < len(meant) < len(OFFERED)
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
    page.evaluate("vi.send({k: 'set', key: 'window.max_iterations', v: 100})")  # slowly
    page.evaluate("vi.send({k: 'set', key: 'solver.function_tolerance', v: 0})")
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


def test_a_layout_of_ones_own_is_saved_and_offered(page: Page, server: Server) -> None:
    open_tab(page, "Layers")
    page.get_by_label("IMU edges by residual").uncheck()
    session = session_of(server)
    wait_until(page, lambda: session.workspace.boxes["imu.edges"].value is False)
    server._viser.get_event_loop().call_soon_threadsafe(session.save_layout, "My view")
    page.wait_for_function("location.search.includes('layout=my-view')")
    page.keyboard.press("Alt+1")
    wait_until(page, lambda: session.layout.name == "default")
    assert session.layout.layers.get("imu.edges", True)
    server._viser.get_event_loop().call_soon_threadsafe(session.reproduce, "", -1, "my-view")
    wait_until(page, lambda: session.layout.title == "My view")
    assert session.layout.layers["imu.edges"] is False


def test_a_block_of_the_prior_selects_both_its_frames(page: Page, server: Server) -> None:
    page.keyboard.press("Alt+4")
    panel = page.locator("[data-vip=prior]").first
    expect(panel).to_contain_text("null-space check", ignore_case=True)
    expect(panel.locator(".vi-chip", has_text="leaks")).to_have_count(1)
    seen = session_of(server).opened.view.prior(FRAME)
    n = len(seen.blocks)
    panel.locator(".vi-cell").nth(1 * n + 3).click()
    wait_until(page, lambda: session_of(server).selection.kind == "frame")
    picked = session_of(server).selection
    assert {picked.id, picked.other} == {seen.blocks[1].frame, seen.blocks[3].frame}
    expect(panel.locator(".vi-picked")).to_have_count(4)


def test_the_matrix_is_shown_before_and_after_marginalisation(page: Page, server: Server) -> None:
    page.keyboard.press("Alt+4")
    view = session_of(server).opened.view
    frame = next(k for k in range(FRAME, len(view)) if view.report(k).marginalization.kind == "MARGIN_OLD")
    page.evaluate(f"vi.send({{k: 'frame', i: {frame}}})")
    wait_for_frame(page, frame)
    report = view.report(frame).marginalization
    for side, size in (("before", report.m + report.n), ("fill-in", report.n), ("after", report.n)):
        page.get_by_role("button", name=side, exact=True).click()
        expect(page.locator("[data-vip=prior] [data-matrix]")).to_have_attribute("data-matrix", str(size))
        expect(page.get_by_role("button", name=side, exact=True)).to_have_attribute("aria-pressed", "true")
    page.locator("[data-vip=prior] .vi-link", has_text="first_estimates").click()
    expect(page.locator("[data-knob='marginalization.first_estimates']")).to_be_in_viewport()


def test_what_leaked_over_time_is_a_signal(page: Page, server: Server) -> None:
    page.keyboard.press("Alt+4")
    view = session_of(server).opened.view
    frame = next(k for k in range(len(view) - 1, 0, -1) if view.report(k).marginalization.kind == "MARGIN_OLD")
    page.evaluate(f"vi.send({{k: 'frame', i: {frame}}})")
    wait_for_frame(page, frame)
    shown = page.locator("[data-signal='leak.yaw']").inner_text()
    assert float(shown.split()[0]) == pytest.approx(float(view.prior(frame).leaks[3]), rel=0.01)


def test_ipopt_says_whether_this_is_the_optimum(page: Page) -> None:
    open_tab(page, "Inspect")
    page.get_by_role("button", name="Is this the optimum?").click()
    answer = page.locator("[data-optimum]")
    for words in ("IPOPT", "total", "inverse depth", "iterations in"):
        expect(answer).to_contain_text(words)
    page.keyboard.press("ArrowRight")
    wait_for_frame(page, FRAME + 1)
    expect(page.locator("[data-optimum]")).to_have_count(0)


def test_initialised_frames_have_a_window(sample_run: Path) -> None:
    """The tests above look at a frame that is solved."""
    with RunReader(sample_run) as run:
        assert INITIALISED < FRAME < len(run) - 6 and run.report(FRAME).solve is not None
