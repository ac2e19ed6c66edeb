"""Whatever a file, a record or a user says stays text on every panel."""

import dataclasses
import re

import numpy as np
import pytest
from fake_reports import FIRST_SOLVE, context, parse, run_with, shared_run

from app.context import RunView
from app.panel_view import PANELS
from vins_core.report import BlockReport, Gate, InitStage
from vins_core.sensors import Anomaly

EVIL = """<img src=x onerror="alert('1')">'"`</div></svg><script>alert(2)</script>"""
ELEMENTS = {
    "", "div", "span", "b", "i", "u", "a", "p", "kbd", "img", "code", "dl", "dt", "dd", "table", "thead", "tbody", "tr",
    "th", "td", "button", "svg", "g", "path", "rect", "circle", "polyline", "title",
}  # fmt: skip
HANDLER = re.compile(
    r"""vi\.send\(\{("k":"frame","i":\d+|"k":"pick","t":"track","i":\d+|k:'pick',t:'track',i:\d+"""
    r"""|"k":"optimum"|"k":"knob","key":"([^"\\]|\\.)*")\}\)|vi\.(scrub|wheel)\(event,this\)|vi\.pan\(event\)|vi\.reset\(\)"""
)


def hostile_gate(gate: Gate) -> Gate:
    return dataclasses.replace(gate, name=EVIL, knob=EVIL, unit=EVIL)


def hostile(report):
    """The report as a forged record could hold it: hostile text wherever text is."""
    changes = {
        "tracks": dataclasses.replace(report.tracks, gates=tuple(map(hostile_gate, report.tracks.gates))),
        "anomalies": (Anomaly(EVIL, report.t_ns, EVIL, EVIL),),
    }
    if report.keyframe:
        gates = tuple(map(hostile_gate, report.keyframe.gates))
        changes["keyframe"] = dataclasses.replace(report.keyframe, reason=EVIL, gates=gates)
    if report.initialization:
        stages = tuple(
            InitStage(EVIL, tuple(map(hostile_gate, s.gates)), EVIL, {EVIL: 1.0, f"{EVIL}_deg": np.nan})
            for s in report.initialization.stages
        )
        changes["initialization"] = dataclasses.replace(report.initialization, stages=stages)
    if report.solve:
        changes["solve"] = dataclasses.replace(report.solve, termination=EVIL)
    if report.marginalization:
        blocks = (BlockReport(EVIL, 6, 0, True), BlockReport(EVIL, 6, 6, False))
        changes["marginalization"] = dataclasses.replace(report.marginalization, kind=EVIL, blocks=blocks)
    if report.health:
        gates = tuple(map(hostile_gate, report.health.gates))
        changes["health"] = dataclasses.replace(report.health, gates=gates, outcome=EVIL)
    return dataclasses.replace(report, **changes)


@pytest.fixture(scope="module")
def run():
    view = run_with(*map(hostile, shared_run().reports))
    view.reader.header = dataclasses.replace(view.header, recording=EVIL)
    for summary in view.summaries:
        summary.ms[EVIL] = 1.0
    return view


@pytest.mark.parametrize("key", PANELS)
@pytest.mark.parametrize("frame", [0, 5, 10, FIRST_SOLVE, 13, 25])
def test_hostile_text_stays_text(run: RunView, key: str, frame: int):
    module = PANELS[key]
    track = int(run.report(frame).tracks.ids[0])
    ctx = context(frame, run=run, track=track, image_uri=EVIL, image_note=EVIL, progress=EVIL)
    html = module.render(ctx) + module.render(dataclasses.replace(ctx, image_uri=""))
    if hasattr(module, "backdrop"):
        html += module.backdrop(ctx)
    assert "<img src=x" not in html and "<script" not in html
    markup = parse(html)
    for element in markup.all():
        assert element.name in ELEMENTS
        for name, value in element.attributes.items():
            if name.startswith("on"):
                assert HANDLER.fullmatch(value), value
            assert name not in ("srcdoc", "href", "xlink:href")
            if name == "style":
                assert "url" not in value and "expression" not in value


@pytest.mark.parametrize("frame", [FIRST_SOLVE, 25])
def test_hostile_text_is_shown_as_it_is(run: RunView, frame: int):
    ctx = context(frame, run=run)
    for key in ("gates", "timeline", "inspect"):
        assert "".join(EVIL.split()) in "".join(parse(PANELS[key].render(ctx)).text.split())
