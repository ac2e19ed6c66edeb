"""The Depth panel in headless Chromium."""

from __future__ import annotations

from pathlib import Path

import pytest
from chromium import OpenPage, Serve, open_tab, session_of, wait_for_frame
from playwright.sync_api import Page, expect

from app.runs import open_path
from app.server import Server

pytestmark = pytest.mark.browser
LAST = 20


@pytest.fixture(scope="module")
def served(serve: Serve, depth_runs: dict[str, Path]) -> Server:
    return serve(open_path(depth_runs["trust"]))


@pytest.fixture
def page(served: Server, open_page: OpenPage) -> Page:
    page = open_page(served)
    open_tab(page, "Depth")
    page.evaluate(f"vi.send({{k: 'frame', i: {LAST}}})")
    wait_for_frame(page, LAST)
    return page


def test_depth_stands_against_estimated_depth_and_a_dot_selects_its_track(page: Page, served: Server) -> None:
    shown = page.locator("[data-vip=depth]").first
    expect(shown.locator("[data-depth-image]")).to_be_visible()
    dot = shown.locator("circle[data-depth-of][r='3']").nth(4)
    id = dot.get_attribute("data-depth-of")
    dot.click(force=True)
    expect(shown.locator(f"circle[data-depth-of='{id}'][r='6']")).to_be_visible()
    expect(shown.locator("circle.p[data-measured]")).to_have_attribute("data-measured", str(id))
    expect(page.locator("[data-vip=camera] circle.p[data-track]").first).to_have_attribute("data-track", str(id))
    assert session_of(served).selection.is_track(int(id or -1))
    expect(shown.locator("[data-gate='chi-square at the anchor']")).to_be_visible()
    shown.locator("text=frontend.depth_max_variation").click()
    expect(page.locator("[data-knob='frontend.depth_max_variation']").first).to_be_visible()


def test_a_cross_in_the_image_says_why_there_is_no_depth(page: Page) -> None:
    shown = page.locator("[data-vip=depth]").first
    shown.locator("g[data-measured]").first.click(force=True)
    expect(shown).to_contain_text("no depth")
    expect(shown.locator(".vi-gates [aria-label=failed]").first).to_be_visible()


def test_a_run_without_a_depth_camera_has_no_such_tab(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    expect(page.get_by_role("tab", name="Gates", exact=True)).to_be_visible()
    expect(page.get_by_role("tab", name="Depth", exact=True)).to_have_count(0)
