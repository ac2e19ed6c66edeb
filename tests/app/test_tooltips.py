"""The page teaches the system: what has a name has an explanation."""

import pytest
from fake_reports import context, gate_values, parse

from app.panel_view import PANELS
from app.tooltips import TIPS, gate_tip, page_tips
from vins_core.params import DECLARATIONS
from vins_core.report import LossReason


def test_every_parameter_shows_its_declaration():
    for key, declared in DECLARATIONS.items():
        tip = TIPS[f"param.{key}"]
        assert declared.doc.lower()[1:] in tip.text.lower()
        assert tip.unit == declared.unit
        if declared.high is not None:
            assert f"{declared.low:g} to {declared.high:g}" in tip.equation


def test_every_way_to_lose_a_track_is_explained():
    assert all(f"loss.{reason}" in TIPS for reason in LossReason)


@pytest.mark.parametrize("frame", [0, 5, 11, 12, 13, 25, 40])
def test_every_tip_on_a_panel_exists(frame):
    ctx = context(frame, track=int(context(frame).report.tracks.ids[0]))
    keys = set()
    for module in PANELS.values():
        html = module.render(ctx) + (module.backdrop(ctx) if hasattr(module, "backdrop") else "")
        keys |= {e.attributes["data-tip"] for e in parse(html).all() if "data-tip" in e.attributes}
    assert keys <= set(TIPS)
    assert len(keys) > 5


def test_every_gate_of_a_run_that_has_a_parameter_is_explained():
    for frame in (5, 11, 12, 25):
        for gate in gate_values(context(frame).report):
            assert gate_tip(gate) in TIPS or not gate.knob


def test_tips_are_markup_that_closes():
    for html in page_tips().values():
        assert parse(html).one("b").text


def test_tips_name_where_they_come_from():
    sourced = [k for k, tip in TIPS.items() if tip.source]
    assert {"cost.imu", "window.imu", "margin", "stage.alignment", "gate.health.max_acc_bias"} <= set(sourced)
