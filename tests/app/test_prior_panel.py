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
from app.prior import FREE, departure_view, prior_view
from app.widgets.matrix import MatrixBlock, colours, heat_map, log_range
from vins_core.geometry import so3
from vins_core.record.reader import RunReader
from vins_core.solver.spectrum import GAUGE
from vins_core.window.state import Prior

FRAME = 30


@pytest.fixture(scope="module")
def run(sample_run: Path) -> RunView:
    return RunView(RunReader(sample_run))


def moved(prior: Prior, direction: str, step: float) -> np.ndarray:
    """Tangent, from where the prior was linearised, of really moving everything: local differences over the step."""
    centre = np.mean([x[:3] for b, x in zip(prior.blocks, prior.x0) if b.kind == "pose"], axis=0)
    turn = so3.exp(np.array([0, 0, step if direction == "yaw" else 0.0]))
    shift = step * np.array([direction == axis for axis in "xyz"], float)
    parts = []
    for block, x in zip(prior.blocks, prior.x0):
        if block.kind == "pose":
            p = centre + so3.rotate(turn, x[:3] - centre) + shift
            parts += [p - x[:3], so3.log(so3.multiply(so3.inverse(x[3:]), so3.multiply(turn, x[3:])))]
        elif block.kind == "speed_bias":
            parts += [so3.rotate(turn, x[:3]) - x[:3], np.zeros(6)]
        else:
            parts.append(np.zeros(6))
    return np.concatenate(parts) / step


@pytest.mark.parametrize("direction", GAUGE)
def test_leaks_are_what_really_moving_the_window_costs(run: RunView, direction: str) -> None:
    prior, seen = run.reader.state(FRAME).window.prior, run.prior(FRAME)
    assert prior is not None and seen is not None
    n = moved(prior, direction, 1e-6)
    leak = float(np.square(prior.J @ n).sum())
    assert seen.leaks[GAUGE.index(direction)] == pytest.approx(leak, rel=1e-3, abs=1e-6)


def test_leaks_are_those_that_marginalisation_reported(run: RunView) -> None:
    for k in range(INITIALISED, len(run)):
        report, seen = run.report(k).marginalization, run.prior(k)
        if report is not None and report.kind != "none" and seen is not None:
            np.testing.assert_allclose(seen.leaks, report.gauge_information, rtol=1e-6, atol=1e-9)


def test_position_stays_free_and_heading_leaks_more_and_more(run: RunView) -> None:
    leaks = {k: run.prior(k).leaks for k in (INITIALISED, 20, 25, 30, 35)}  # type: ignore[union-attr]
    assert all((v[:3] < 1e-9).all() for v in leaks.values())
    assert leaks[INITIALISED][3] < 1e-9 < FREE
    yaw = [leaks[k][3] for k in (INITIALISED, 25, 35)]
    assert yaw[0] < yaw[1] < yaw[2]


def test_a_prior_linearised_at_the_current_states_knows_no_heading(run: RunView) -> None:
    seen = prior_view(run.reader, INITIALISED)
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


def frame_with(run: RunView, kind: str) -> int:
    found = (k for k in range(len(run) - 1, INITIALISED, -1) if (r := run.report(k).marginalization) and r.kind == kind)
    return next(found)


@pytest.mark.parametrize("kind", ["MARGIN_OLD", "MARGIN_SECOND_NEW"])
def test_what_is_left_is_the_schur_complement_of_what_it_is_made_of(run: RunView, kind: str) -> None:
    k = frame_with(run, kind)
    seen, prior, report = departure_view(run, k), run.reader.state(k).window.prior, run.report(k).marginalization
    assert seen is not None and prior is not None and report is not None
    A, m = seen.information, seen.m
    assert (m, len(A) - m) == (report.m, report.n)
    left = A[m:, m:] - A[m:, :m] @ np.linalg.pinv(A[:m, :m], rcond=1e-14) @ A[:m, m:]
    recorded = prior.J.T @ prior.J
    scale = np.sqrt(np.outer(recorded.diagonal(), recorded.diagonal()))
    np.testing.assert_allclose(left / scale, recorded / scale, atol=1e-8)


def test_fill_in_is_where_nothing_was_before(run: RunView) -> None:
    seen = departure_view(run, frame_with(run, "MARGIN_OLD"))
    assert seen is not None and 0 < seen.share < 1
    before = seen.information[seen.m :, seen.m :]
    new = seen.fill_in != 0
    assert np.abs(before[new]).max() <= 1e-9 * np.abs(before).max()


def test_blocks_before_are_those_of_the_report(run: RunView) -> None:
    k = frame_with(run, "MARGIN_OLD")
    seen, report = departure_view(run, k), run.report(k).marginalization
    assert seen is not None and report is not None
    cameras = [(b.size, b.start, b.dropped) for b in seen.blocks if b.short != "depths"]
    assert cameras == [(b.size, b.index, b.dropped) for b in report.blocks if not b.name.startswith("inv_depth")]


@pytest.mark.parametrize("side", ["before", "fill-in"])
def test_the_other_sides_are_drawn_once_they_are_worked_out(run: RunView, side: str) -> None:
    k = frame_with(run, "MARGIN_OLD")
    ctx = dataclasses.replace(context(k, run=run), prior_side=side)
    assert "working it out" in parse(panel.render(ctx)).text
    seen = departure_view(run, k)
    assert seen is not None
    page = parse(panel.render(dataclasses.replace(ctx, departure=seen)))
    n = len(seen.information) if side == "before" else len(seen.fill_in)
    assert page.one(cls="vi-matrix").attributes["data-matrix"] == str(n)
    assert page.one("button", aria_pressed="true").text == side


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
