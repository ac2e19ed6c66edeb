"""Two cameras as a user sees them: the tab, its images, and a selection that is the same everywhere."""

from __future__ import annotations

import pytest
from chromium import OpenPage, Serve
from playwright.sync_api import Page, expect
from stereo_run import stereo_run

from app.runs import open_path
from app.server import Server

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def served(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Server:
    return serve(open_path(stereo_run(tmp_path_factory.mktemp("stereo"))))


@pytest.fixture
def page(served: Server, open_page: OpenPage) -> Page:
    """At a frame in the middle, with the Stereo tab open."""
    page = open_page(served, query="/?frame=8")
    page.get_by_role("tab", name="Stereo").click()
    page.locator("[data-vip=stereo] img").nth(1).wait_for()
    return page


def test_both_images_are_shown_and_they_differ(page: Page) -> None:
    images = page.locator("[data-vip=stereo] img")
    expect(images).to_have_count(2)
    left, right = (images.nth(k).get_attribute("src") for k in (0, 1))
    assert left != right
    page.get_by_role("tab", name="Camera").click()
    assert page.locator("[data-vip=camera] img").first.get_attribute("src") == left


def test_a_match_shows_its_line_under_the_pointer_and_a_click_selects_it(page: Page) -> None:
    match = page.locator("[data-vip=stereo] [data-pair]:has(.l)").first
    id = match.get_attribute("data-pair")
    expect(match.locator(".l")).to_be_hidden()
    match.locator("circle:not(.r)").first.hover()
    expect(match.locator(".l")).to_be_visible()
    match.locator("circle:not(.r)").first.click()
    expect(page.locator(f"[data-vip=stereo] [data-selected='{id}']")).to_be_visible()
    expect(page.locator(f"[data-vip=stereo] .vi-picked[data-pair='{id}'] .l")).to_be_visible()
    expect(page.locator("[data-vip=inspect]")).to_contain_text(f"track {id}")


def test_a_limit_leads_to_its_knob(page: Page) -> None:
    page.locator("[data-vip=stereo] [data-step='epipolar line'] .vi-link").click()
    expect(page.locator("[data-knob='frontend.stereo_epipolar_px']").first).to_be_visible()


def test_a_run_with_one_camera_has_no_such_tab(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    expect(page.get_by_role("tab", name="Camera")).to_be_visible()
    expect(page.get_by_role("tab", name="Stereo")).to_have_count(0)
