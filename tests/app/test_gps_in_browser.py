"""GPS as a user meets it: the map, its zoom, a fix and its gates, the layout, and runs without."""

from __future__ import annotations

from pathlib import Path

import pytest
from chromium import OpenPage, Serve, frame_of, open_tab, session_of, wait_for_frame, wait_until
from playwright.sync_api import Locator, Page, expect

from app.runs import open_path
from app.server import Server

pytestmark = pytest.mark.browser

LAST = 45
"""Frame of the street's run."""


@pytest.fixture(scope="module")
def served(serve: Serve, street_run: Path) -> Server:
    return serve(open_path(street_run))


@pytest.fixture
def page(served: Server, open_page: OpenPage) -> Page:
    """With the layout of GPS, at the end of the run."""
    page = open_page(served)
    page.keyboard.press("Alt+7")
    gps(page).wait_for()
    page.evaluate(f"vi.send({{k: 'frame', i: {LAST}}})")
    wait_for_frame(page, LAST)
    expect(gps(page)).to_contain_text("fusing")
    return page


def gps(page: Page) -> Locator:
    return page.locator("[data-vip=gps]").first


def test_the_map_has_every_fix_both_trajectories_and_the_body(page: Page) -> None:
    used = int(gps(page).locator("[data-fixes=used]").get_attribute("data-count") or 0)
    gated = int(gps(page).locator("[data-fixes=gated]").get_attribute("data-count") or 0)
    assert used > 12 and gated > 3
    expect(gps(page).locator(".vi-fix.vi-used")).to_have_count(used)
    for line in ("final", "live"):
        expect(gps(page).locator(f"[data-line={line}]").first).to_be_attached()
    expect(gps(page).locator("[data-body]")).to_be_attached()
    expect(page.locator("[data-plot=yaw] .vi-head").first).to_be_visible()


def test_a_click_on_a_fix_goes_to_it_and_shows_its_gates(page: Page, served: Server) -> None:
    cross = gps(page).locator(".vi-fix.vi-gated").last
    fix = int(cross.get_attribute("data-fix") or -1)
    cross.click(force=True)
    series = session_of(served).cursor.run.series.gps  # type: ignore[union-attr]
    wait_for_frame(page, int(series.frame[fix]))
    expect(gps(page)).to_contain_text(f"selected fix {fix}")
    expect(gps(page).locator(f"[data-selected-fix='{fix}']")).to_be_attached()
    expect(gps(page).locator("[data-gate=chi2] [aria-label=failed]")).to_be_visible()
    gps(page).locator("[data-gate=chi2] .vi-knob").click()
    expect(page.locator("[data-knob='gps.max_chi2']").first).to_be_visible()


def test_the_map_zooms_by_itself_and_keeps_its_zoom_over_frames(page: Page) -> None:
    def zoom(name: str) -> float:
        return float(page.evaluate(f"getComputedStyle(document.documentElement).getPropertyValue('{name}')"))

    gps(page).locator(".vi-map").hover()
    page.mouse.wheel(0, -600)
    wait_until(page, lambda: zoom("--vi-map-z") > 2)
    assert zoom("--vi-z") == 1
    page.keyboard.press("ArrowLeft")
    wait_for_frame(page, LAST - 1)
    assert zoom("--vi-map-z") > 2
    gps(page).locator(".vi-map").dblclick(position={"x": 20, "y": 60})
    wait_until(page, lambda: zoom("--vi-map-z") == 1)


def test_before_the_alignment_fixes_are_kept_and_later_ones_faint(page: Page) -> None:
    page.evaluate("vi.send({k: 'frame', i: 15})")
    wait_for_frame(page, 15)
    expect(gps(page)).to_contain_text("aligning")
    expect(gps(page)).to_contain_text("to come")
    assert gps(page).locator(".vi-fix.vi-open").count() > 0
    assert gps(page).locator(".vi-fix.vi-later").count() > 5
    expect(gps(page).locator("[data-gate=yaw_sigma_deg]")).to_be_visible()


def test_layers_switch_the_fixes_in_3d(page: Page, served: Server) -> None:
    open_tab(page, "Layers")
    page.get_by_label("GPS fixes").uncheck()
    wait_until(page, lambda: not session_of(served).scene.shows("gps.fixes"))
    page.get_by_label("GPS: final trajectory").uncheck()
    wait_until(page, lambda: not session_of(served).scene.shows("gps.trajectory"))


def test_a_run_without_fixes_has_no_tab_and_says_why_the_layout_is_missing(
    served_run: Server, open_page: OpenPage
) -> None:
    page = open_page(served_run)
    assert page.get_by_role("tab", name="GPS", exact=True).count() == 0
    page.keyboard.press("Alt+7")
    expect(page.get_by_text("This run fuses no GPS fixes")).to_be_visible()
    assert frame_of(page) >= 0


@pytest.mark.parametrize("size", [(1440, 900), (1920, 1080)], ids=str)
def test_nothing_is_wider_than_its_panel(served: Server, open_page: OpenPage, size: tuple[int, int]) -> None:
    page = open_page(served, size)
    page.keyboard.press("Alt+7")
    gps(page).wait_for()
    page.evaluate(f"vi.send({{k: 'frame', i: {LAST}}})")
    wait_for_frame(page, LAST)
    page.wait_for_timeout(400)  # docks glide to their place
    wide = page.evaluate(
        "[...document.querySelectorAll('[data-vip]')].filter(e => e.offsetParent && e.scrollWidth > e.clientWidth + 1)"
        ".map(e => e.dataset.vip)"
    )
    assert wide == []
