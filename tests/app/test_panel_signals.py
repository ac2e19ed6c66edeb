"""Signals: one strip for each quantity that the run has, its value at the playhead beside it."""

import numpy as np
import pytest
from fake_reports import FIRST_SOLVE, context, parse, run_with

from app.html import number
from app.panels import signals


def shown(**changes):
    return [e.attributes["data-signal"] for e in parse(signals.render(context(30, **changes))).all("div")
            if "data-signal" in e.attributes]  # fmt: skip


OF_OTHERS = {"depth", "drift.graph", "drift.fast", "drift.apart", "gps.sigma", "gps.outage"}


def test_every_quantity_has_its_strip():
    expected = [s.key for s in signals.SIGNALS if s.key not in OF_OTHERS]  # without loops, fixes and depth
    assert shown() == expected
    assert len(parse(signals.backdrop(context(30))).all(cls="vi-strip")) == len(expected)


def test_without_truth_there_is_no_ate():
    assert "ate" not in shown(run=run_with(truth=False))
    assert "ATE" not in parse(signals.backdrop(context(30, run=run_with(truth=False)))).text


def test_a_layout_chooses_its_signals():
    assert shown(signals=("tracks", "parallax")) == ["tracks", "parallax"]


def test_values_are_those_of_the_frame():
    ctx = context(30)
    series = ctx.run.series
    page = parse(signals.render(ctx))
    expected = {
        "ate": 100 * series.ate_m[30],
        "visual": series.cost[30, 0],
        "cost": series.cost[30].sum(),
        "tracks": series.tracks[30],
        "b_g": np.linalg.norm(series.b_g[30]),
        "solve": ctx.ms["solve"],
    }
    for key, value in expected.items():
        assert page.one(data_signal=key).text.split()[0] == number(float(value))


def test_a_quantity_that_does_not_exist_at_a_frame_is_a_dash():
    page = parse(signals.render(context(FIRST_SOLVE - 3)))
    assert page.one(data_signal="visual").text.startswith("–")


def test_strips_depend_on_the_run_alone():
    assert signals.backdrop(context(3)) == signals.backdrop(context(40))


def test_a_click_seeks():
    lane = parse(signals.backdrop(context(3))).one(cls="vi-lane").attributes
    assert lane["onpointerdown"] == lane["onpointermove"] == "vi.scrub(event,this)"


def test_values_stand_beside_their_strips():
    ctx = context(30)
    column = parse(signals.render(ctx)).one(cls="vi-values").attributes["style"]
    assert column == f"top:{-len(signals.present(ctx)) * (signals.HEIGHT + signals.GAP)}px"


def test_the_limit_of_parallax_is_drawn():
    only = parse(signals.backdrop(context(30, signals=("parallax",)))).all("path")
    assert any("stroke-dasharray" in e.attributes for e in only)


@pytest.mark.parametrize("frame", [0, 44])
def test_nothing_to_plot_is_a_sentence(frame):
    assert "Press" in parse(signals.render(context(frame, signals=("no such signal",)))).text
