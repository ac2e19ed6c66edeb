"""Looking into the solver and the prior, layouts: what a user can do without a fork, in headless Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from chromium import Serve, open_in, open_knobs, open_tab, session_of, wait_for_frame, wait_until
from playwright.sync_api import Browser, Page, expect

from app.runs import open_path
from app.scene.uncertainty import UncertaintyLayer
from app.server import Server

pytestmark = pytest.mark.browser
FRAME = 25


@pytest.fixture(scope="module")
def server(serve: Serve, sample_run: Path) -> Server:
    return serve(open_path(sample_run))


@pytest.fixture(scope="module")
def tab(server: Server, browser: Browser) -> Iterator[Page]:
    """One tab for all tests: opening one takes longer than most of them."""
    context = browser.new_context(viewport={"width": 1600, "height": 950})
    yield open_in(context, server)
    context.close()


@pytest.fixture
def page(tab: Page, server: Server) -> Page:
    """The tab at FRAME, in the first layout, nothing changed and nothing selected."""
    session = session_of(server)
    tab.wait_for_function("!document.activeElement.matches('input, select, textarea')")  # a menu lets go after a moment
    tab.keyboard.press("Alt+2")
    wait_until(tab, lambda: session.layout.hotkey == "alt+2")
    tab.keyboard.press("Alt+1")
    wait_until(tab, lambda: session.layout.hotkey == "alt+1")
    for event in ("k: 'reset'", "k: 'pick', t: 'track', i: -1", f"k: 'frame', i: {FRAME}"):
        tab.evaluate(f"vi.send({{{event}}})")
    wait_for_frame(tab, FRAME)
    return tab


def test_every_iteration_of_the_solver_is_listed(page: Page, server: Server) -> None:
    solve = session_of(server).opened.view.report(FRAME).solve
    assert solve is not None
    table = page.locator("[data-vip=inspect] table", has_text="gain ratio")
    for column in ("cost", "step", "gain ratio", "radius"):
        expect(table.locator("th", has_text=column).first).to_be_visible()
    expect(table.locator("tbody tr")).to_have_count(len(solve.iterations))


def test_method_damping_and_loss_can_be_chosen(page: Page, server: Server) -> None:
    open_knobs(page)
    answer = page.locator("[data-vip=what_if] [data-solved]")
    asked: list[str] = []
    for key, choice in (("solver.method", "dogleg"), ("solver.damping", "ceres"), ("window.loss", "huber")):
        page.locator(f"[data-knob='{key}'] select").select_option(choice)
        asked.append(f"{key}={choice}")
        wait_until(page, lambda: set((answer.first.get_attribute("data-of") or "").split()) == set(asked))
    assert page.locator("[data-vip=what_if] [data-change]").count() == len(asked)
    for words in ("iterations", "visual", "IMU", "prior"):
        expect(page.locator("[data-vip=what_if]").last).to_contain_text(words)


def test_first_estimates_are_a_what_if_and_tell_what_the_prior_would_know(page: Page) -> None:
    open_knobs(page)
    page.locator("[data-knob='marginalization.first_estimates'] input").check()
    row = page.locator("[data-vip=what_if] tr", has_text="known of yaw")
    expect(row).to_be_visible()
    recorded, now = row.locator("td").nth(1).inner_text(), row.locator("td").nth(2).inner_text()
    assert recorded != now


def test_ellipsoids_of_poses_and_of_the_selected_landmark_are_drawn(page: Page, server: Server) -> None:
    session = session_of(server)
    layer = next(layer for layer in session.scene._layers if isinstance(layer, UncertaintyLayer))
    open_tab(page, "Layers")
    page.get_by_label("3σ of poses").check()
    frames = len(session.opened.view.report(FRAME).window.frames)
    wait_until(page, lambda: sum(node.visible for node in layer._nodes) == frames)
    known = session.answers.uncertainty.look(session.opened.view, FRAME)
    assert known is not None
    page.evaluate(f"vi.send({{k: 'pick', t: 'track', i: {int(known.landmark_ids[0])}}})")
    wait_until(page, lambda: sum(node.visible for node in layer._nodes) == frames + 1)
    page.get_by_label("3σ of poses").uncheck()
    wait_until(page, lambda: not any(node.visible for node in layer._nodes))


def test_a_layout_of_ones_own_is_saved_and_chosen_again(page: Page, server: Server) -> None:
    session = session_of(server)
    open_tab(page, "Layers")
    page.get_by_label("IMU edges by residual").uncheck()
    wait_until(page, lambda: not session.scene.shows("imu.edges"))
    page.locator(".mantine-Notification-root", has_text="Software WebGL").get_by_role("button").click()
    page.get_by_role("button", name="Expand panel").last.click()
    name = page.get_by_text("name", exact=True).locator("xpath=following::input[1]")  # viser ties no label to it
    name.fill("My view")
    name.press("Tab")
    page.get_by_role("button", name="Save this layout").click()
    page.wait_for_function("location.search.includes('layout=my-view')")
    page.keyboard.press("Alt+1")
    wait_until(page, lambda: session.layout.name == "default")
    assert session.layout.layers.get("imu.edges", True)
    page.get_by_label("layout", exact=True).click()
    page.get_by_role("option", name="My view").click()
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
