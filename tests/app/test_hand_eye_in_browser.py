"""Unknown extrinsics in headless Chromium."""

from __future__ import annotations

import pytest
from chromium import OpenPage, Serve, open_tab, wait_for_frame
from fake_run import FIRST_SOLVE
from hand_eye_run import FIRST, hand_eye_run
from playwright.sync_api import expect

from app.runs import open_path
from app.server import Server

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def server(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Server:
    return serve(open_path(hand_eye_run().write(tmp_path_factory.mktemp("runs") / "unknown")))


def test_convergence_is_a_tab_and_a_click_on_an_attempt_goes_to_its_frame(server: Server, open_page: OpenPage) -> None:
    page = open_page(server)
    open_tab(page, "Hand-eye")
    page.evaluate(f"vi.send({{k: 'frame', i: {FIRST_SOLVE}}})")
    wait_for_frame(page, FIRST_SOLVE)
    shown = page.locator("[data-vip=hand_eye]").first
    expect(shown).to_contain_text("Every gate has passed")
    expect(shown.locator("tbody tr")).to_have_count(3)
    shown.locator(f"[data-attempts] i[title='frame {FIRST + 1}']").click()
    wait_for_frame(page, FIRST + 1)
    expect(shown).to_contain_text("rotate the device about two axes")
    shown.locator("text=init.hand_eye_max_sigma_deg").click()
    expect(page.locator("[data-knob='init.hand_eye_max_sigma_deg']").first).to_be_visible()


def test_a_run_that_knows_its_extrinsics_has_no_such_tab(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    expect(page.get_by_role("tab", name="Gates", exact=True)).to_be_visible()
    expect(page.get_by_role("tab", name="Hand-eye", exact=True)).to_have_count(0)
