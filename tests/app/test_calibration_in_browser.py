"""Calibration as a user meets it: curves over the run, the values at the playhead, the way to a gate's knob."""

from __future__ import annotations

from pathlib import Path

import pytest
from chromium import OpenPage, Serve, frame_of, open_tab, wait_for_frame
from playwright.sync_api import Locator, Page, expect

from app.runs import open_path
from app.server import Server

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def served(serve: Serve, calibrating_run: Path) -> Server:
    return serve(open_path(calibrating_run))


@pytest.fixture
def page(served: Server, open_page: OpenPage) -> Page:
    page = open_page(served)
    open_tab(page, "Calibration")
    calibration(page).wait_for()
    return page


def calibration(page: Page) -> Locator:
    return page.locator("[data-vip=calibration]").first


def go(page: Page, frame: int) -> None:
    page.evaluate(f"vi.send({{k: 'frame', i: {frame}}})")
    wait_for_frame(page, frame)


def test_values_follow_the_playhead_and_a_click_on_a_curve_moves_it(page: Page) -> None:
    go(page, 40)
    expect(calibration(page).locator("[data-calibration='40']")).to_contain_text("td")
    expect(calibration(page)).to_contain_text("free")
    lane = page.locator("[data-plot=td]")
    box = lane.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    middle = 21
    wait_for_frame(page, middle)
    assert frame_of(page) == middle
    expect(calibration(page).locator(f"[data-calibration='{middle}']")).to_be_attached()


def test_all_axes_have_their_plot_and_a_playhead(page: Page) -> None:
    go(page, 30)
    for name in ("cam0 turned by", "cam0 moved by"):
        for axis in "xyz":
            expect(page.locator(f"[data-plot='{name} {axis}'] .vi-head")).to_be_visible()


def test_what_holds_it_leads_to_its_knob(page: Page) -> None:
    go(page, 12)
    expect(calibration(page)).to_contain_text("held")
    calibration(page).get_by_text("online.min_speed").first.click()
    expect(page.locator("[data-knob='online.min_speed']").first).to_be_visible()


def test_a_run_that_takes_its_calibration_as_given_has_no_such_panel(
    serve: Serve, run_folder: Path, open_page: OpenPage
) -> None:
    page = open_page(serve(open_path(run_folder)))
    expect(page.get_by_role("tab", name="Gates", exact=True)).to_be_visible()
    expect(page.get_by_role("tab", name="Calibration", exact=True)).to_have_count(0)
