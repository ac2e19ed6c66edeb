"""Loop closing as a user meets it: what can be done about a loop that did, or did not, close."""

from __future__ import annotations

from pathlib import Path

import pytest
from chromium import OpenPage, Serve, wait_for_frame
from playwright.sync_api import Locator, Page, expect

from app.runs import open_path
from app.server import Server

pytestmark = pytest.mark.browser

REFUSED, CLOSED = 10, 30
"""Keyframes: one that faces another way than everything before, one that closes a loop."""


@pytest.fixture(scope="module")
def served(serve: Serve, looping_run: Path) -> Server:
    return serve(open_path(looping_run))


@pytest.fixture
def page(served: Server, open_page: OpenPage) -> Page:
    """With the layout of loops, and every gate of the run judged."""
    page = open_page(served)
    page.keyboard.press("Alt+6")
    page.locator("[data-loops=complete]").first.wait_for(state="attached")
    return page


def look_at(page: Page, later: int, earlier: int | str = "") -> None:
    page.get_by_label("later keyframe").fill(str(later))
    page.get_by_label("earlier keyframe").fill(str(earlier))
    page.get_by_role("button", name="ask").click()
    expect(loops(page)).to_contain_text(f"keyframe {later} →")


def loops(page: Page) -> Locator:
    return page.locator("[data-vip=loops]").first


def move(page: Page, key: str, value: float) -> None:
    limits = page.locator(".vi-loopknobs details")
    if limits.get_attribute("open") is None:
        limits.locator("summary").click()
    box = page.locator(f".vi-loopknobs [data-knob='{key}'] .vi-num").first
    box.fill(str(value))
    box.press("Enter")
    page.locator(f"[data-loops=complete][data-of='{key}={value:g}']").first.wait_for(state="attached")


def count(page: Page, stage: str) -> int:
    return int(page.locator(f"[data-stage='{stage}'][data-count]").first.get_attribute("data-count") or -1)


def test_the_funnel_narrows_and_every_gate_of_a_refused_loop_is_judged(page: Page) -> None:
    stages = [e.get_attribute("data-count") for e in page.locator("[data-vip=loops] [data-count]").all()]
    counts = [int(n or -1) for n in stages]
    assert len(counts) == 10 and counts == sorted(counts, reverse=True) and counts[-1] > 0
    look_at(page, REFUSED)
    gates = loops(page).locator(".vi-gateline")
    assert gates.filter(has_text="heading").locator("[aria-label=failed]").count() == 1
    for after in ("distance", "drift"):
        expect(gates.filter(has_text=after).first).not_to_contain_text("not computed")
    expect(loops(page)).to_contain_text("same place")


def test_n_goes_from_candidate_to_candidate_and_a_row_of_the_table_to_its_frame(page: Page) -> None:
    page.evaluate("vi.send({k: 'frame', i: 20})")
    wait_for_frame(page, 20)
    page.keyboard.press("n")
    wait_for_frame(page, 30)
    page.keyboard.press("n")
    wait_for_frame(page, 32)
    page.keyboard.press("Shift+N")
    wait_for_frame(page, 30)
    row = loops(page).locator(".vi-candidates tr", has_text="20→").first
    row.click()
    wait_for_frame(page, 44)
    expect(loops(page)).to_contain_text("keyframe 20 →")


def test_the_pair_shows_both_images_with_matches_that_tell_their_bits(page: Page) -> None:
    look_at(page, CLOSED)
    pair = page.locator("[data-vip=pair]").first
    expect(pair.locator("img")).to_have_count(2)
    expect(pair.locator("[data-fate=inlier] b")).not_to_have_text("0")
    match = pair.locator("g.vi-match-5").first
    assert "of 256 bits differ" in (match.locator("title").text_content() or "")
    line = match.locator("polyline.e").first
    expect(line).to_be_hidden()
    match.locator("circle").last.hover(force=True)
    expect(line).to_be_visible()
    expect(match.locator("circle.r")).to_be_visible()
    pair.locator("[data-fate=inlier]").click()
    expect(match).to_be_hidden()


def test_a_moved_limit_predicts_what_is_gained_and_a_remedy_says_what_else_comes_in(page: Page) -> None:
    before = count(page, "accepted")
    look_at(page, REFUSED)
    remedy = loops(page).locator("[data-remedy=limits]")
    expect(remedy).to_contain_text("heading ≤")
    expect(remedy).to_contain_text("accepts")
    move(page, "loop.max_heading_deg", 90)
    assert count(page, "accepted") > before
    expect(loops(page).locator("[data-list=accepted]")).to_contain_text(f"{REFUSED}→")
    expect(loops(page)).to_contain_text("Exact up to keyframe")
    expect(loops(page).locator("[data-filter=gained]")).to_be_visible()
    loops(page).get_by_role("button", name="reset").click()
    page.locator("[data-loops=complete][data-of='the run']").first.wait_for(state="attached")
    assert count(page, "accepted") == before


def test_a_remedy_can_be_set_and_forked(page: Page, served: Server) -> None:
    look_at(page, REFUSED)
    loops(page).get_by_role("button", name="set these").click()
    expect(loops(page).get_by_role("button", name="Fork with these settings")).to_be_visible()
    session = list(served.sessions.values())[-1]
    loops(page).get_by_role("button", name="Fork with these settings").click()
    for _ in range(300):
        if session.other is not None:
            break
        page.wait_for_timeout(100)
    assert session.other is not None and session.other.job is not None
    session.other.job.cancel()
    session.other.job.wait()


def test_any_two_keyframes_can_be_asked_about(page: Page) -> None:
    look_at(page, CLOSED, 1)
    expect(loops(page)).to_contain_text(f"keyframe {CLOSED} → 1")
    expect(loops(page).locator("[data-gate=rank]")).to_contain_text("≤ 4")
    page.get_by_label("later keyframe").fill("9999")
    page.get_by_role("button", name="ask").click()
    expect(page.get_by_text("This run has no keyframe 9999")).to_be_visible()


def test_an_edge_switched_off_gives_another_graph_and_another_error(page: Page) -> None:
    look_at(page, CLOSED)
    page.evaluate("vi.send({k: 'frame', i: 69})")
    wait_for_frame(page, 69)
    page.get_by_role("tab", name="Graph").click()
    graph = page.locator("[data-vip=graph]").first
    expect(graph).to_contain_text("ATE odometry")
    expect(graph).to_contain_text("drift corrections")
    graph.locator("[data-edge=disable]").click()
    expect(graph.locator("[data-ate='your edges']")).to_be_visible()
    expect(graph).to_contain_text("off")
    graph.locator("[data-edge=disable]").click()
    expect(graph.locator("[data-ate='your edges']")).to_have_count(0)


def test_relocalisation_in_the_window_and_both_drifts_are_shown(page: Page) -> None:
    page.get_by_role("tab", name="Graph").click()
    page.evaluate("vi.send({k: 'frame', i: 50})")
    wait_for_frame(page, 50)
    expect(page.locator("[data-vip=graph]").first).to_contain_text("relocalisation in the window")
    page.get_by_role("tab", name="Signals").click()
    for signal in ("graph", "fast", "apart"):
        expect(page.locator(f"[data-signal='drift.{signal}']")).to_contain_text("cm")


def test_a_run_without_loops_shows_nothing_about_them(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    for name in ("Loops", "Pair", "Graph"):
        assert page.get_by_role("tab", name=name, exact=True).count() == 0
    page.keyboard.press("Alt+6")
    expect(page.get_by_text("This run closes no loops")).to_be_visible()


@pytest.mark.parametrize("size", [(1440, 900), (1920, 1080)], ids=str)
def test_both_images_and_every_panel_fit_on_the_page(
    served: Server, open_page: OpenPage, size: tuple[int, int]
) -> None:
    page = open_page(served, size)
    page.keyboard.press("Alt+6")
    page.locator("[data-loops=complete]").first.wait_for(state="attached")
    look_at(page, CLOSED)
    page.wait_for_timeout(500)  # docks glide to their place
    image = page.locator("[data-vip=pair] .vi-img").first.bounding_box()
    assert image is not None and image["y"] + image["height"] <= size[1]
    wide = page.evaluate(
        "[...document.querySelectorAll('[data-vip]')].filter(e => e.offsetParent && e.scrollWidth > e.clientWidth + 1)"
        ".map(e => e.dataset.vip)"
    )
    assert wide == []
