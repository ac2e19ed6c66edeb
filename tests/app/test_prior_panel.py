"""The prior of an estimated run: the numbers against an independent computation, the panel as text."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from fake_reports import context, parse
from sample import INITIALISED

from app.context import RunView, Selection
from app.panels import prior as panel
from app.prior import DIRECTIONS, FREE, gauge_directions, prior_view
from app.widgets.matrix import MatrixBlock, colours, heat_map, log_range
from vins_core.geometry import so3
from vins_core.record.recording import RunReader
from vins_core.window.state import WindowState

FRAME = 30


@pytest.fixture(scope="module")
def run(sample_run: Path) -> RunView:
    return RunView(RunReader(sample_run))


def moved(window: WindowState, direction: str, step: float) -> np.ndarray:
    """Tangent, from the window's states, of really moving the window: each block's local difference over the step."""
    prior = window.prior
    assert prior is not None
    frames = {f.frame: f for f in window.frames}
    centre = np.mean([frames[b.id].p_w_b for b in prior.blocks if b.kind == "pose"], axis=0)
    turn = so3.exp(np.array([0, 0, step if direction == "yaw" else 0.0]))
    shift = step * np.array([direction == axis for axis in "xyz"], float)
    parts = []
    for block in prior.blocks:
        if block.kind == "extrinsic":
            parts.append(np.zeros(6))
            continue
        f = frames[block.id]
        if block.kind == "pose":
            p = centre + so3.rotate(turn, f.p_w_b - centre) + shift
            q = so3.multiply(turn, f.q_w_b)
            parts.append(np.concatenate([p - f.p_w_b, so3.log(so3.multiply(so3.inverse(f.q_w_b), q))]))
        else:
            parts.append(np.concatenate([so3.rotate(turn, f.v_w_b) - f.v_w_b, np.zeros(6)]))
    return np.concatenate(parts) / step


def test_leaks_are_what_really_moving_the_window_costs(run: RunView) -> None:
    window = run.reader.state(FRAME).window
    prior, seen = window.prior, run.prior(FRAME)
    assert prior is not None and seen is not None
    for k, direction in enumerate(DIRECTIONS):
        n = moved(window, direction, 1e-6)
        np.testing.assert_allclose(gauge_directions(prior, window)[:, k], n, atol=1e-5)
        assert seen.leaks[k] == pytest.approx(n @ prior.J.T @ prior.J @ n, rel=1e-3, abs=1e-6)


def test_position_stays_free_and_heading_leaks_more_and_more(run: RunView) -> None:
    leaks = {k: run.prior(k).leaks for k in (INITIALISED, 20, 25, 30, 35)}  # type: ignore[union-attr]
    assert all((v[:3] < 1e-9).all() for v in leaks.values())
    assert leaks[INITIALISED][3] < 1e-9 < FREE
    yaw = [leaks[k][3] for k in (INITIALISED, 25, 35)]
    assert yaw[0] < yaw[1] < yaw[2]


def test_a_prior_linearised_at_the_current_states_knows_no_heading(run: RunView) -> None:
    window = run.reader.state(INITIALISED).window
    seen = prior_view(window, 1e-8)
    assert seen is not None and (seen.leaks < 1e-9).all()


def test_blocks_cover_the_matrix_in_order(run: RunView) -> None:
    seen = run.prior(FRAME)
    assert seen is not None
    ends = np.cumsum([b.size for b in seen.blocks])
    assert [b.start for b in seen.blocks] == [0, *ends[:-1].tolist()] and ends[-1] == len(seen.information)
    assert seen.rank == (seen.eigenvalues > 1e-8).sum()


def test_the_panel_names_every_block_and_says_what_leaks(run: RunView) -> None:
    page = parse(panel.render(context(FRAME, run=run)))
    seen = run.prior(FRAME)
    assert seen is not None
    assert len(page.all("rect", cls="vi-cell")) == len(seen.blocks) ** 2
    for block in seen.blocks:
        assert any(cell.text.startswith(block.name) for cell in page.all("rect", cls="vi-cell"))
    chips = [e.text for e in page.all(cls="vi-chip") if e.text in ("free", "leaks")]
    assert chips == ["leaks" if leak > FREE else "free" for leak in seen.leaks]
    report = run.report(FRAME).marginalization
    assert report is not None
    if report.kind != "none":
        assert f"dropped m {report.m}" in page.text and f"kept n {report.n}" in page.text


def test_a_selected_pair_of_frames_is_outlined(run: RunView) -> None:
    seen = run.prior(FRAME)
    assert seen is not None
    a, b = seen.blocks[1].frame, seen.blocks[2].frame
    ctx = dataclasses.replace(context(FRAME, run=run), selection=Selection("frame", a, b))
    assert len(parse(panel.render(ctx)).all("rect", cls="vi-picked")) == 4
    assert ctx.selection.is_frame(a) and ctx.selection.is_frame(b) and not ctx.selection.is_frame(a + b)


def test_without_a_prior_or_states_the_panel_says_so(run: RunView) -> None:
    assert "There is no prior after this frame" in parse(panel.render(context(3, run=run))).text
    assert "recorded without its state" in parse(panel.render(context(20))).text


def test_larger_entries_are_brighter() -> None:
    logs, low, high = log_range(np.array([[1e3, 1.0], [0.0, -1e-20]]))
    brightness = colours(logs, low, high).astype(int).sum(2)
    assert brightness[0, 0] > brightness[0, 1] > brightness[1, 0] == brightness[1, 1]


def test_a_block_without_frame_selects_nothing_by_itself() -> None:
    html = parse(heat_map(np.eye(2), [MatrixBlock("extrinsic", "ex", 0, 2)]))
    assert "onclick" not in html.one("rect").attributes
