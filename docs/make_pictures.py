"""The pictures of the documentation: makes the runs, opens them in headless Chromium, and photographs the page.

    python docs/make_pictures.py [overview] [why] [loops] [gps]     # all by default; Debian's chromium is needed

Whatever the page shows is computed here and now, by the commands that the documentation names.
"""

from __future__ import annotations

import io
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from app.__main__ import main as vinspect  # isort: skip  # first: one BLAS thread before numpy is imported

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from app.context import RunView
from app.runs import open_path
from app.server import Server, sample
from app.session import Session
from vins_core.report import LoopOutcome

IMAGES = Path(__file__).parent / "images"
SIZE = {"width": 1600, "height": 950}
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--no-first-run"]
SETTLE_MS = 4000
"""After the last change: docks glide, and the 3D view is drawn in software."""


class Studio:
    """One run in one tab."""

    def __init__(self, page: Page, server: Server) -> None:
        self.page, self.server = page, server

    @property
    def session(self) -> Session:
        return next(iter(self.server.sessions.values()))

    def go(self, frame: int) -> None:
        self.page.evaluate(f"vi.send({{k: 'frame', i: {frame}}})")
        self.page.locator(f"[data-vip=timeline] [data-frame='{frame}']").first.wait_for()

    def tab(self, name: str) -> None:
        self.page.get_by_role("tab", name=name, exact=True).click()

    def select(self, track: int) -> None:
        self.page.evaluate(f"vi.send({{k: 'pick', t: 'track', i: {track}}})")

    def until(self, holds: Callable[[], bool], seconds: float = 120) -> None:
        for _ in range(int(seconds / 0.1)):
            if holds():
                return
            self.page.wait_for_timeout(100)
        raise TimeoutError(f"not within {seconds:g} s")

    @property
    def run(self) -> RunView:
        assert self.session.opened.view is not None
        return self.session.opened.view

    def loops(self) -> None:
        """The layout of loops, once every gate of the run is judged."""
        self.page.keyboard.press("Alt+6")
        self.until_judged()

    def look_at_loop(self, later: int) -> None:
        self.page.get_by_label("later keyframe").fill(str(later))
        self.page.get_by_label("earlier keyframe").fill("")
        self.page.get_by_role("button", name="ask", exact=True).click()
        self.page.locator("[data-vip=loops] [data-remedy]").first.wait_for(timeout=600_000)

    def until_judged(self) -> None:
        self.page.wait_for_timeout(1000)
        self.page.locator("[data-loops=complete]").first.wait_for(state="attached", timeout=900_000)

    def photograph(self, name: str) -> None:
        s = self.session
        self.page.wait_for_timeout(500)
        self.until(lambda: s.drawing.idle and s.experiment.idle and s.answers.comparer.idle and s.answers.loops.idle)
        self.page.mouse.move(800, 2)
        self.page.wait_for_timeout(SETTLE_MS)
        save(self.page.screenshot(), IMAGES / f"{name}.png")


def save(png: bytes, path: Path) -> None:
    """With 256 colours, a quarter of the size.  Median cut would blend the few yellow pixels that mean "selected"."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    few = image.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


@contextmanager
def studio(run: Path) -> Iterator[Studio]:
    executable = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if executable is None:
        raise SystemExit("chromium is not installed (Debian: apt-get install chromium)")
    server = Server(open_path(run), port=8740)
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=executable, headless=True, args=ARGUMENTS)
            page = browser.new_context(viewport=SIZE).new_page()  # type: ignore[arg-type]
            page.set_default_timeout(60_000)
            page.goto(server.url)
            page.locator("[data-vip=camera] img").first.wait_for()
            notice = page.locator(".mantine-Notification-root", has_text="Software WebGL")
            notice.locator("button").first.click()
            notice.wait_for(state="detached")
            yield Studio(page, server)
            browser.close()
    finally:
        server.stop()


def command(*arguments: str | Path) -> None:
    print("vinspect", *arguments, flush=True)
    if vinspect([str(a) for a in arguments]):
        raise SystemExit("a command failed")


def overview(folder: Path) -> None:
    """The bundled sample well into its lap, with the landmark that most frames of the window see."""
    recording, calibration = sample()
    command("run", recording, "--calib", calibration[0], "--out", folder / "room_loop")
    with studio(folder / "room_loop") as s:
        s.go(172)
        report = s.run.report(172)
        marks = report.landmarks
        assert marks is not None
        alive = np.isin(marks.ids, report.tracks.ids) & np.isfinite(marks.error_px)
        s.select(int(marks.ids[np.argmax(np.where(alive, marks.n_obs, 0))]))
        s.photograph("overview")


def why(folder: Path) -> None:
    """The pictures of why-it-drifted.md, in its order."""
    command("simulate", "imu_gap", "--out", folder / "gap", "--format", "asl")
    command(
        "run", folder / "gap", "--set", "imu.gap_s=10", "--set", "frontend.klt_window=21", "--out", folder / "drifted"
    )
    with studio(folder / "drifted") as s:
        s.go(140)
        s.photograph("why-1-symptom")
        s.go(97)
        s.photograph("why-2-frame")
        s.tab("Gates")
        s.photograph("why-3-gates")
        s.tab("Inspect")
        s.page.get_by_role("button", name="Is this the optimum?").click()
        answer = s.page.locator("[data-optimum]")
        answer.wait_for()
        answer.scroll_into_view_if_needed()
        s.photograph("why-4-optimum")
        s.page.keyboard.press("Alt+4")
        s.go(120)
        s.photograph("why-5-prior")
        s.page.keyboard.press("Alt+1")
        s.go(97)
        s.tab("What-if")
        s.page.get_by_label("find a parameter").fill("gap")
        s.page.locator("[data-knob='imu.gap_s'] .vi-num").fill("0.05")
        s.page.keyboard.press("Enter")
        s.until(lambda: bool(s.session.experiment.changes))
        s.photograph("why-6-what-if")
        s.page.get_by_role("button", name="Fork from frame 97").click()
        s.until(lambda: s.session.other is not None and not s.session.other.growing)
        s.page.keyboard.press("Alt+5")
        s.go(140)
        s.photograph("why-7-compare")


def loops(folder: Path) -> None:
    """The pictures of why-no-loop.md, in its order."""
    command("simulate", "level_camera", "--out", folder / "level", "--format", "asl")
    command("run", folder / "level", "--set", "loop.heading=euler", "--out", folder / "few_loops")
    with studio(folder / "few_loops") as s:
        s.loops()
        s.page.locator("[data-filter=missed]").click()
        s.look_at_loop(150)
        s.photograph("loop-1-refused")
        s.page.get_by_role("button", name="set these").click()
        s.until_judged()
        s.photograph("loop-2-limit")
        s.page.locator("[data-vip=loops]").get_by_role("button", name="reset").click()
        s.page.locator(".vi-loopknobs summary").click()
        s.page.locator(".vi-loopknobs [data-knob='loop.heading'] select").select_option("gravity")
        s.until_judged()
        s.photograph("loop-3-gravity")
        s.page.get_by_role("button", name="Fork with these settings").click()
        s.until(lambda: s.session.other is not None and not s.session.other.growing, 900)
        assert s.session.other is not None
        s.page.evaluate(f"vi.send({{k: 'open', id: '{s.session.other.id}'}})")
        s.page.evaluate("vi.send({k: 'reset'})")
        s.loops()
        s.look_at_loop(150)
        s.go(len(s.run) - 1)
        s.tab("Graph")
        s.photograph("loop-4-fork")
    command("simulate", "twin_rooms", "--out", folder / "twins", "--format", "asl")
    command("run", folder / "twins", "--out", folder / "twin_rooms")
    with studio(folder / "twin_rooms") as s:
        s.loops()
        s.look_at_loop(first_inconsistent(s.run))
        s.photograph("loop-5-twins")


def first_inconsistent(run: RunView) -> int:
    """The first keyframe whose loop only the odometry speaks against."""
    return next(row.number for row in run.loops.rows() if row.outcome is LoopOutcome.INCONSISTENT)


def gps(folder: Path) -> None:
    """The picture of gps.md: after the outage, an outlier selected."""
    command("simulate", "street_gps", "--out", folder / "street", "--format", "asl")
    command("run", folder / "street", "--out", folder / "street_gps")
    with studio(folder / "street_gps") as s:
        s.page.keyboard.press("Alt+7")
        fixes = s.run.series.gps
        outlier = [k for k, failed in enumerate(fixes.failed) if "chi2" in failed][-2]
        s.page.evaluate(f"vi.send({{k: 'pick', t: 'fix', i: {outlier}}})")
        s.photograph("gps")


PICTURES = {"overview": overview, "why": why, "loops": loops, "gps": gps}

if __name__ == "__main__":
    wanted = sys.argv[1:] or list(PICTURES)
    with tempfile.TemporaryDirectory() as work:
        os.environ["XDG_CACHE_HOME"] = str(Path(work) / "cache")  # forks go there, and no other runs are listed
        for name in wanted:
            folder = Path(work) / name
            folder.mkdir()
            PICTURES[name](folder)
