"""The calibration panel without a browser: curves, bands, gates, and runs that take their calibration as given."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fake_reports import Markup, context, parse, shared_view

from app.calibration import calibration_series
from app.context import RunView
from app.html import fixed
from app.panels import calibration
from app.tooltips import TIPS, gate_tip
from vins_core.record.reader import RunReader


@pytest.fixture(scope="module")
def run(calibrating_run: Path) -> RunView:
    return RunView(RunReader(calibrating_run))


def shown(run: RunView, frame: int) -> Markup:
    return parse(calibration.render(context(frame, run=run)))


def first_known(run: RunView) -> int:
    return int(np.flatnonzero(calibration_series(run).known)[0])


def test_the_panel_exists_only_where_something_is_estimated(run: RunView) -> None:
    assert calibration.exists(run)
    assert not calibration.exists(shared_view())
    assert "as given" in shown(shared_view(), 20).text


def test_every_quantity_has_its_curve_with_a_band_and_a_playhead(run: RunView) -> None:
    page = parse(calibration.backdrop(context(30, run=run)))
    plots = [e.attributes["data-plot"] for e in page.all("div") if "data-plot" in e.attributes]
    axes = [f"cam0 {what} by {axis}" for what in ("turned", "moved") for axis in "xyz"]
    assert plots == ["td", *axes]
    for name in plots:
        lane = page.one("div", data_plot=name)
        strokes = [e.attributes for e in lane.walk() if e.name == "path"]
        assert any(a.get("fill") == calibration.BAND and a["d"] for a in strokes)
        assert any(a.get("stroke") == calibration.ESTIMATE and a["d"] for a in strokes)
        assert sum(e.attributes.get("class") == "vi-head" for e in lane.walk()) == 1


def test_values_are_those_of_the_frame_with_three_sigma(run: RunView) -> None:
    last = len(run) - 1
    report, series = run.summaries[last].calibration, calibration_series(run)
    assert report is not None
    text = shown(run, last).text
    assert f"td{fixed(1e3 * report.td_s, 2)} ±{fixed(3e3 * report.td_sigma_s, 2)}" in text
    for value, sigma in zip(series.turn_rad[last, 0], series.turn_sigma_rad[last, 0]):
        assert f"{fixed(np.degrees(value), 2)} ±{fixed(3 * np.degrees(sigma), 2)}" in text


def test_the_given_calibration_is_where_the_curves_begin(run: RunView) -> None:
    series, k = calibration_series(run), first_known(run)
    assert not series.extrinsics_free[k] and np.isnan(series.turn_sigma_rad[k]).all()
    np.testing.assert_allclose(series.turn_rad[k], 0, atol=1e-12)
    np.testing.assert_allclose(series.shift_m[k], 0, atol=1e-12)
    assert np.abs(series.turn_rad[-1]).max() > np.radians(0.3)


def test_what_holds_it_is_told_with_its_gate(run: RunView) -> None:
    series = calibration_series(run)
    held, free = (int(np.flatnonzero(series.known & (series.td_free == state))[0]) for state in (False, True))
    page = shown(run, held)
    assert "held" in page.text and "online.min_speed" in page.text
    assert page.all(aria_label="failed")
    assert "free" in shown(run, free).text and not shown(run, len(run) - 1).all(aria_label="failed")


def test_stretches_in_which_it_is_held_are_shaded(run: RunView) -> None:
    lane = parse(calibration.backdrop(context(3, run=run))).one("div", data_plot="td")
    assert any("held: frames" in e.text for e in lane.walk() if e.name == "title")


def test_every_name_explains_itself(run: RunView) -> None:
    html = calibration.backdrop(context(30, run=run)) + calibration.render(context(len(run) - 1, run=run))
    tips = {e.attributes["data-tip"] for e in parse(html).all() if e.attributes.get("data-tip")}
    assert tips <= TIPS.keys() and {"calibration.td", "calibration.turn", "calibration.shift"} <= tips
    report = run.summaries[-1].calibration
    assert report is not None
    assert all(gate_tip(gate) for gate in (*report.td_gates, *report.extrinsic_gates))
