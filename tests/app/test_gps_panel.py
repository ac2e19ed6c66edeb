"""The GPS panel without a browser: verdicts over time, the map, one fix with its gates, and runs without any."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fake_reports import Markup, context, parse, shared_view

from app.context import PanelContext, RunView, Selection
from app.gps import UNKNOWN, VERDICTS, gps_series
from app.panels import gps, signals, timeline
from app.scene.frame import SceneFrame
from app.scene.gps import ellipsoid, final, fixes
from app.tooltips import TIPS, gate_tip
from app.widgets.gps_map import Ground
from vins_core.record.reader import RunReader
from vins_core.report import FixRevision, FixVerdict, GpsStatus

USED, GATED, OPEN = (VERDICTS.index(v) for v in (FixVerdict.USED, FixVerdict.GATED, FixVerdict.OPEN))


@pytest.fixture(scope="module")
def run(street_run: Path) -> RunView:
    return RunView(RunReader(street_run))


def at(run: RunView, frame: int, fix: int = -1) -> PanelContext:
    selection = Selection("fix", fix) if fix >= 0 else Selection()
    return context(frame, run=run, selection=selection)


def shown(run: RunView, frame: int, fix: int = -1) -> Markup:
    return parse(gps.render(at(run, frame, fix)))


def aligned_at(run: RunView) -> int:
    return int(np.flatnonzero(run.series.gps.fusing)[0])


def test_a_run_without_fixes_has_no_panel_no_lane_and_no_signal() -> None:
    bare = shared_view()
    assert not gps.exists(bare) and len(bare.series.gps) == 0
    assert "GPS" not in timeline.backdrop(context(20))
    assert not any(s.key.startswith("gps.") for s, _ in signals.present(context(20)))


def test_verdicts_are_those_that_stood_at_the_frame(run: RunView) -> None:
    series, begun = run.series.gps, aligned_at(run)
    before, then = series.verdicts(begun - 1), series.verdicts(begun)
    assert set(before[series.frame < begun]) <= {OPEN, GATED} and (before[series.frame >= begun] == UNKNOWN).all()
    assert USED in then and OPEN not in then
    opened = int(np.flatnonzero(before == OPEN)[0])
    assert next(verdict for _, verdict in series.history(opened)) is FixVerdict.OPEN
    assert series.history(opened)[1][0] == begun


def test_a_verdict_that_falls_later_is_shown_from_then_on(run: RunView) -> None:
    last = len(run) - 1
    fix = int(np.flatnonzero(run.series.gps.final_verdicts == USED)[-1])
    stamp = int(run.series.gps.t_ns[fix])
    summaries = list(run.summaries)
    told = summaries[last].gps
    assert told is not None
    summaries[last] = replace(
        summaries[last], gps=replace(told, revised=(*told.revised, FixRevision(stamp, FixVerdict.GATED)))
    )
    series = gps_series(summaries)
    assert series.verdicts(last - 1)[fix] == USED and series.verdicts(last)[fix] == GATED
    assert series.history(fix)[-1] == (last, FixVerdict.GATED)


def test_the_map_shows_every_fix_with_its_verdict_and_those_to_come_faintly(run: RunView) -> None:
    series, frame = run.series.gps, aligned_at(run) + 6
    html, now = shown(run, frame), series.verdicts(frame)
    marks = {int(e.attributes["data-fix"]): e for e in html.all("g", cls="vi-fix")}
    placed = np.flatnonzero(np.isfinite(series.z_e).all(1))
    assert sorted(marks) == placed.tolist()
    for k, mark in marks.items():
        classes = mark.attributes["class"].split()
        assert ("vi-later" in classes) == (now[k] == UNKNOWN)
        if now[k] != UNKNOWN:
            assert {USED: "vi-used", GATED: "vi-gated", OPEN: "vi-open"}[int(now[k])] in classes
    for verdict, name in ((USED, "used"), (GATED, "gated")):
        assert html.one("span", data_fixes=name).attributes["data-count"] == str(int((now == verdict).sum()))
    assert html.all("polyline", data_line="final") and html.all("polyline", data_line="live")
    assert html.one("circle", data_body="1")


def test_positions_and_ellipses_are_true_to_scale(run: RunView) -> None:
    ground = Ground.around(np.array([[-3.0, 2.0], [9.0, 8.0]]))
    corners = ground.place(np.array([[-3.0, 2.0, 5.0], [9.0, 8.0, 0.0]]))
    assert (corners >= 0).all() and (corners <= [1000, ground.height]).all()
    east_north = (corners[1] - corners[0]) / ground.unit_per_m
    np.testing.assert_allclose(east_north, [12.0, -6.0])
    fix = int(np.flatnonzero(run.series.gps.final_verdicts == USED)[-1])
    html = shown(run, len(run) - 1, fix)
    oval = html.one("ellipse", data_ellipse=str(fix))
    C = run.series.gps.covariance[fix, :2, :2]
    radii = sorted(float(oval.attributes[name]) for name in ("rx", "ry"))
    assert radii[1] / radii[0] == pytest.approx(np.sqrt(np.linalg.cond(C)), rel=0.1)


def test_a_selected_fix_shows_each_gate_with_value_limit_and_parameter(run: RunView) -> None:
    series = run.series.gps
    gated = next(k for k in range(len(series)) if series.final_verdicts[k] == GATED and "chi2" in series.failed[k])
    html = shown(run, len(run) - 1, gated)
    report = run.report(int(series.frame[gated])).gps
    assert report is not None
    fix = next(f for f in report.fixes if f.t_ns == series.t_ns[gated])
    lines = {e.attributes["data-gate"]: e for e in html.all("div", cls="vi-gateline")}
    assert {g.name for g in fix.gates} <= set(lines)
    assert "vi-failed" in lines["chi2"].attributes["class"]
    assert "gps.max_chi2" in "".join(e.attributes.get("onclick", "") for e in lines["chi2"].walk())
    assert "in the end gated" in html.text and "innovation" in html.text


def test_without_a_selection_the_last_fix_stands_there(run: RunView) -> None:
    frame = len(run) - 1
    last = len(run.series.gps) - 1
    assert gps.selected_fix(at(run, frame)) == last
    assert gps.selected_fix(at(run, 3)) == -1
    assert "no pose" in shown(run, 3).text


def test_the_heading_is_drawn_with_its_band_and_outages(run: RunView) -> None:
    html = parse(gps.backdrop(at(run, 0)))
    assert html.one("div", data_plot="yaw")
    assert not html.all("rect")
    header = run.header
    limited = RunView(run.reader)
    limited.reader = _With(run.reader, replace(header, params=replace(header.params, gps=_outage(header, 0.25))))
    silent = parse(gps.backdrop(at(limited, 0))).all("rect")
    widths = [float(e.attributes["width"]) for e in silent]
    assert max(widths) > 100 and all("no fix counts" in e.text for e in silent)


def _outage(header, seconds: float):
    return replace(header.params.gps, max_outage_s=seconds)


class _With:
    """A reader with another header."""

    def __init__(self, reader: RunReader, header: object) -> None:
        self._reader, self.header = reader, header

    def __getattr__(self, name: str) -> object:
        return getattr(self._reader, name)


def test_every_word_and_gate_explains_itself(run: RunView) -> None:
    for frame in (aligned_at(run) - 1, len(run) - 1):
        html = parse(gps.backdrop(at(run, frame)) + gps.render(at(run, frame)))
        assert {e.attributes["data-tip"] for e in html.all() if "data-tip" in e.attributes} <= set(TIPS)
        report = run.report(frame).gps
        assert report is not None
        assert all(gate_tip(gate) for gate in (*report.gates, *(g for f in report.fixes for g in f.gates)))
    assert str(GpsStatus.ALIGNING) in shown(run, aligned_at(run) - 1).text


def test_in_3d_fixes_and_the_final_trajectory_lie_along_the_odometry(run: RunView) -> None:
    last = len(run) - 1
    report = run.report(last)
    frame = SceneFrame(run, last, report, Selection("fix", len(run.series.gps) - 1), None, np.zeros((0, 3)), 1.0)
    path = run.series.p_w_b[np.isfinite(run.series.p_w_b[:, 0])]
    drawn = final(frame)
    assert np.linalg.norm(drawn - path, axis=1).max() < 0.3
    counted = fixes(frame)
    lever = np.linalg.norm(run.header.calibration.p_b_gps)
    gap = np.linalg.norm(counted[FixVerdict.USED][:, None] - path[None], axis=2).min(1)
    assert len(gap) > 12 and gap.max() < lever + 0.5
    assert np.linalg.norm(counted[FixVerdict.GATED][:, None] - path[None], axis=2).min(1).max() > 5
    found = ellipsoid(frame)
    assert found is not None
    np.testing.assert_allclose(np.sort(found[1]), 3 * np.sqrt(np.linalg.eigvalsh(run.series.gps.covariance[-1])))
    assert ellipsoid(replace(frame, selection=Selection())) is None
