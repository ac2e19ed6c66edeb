"""A real page in a real browser: fixtures for tests and benchmarks of the interface.

Chromium draws in software, so the 3D canvas is hidden where a test does not look at it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fake_run import fake_run
from playwright.sync_api import Browser, Page, expect, sync_playwright

from app.runs import OpenRun, open_path
from app.server import Server

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


@pytest.fixture
def open_page(browser: Browser) -> Iterator[OpenPage]:
    """Opens a server's page in a fresh tab, waits for the first frame, and closes it afterwards."""
    contexts = []

    def start(
        server: Server, size: tuple[int, int] = (1600, 950), canvas: bool = False, wait: str = "img", query: str = ""
    ) -> Page:
        context = browser.new_context(viewport={"width": size[0], "height": size[1]})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(TIMEOUT_MS)
        page.goto(server.url + query)
        if not canvas:
            page.add_style_tag(content=HIDE_CANVAS)
        page.locator(f"[data-vip=camera] {wait}").first.wait_for()
        return page

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
