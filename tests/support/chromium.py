"""A real page in a real browser: fixtures for tests and benchmarks of the interface.

Chromium draws in software, so the 3D canvas is hidden where a test does not look at it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fake_run import fake_run
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

from app.runs import OpenRun, open_path
from app.server import Server
from app.session import Session

EXECUTABLE = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]
HIDE_CANVAS = "canvas { display: none !important }"
TIMEOUT_MS = 30_000
expect.set_options(timeout=TIMEOUT_MS)

Serve = Callable[[OpenRun], Server]
OpenPage = Callable[..., Page]


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of 60 frames with its images inside."""
    return fake_run().write(tmp_path_factory.mktemp("runs") / "fake_room")


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if EXECUTABLE is None:
        pytest.skip("chromium is not installed (Debian: apt-get install chromium)")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=EXECUTABLE, headless=True, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def serve() -> Iterator[Serve]:
    """Serves an opened run until the module's tests are done."""
    servers: list[Server] = []

    def start(opened: OpenRun) -> Server:
        servers.append(Server(opened, port=8640))
        return servers[-1]

    yield start
    for server in servers:
        server.stop()


@pytest.fixture(scope="module")
def served_run(serve: Serve, run_folder: Path) -> Server:
    return serve(open_path(run_folder))


def open_in(
    context: BrowserContext,
    server: Server,
    canvas: bool = False,
    wait: str = "img",
    query: str = "",
) -> Page:
    """A server's page in a new tab, its first frame drawn."""
    page = context.new_page()
    page.set_default_timeout(TIMEOUT_MS)
    page.goto(server.url + query)
    if not canvas:
        page.add_style_tag(content=HIDE_CANVAS)
    page.locator(f"[data-vip=camera] {wait}").first.wait_for()
    return page


@pytest.fixture
def open_page(browser: Browser) -> Iterator[OpenPage]:
    """Opens a server's page in a fresh tab, waits for the first frame, and closes it afterwards."""
    contexts = []

    def start(server: Server, size: tuple[int, int] = (1600, 950), **how: Any) -> Page:
        contexts.append(browser.new_context(viewport={"width": size[0], "height": size[1]}))
        return open_in(contexts[-1], server, **how)

    yield start
    for context in contexts:
        context.close()


def frame_of(page: Page) -> int:
    """The frame number that the timeline shows."""
    return int(page.locator("[data-vip=timeline] [data-frame]").first.get_attribute("data-frame") or -1)


def image_of(page: Page) -> str:
    """The camera panel's image, as its data URI."""
    return page.locator("[data-vip=camera] img").first.get_attribute("src") or ""


def wait_for_frame(page: Page, frame: int) -> None:
    page.locator(f"[data-vip=timeline] [data-frame='{frame}']").first.wait_for(timeout=TIMEOUT_MS)


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


def open_knobs(page: Page) -> None:
    """The What-if panel with the knobs of every stage."""
    open_tab(page, "What-if")
    page.locator(".vi-knobs").wait_for()
    page.evaluate("document.querySelectorAll('.vi-stageknobs').forEach(group => group.open = true)")
