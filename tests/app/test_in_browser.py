"""The interface as a user meets it, in headless Chromium."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chromium import OpenPage, Serve, frame_of, image_of, wait_for_frame
from fake_run import FRAMES, fake_run
from playwright.sync_api import Page, expect

from app.runs import open_path
from app.server import Server
from vins_core.geometry import so3
from vins_core.record.reader import RunReader
from vins_core.sensors import Anomaly

pytestmark = pytest.mark.browser


def go_to(page: Page, frame: int) -> None:
    page.evaluate(f"vi.send({{k: 'frame', i: {frame}}})")
    wait_for_frame(page, frame)


def use_layout(page: Page, number: int, first_tab: str) -> None:
    page.keyboard.press(f"Alt+{number}")
    expect(page.get_by_role("tab", name=first_tab, exact=True)).to_have_attribute("aria-selected", "true")


def settled_box(page: Page, selector: str) -> dict[str, float]:
    """Where an element stands once the windows of the page have come to rest."""
    seen: list[object] = []
    while len(seen) < 3 or seen[-1] != seen[-3]:
        seen.append(page.locator(selector).first.bounding_box())
        page.wait_for_timeout(100)
    assert isinstance(seen[-1], dict)
    return seen[-1]


def window_of(page: Page) -> str:
    return page.locator("[data-vip=inspect] table").first.inner_text()


def test_the_page_opens_with_the_first_frame_drawn(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    assert frame_of(page) == 0
    expect(page.locator("[data-vip=camera] img").first).to_have_js_property("naturalWidth", 376)
    assert page.locator("[data-vip=camera] circle").count() > 50


def test_stepping_changes_frame_number_image_and_window_and_back_again(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    go_to(page, 30)
    before = image_of(page), window_of(page)
    page.keyboard.press("ArrowRight")
    wait_for_frame(page, 31)
    assert image_of(page) != before[0]
    assert window_of(page) != before[1]
    page.keyboard.press("ArrowLeft")
    wait_for_frame(page, 30)
    assert (image_of(page), window_of(page)) == before


def test_letters_step_too_and_shift_goes_to_the_next_keyframe(
    served_run: Server, open_page: OpenPage, run_folder: Path
) -> None:
    page = open_page(served_run)
    with RunReader(run_folder) as run:
        kept = [s.frame - 1 for s in run.summaries[1:] if s.is_keyframe]
    after = [k for k in kept if k > 30]
    go_to(page, 30)
    page.keyboard.press("l")
    wait_for_frame(page, 31)
    page.keyboard.press("j")
    wait_for_frame(page, 30)
    page.keyboard.press("Shift+ArrowRight")
    wait_for_frame(page, after[0])
    page.keyboard.press("Shift+ArrowRight")
    wait_for_frame(page, after[1])
    page.keyboard.press("Shift+ArrowLeft")
    wait_for_frame(page, after[0])


def test_a_key_after_a_click_on_a_tab_still_steps(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    page.get_by_role("tab", name="Gates").click()
    page.keyboard.press("ArrowRight")
    wait_for_frame(page, 1)
    expect(page.get_by_role("tab", name="Gates")).to_have_attribute("aria-selected", "true")


def test_scrubbing_the_timeline_seeks(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    box = settled_box(page, ".vi-lane[data-lanes]")
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.25 * box["width"], y)
    page.mouse.down()
    wait_for_frame(page, round(0.25 * (FRAMES - 1)))
    page.wait_for_timeout(50)  # moves are sent at most every 33 ms
    page.mouse.move(box["x"] + 0.8 * box["width"], y)
    wait_for_frame(page, round(0.8 * (FRAMES - 1)))
    page.mouse.up()


def test_space_plays_and_pauses(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    page.keyboard.press("Space")
    shown = "document.querySelector('[data-vip=timeline] [data-frame]')?.dataset.frame"  # none while it is replaced
    page.wait_for_function(f"Number({shown}) >= 4")
    page.keyboard.press("Space")
    expect(page.locator("[data-vip=timeline]").first).to_contain_text("paused")
    stopped = frame_of(page)
    page.wait_for_timeout(400)
    assert frame_of(page) == stopped


def test_a_click_on_a_track_shows_its_observations_and_escape_clears_it(
    served_run: Server, open_page: OpenPage, run_folder: Path
) -> None:
    with RunReader(run_folder) as run:
        track = observed_track(run, 40)
    page = open_page(served_run)
    go_to(page, 40)
    page.locator(f"[data-vip=camera] [data-track='{track}']").first.click()
    inspect = page.locator("[data-vip=inspect]").first
    expect(inspect).to_contain_text(f"track {track}")
    assert page.locator("[data-vip=inspect] .vi-obs i").count() >= 2
    page.keyboard.press("Escape")
    expect(inspect).not_to_contain_text(f"track {track}")


def observed_track(run: RunReader, frame: int) -> int:
    """A track of the frame whose landmark is triangulated and whose mark no other mark covers."""
    report = run.report(frame)
    assert report.solve is not None
    uv = report.tracks.uv_px
    gap = np.linalg.norm(uv[:, None] - uv[None], axis=2) + 1e9 * np.eye(len(uv))
    observed = np.isin(report.tracks.ids, report.solve.visual_ids)
    inside = ((uv > 40) & (uv < np.array([336, 200]))).all(1)
    return int(report.tracks.ids[np.argmax(gap.min(1) * observed * inside)])


def test_a_click_on_a_landmark_in_3d_selects_its_track(
    served_run: Server, open_page: OpenPage, run_folder: Path
) -> None:
    page = open_page(served_run, canvas=True)
    go_to(page, 40)
    page.wait_for_timeout(1500)  # the first frames of the 3D view are slow in software
    session = list(served_run.sessions.values())[-1]
    with RunReader(run_folder) as run:
        landmarks = run.report(40).landmarks
    assert landmarks is not None
    camera = session.client.camera
    seen = so3.rotate(so3.inverse(camera.wxyz), landmarks.xyz_w - camera.position)
    canvas = page.locator("canvas").first.bounding_box()
    assert canvas is not None
    focal = canvas["height"] / 2 / np.tan(camera.fov / 2)
    with np.errstate(invalid="ignore"):
        at = focal * seen[:, :2] / seen[:, 2:] + [canvas["width"] / 2, canvas["height"] / 2]
        free = (seen[:, 2] > 0) & ((at > [40, 170]) & (at < [canvas["width"] - 40, canvas["height"] * 0.6])).all(1)
    apart = np.linalg.norm(np.nan_to_num(at[:, None] - at[None], nan=1e9), axis=2) + 1e9 * np.eye(len(at))
    k = int(np.argmax(np.where(free, apart.min(1), 0)))
    page.mouse.click(canvas["x"] + at[k, 0], canvas["y"] + at[k, 1])
    expect(page.locator("[data-vip=inspect]").first).to_contain_text(f"track {landmarks.ids[k]}")


def test_a_second_tab_is_independent(served_run: Server, open_page: OpenPage) -> None:
    first, second = open_page(served_run), open_page(served_run)
    go_to(first, 20)
    go_to(second, 40)
    second.keyboard.press("ArrowRight")
    wait_for_frame(second, 41)
    assert frame_of(first) == 20
    first.keyboard.press("ArrowLeft")
    wait_for_frame(first, 19)
    assert frame_of(second) == 41


def test_a_hidden_panel_is_drawn_for_the_current_frame_when_its_tab_is_opened(
    served_run: Server, open_page: OpenPage
) -> None:
    page = open_page(served_run)
    go_to(page, 12)
    page.get_by_role("tab", name="Gates").click()
    expect(page.locator("[data-vip=gates]").first).to_contain_text("bundle adjustment cost")
    page.keyboard.press("ArrowRight")
    wait_for_frame(page, 13)
    expect(page.locator("[data-vip=gates]").first).not_to_contain_text("bundle adjustment cost")


def test_layers_are_switched_by_checkboxes_and_remember_their_layout(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    use_layout(page, 2, first_tab="Gates")
    page.get_by_role("tab", name="Layers").click()
    expect(page.get_by_label("IMU edges by residual")).not_to_be_checked()
    expect(page.get_by_label("ground truth")).to_be_checked()
    use_layout(page, 1, first_tab="Inspect")
    page.get_by_role("tab", name="Layers").click()
    expect(page.get_by_label("IMU edges by residual")).to_be_checked()


@pytest.mark.parametrize("size", [(1440, 900), (1600, 950), (1920, 1080)], ids=str)
@pytest.mark.parametrize("layout", [1, 2, 3])
def test_everything_fits_on_the_page(
    served_run: Server, open_page: OpenPage, size: tuple[int, int], layout: int
) -> None:
    page = open_page(served_run, size)
    page.keyboard.press(f"Alt+{layout}")
    go_to(page, 40)
    page.wait_for_timeout(500)  # docks glide to their place
    timeline = page.locator("[data-vip=timeline]").first.bounding_box()
    assert timeline is not None
    assert timeline["y"] + timeline["height"] <= size[1]
    lane = page.locator(".vi-lane[data-lanes]").bounding_box()
    assert lane is not None and lane["width"] > 200
    image = page.locator("[data-vip=camera] img").first.bounding_box()
    below = page.get_by_role("tab", name="Signals").bounding_box()
    assert image is not None and below is not None
    if below["x"] < image["x"] + image["width"]:  # stacked below the camera
        assert image["y"] + image["height"] <= below["y"]
    wide = page.evaluate(
        "[...document.querySelectorAll('[data-vip]')].filter(e => e.offsetParent && e.scrollWidth > e.clientWidth + 1)"
        ".map(e => e.dataset.vip)"
    )
    assert wide == []


def test_a_layout_chosen_again_is_drawn_again(served_run: Server, open_page: OpenPage) -> None:
    page = open_page(served_run)
    page.keyboard.press("Alt+1")
    go_to(page, 5)


def test_an_unreadable_recording_is_a_sentence_in_the_page(serve: Serve, open_page: OpenPage, tmp_path: Path) -> None:
    broken = tmp_path / "broken.bag"
    broken.write_bytes(b"#ROSBAG V2.0\nnot much of a bag")
    opened = open_path(broken)
    page = open_page(serve(opened), wait="p")
    sentence = page.locator("[data-vip=camera]").first.inner_text()
    assert "broken.bag" in sentence
    assert sentence.strip() == opened.error


def test_names_from_files_never_become_markup(serve: Serve, open_page: OpenPage, tmp_path: Path) -> None:
    run = fake_run(20)
    evil = "<img src=x onerror='window.hacked=1'>"
    run.header = replace(run.header, recording=f"/data/{evil}.bag")
    run.reports[5] = replace(run.reports[5], anomalies=(Anomaly(evil, run.reports[5].t_ns, evil, evil),))
    page = open_page(serve(open_path(run.write(tmp_path / "evil"))))
    go_to(page, 5)
    for tab in ("Gates", "Inspect"):
        page.get_by_role("tab", name=tab, exact=True).click()
        page.wait_for_timeout(300)
    expect(page.locator("[data-vip=timeline]").first).to_contain_text(evil)
    assert page.evaluate("window.hacked") is None
