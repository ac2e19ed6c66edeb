"""The Depth panel without a browser: the image, why tracks have no depth, measured against estimated, runs without."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from depth_room import VARIANTS
from fake_reports import Markup, context, parse, shared_view

from app.context import PanelContext, RunView
from app.images import Images
from app.panels import depth, signals
from app.runs import image_source
from app.tooltips import TIPS, gate_tip
from app.widgets.depth_plot import histogram, scatter
from vins_core.record.reader import RunReader
from vins_core.report import DEPTH_LOSSES, DEPTH_USES, DepthLoss, DepthUse


@pytest.fixture(scope="module")
def views(depth_runs: dict[str, Path]) -> dict[str, RunView]:
    return {variant: RunView(RunReader(folder)) for variant, folder in depth_runs.items()}


@pytest.fixture(scope="module")
def run(views: dict[str, RunView]) -> RunView:
    return views["trust"]


def shown(ctx: PanelContext) -> Markup:
    return parse(depth.render(ctx))


def test_only_runs_with_a_depth_camera_have_the_panel(run: RunView) -> None:
    assert depth.exists(run) and not depth.exists(shared_view())


def test_every_track_is_marked_with_its_depth_or_the_reason(run: RunView) -> None:
    ctx = context(len(run) - 1, run=run)
    tracks, page = ctx.report.tracks, shown(ctx)
    marks = [e for e in page.all() if "data-measured" in e.attributes]
    assert sorted(int(e.attributes["data-measured"]) for e in marks) == sorted(tracks.ids.tolist())
    counts = {e.attributes["data-depth-loss"] for e in page.all() if "data-depth-loss" in e.attributes}
    assert counts == {str(DEPTH_LOSSES[i]) for i in set(tracks.depth_loss.tolist()) - {255}}


@pytest.mark.parametrize("variant", VARIANTS)
def test_dots_are_the_tracks_whose_landmarks_have_an_estimate(views: dict[str, RunView], variant: str) -> None:
    run = views[variant]
    ctx = context(len(run) - 1, run=run)
    found, page = ctx.report.depth, shown(ctx)
    dots = {int(e.attributes["data-depth-of"]) for e in page.all() if "data-depth-of" in e.attributes}
    assert dots == set(found.seen_ids[np.isfinite(found.seen_estimated_m)].tolist()) and len(dots) > 20
    assert str(DepthUse.HELD if variant == "hold" else DepthUse.FACTOR) in page.text


def test_a_selected_track_shows_its_gates_and_stands_out(run: RunView) -> None:
    report = run.report(len(run) - 1)
    found = report.depth
    used = found.ids[found.use == DEPTH_USES.index(DepthUse.FACTOR)]
    id = int(np.intersect1d(used, found.seen_ids)[0])
    page = shown(context(len(run) - 1, run=run, track=id))
    named = {e.attributes["data-gate"] for e in page.all() if "data-gate" in e.attributes}
    assert {"pixels with depth", "nearest depth", "farthest depth", "chi-square at the anchor"} <= named
    dot = next(e for e in page.all() if e.attributes.get("data-depth-of") == str(id))
    assert dot.attributes["r"] == "6"


def test_before_the_first_pose_and_without_a_depth_image_it_says_so(run: RunView) -> None:
    assert "not solved yet" in shown(context(3, run=run)).text
    report = run.report(len(run) - 1)
    n = len(report.tracks.ids)
    blind = replace(
        report.tracks,
        depth_m=np.full(n, np.nan, np.float32),
        depth_variation=np.full(n, np.nan, np.float32),
        depth_share=np.zeros(n, np.float32),
        depth_loss=np.full(n, DEPTH_LOSSES.index(DepthLoss.NO_IMAGE), np.uint8),
    )
    ctx = context(len(run) - 1, run=run, track=int(report.tracks.ids[0]), report=replace(report, tracks=blind))
    page = shown(ctx)
    assert str(DepthLoss.NO_IMAGE) in page.text and "depth image" in page.text
    none = replace(report.tracks, depth_loss=blind.depth_loss[:0])
    assert "no track to measure" in shown(context(3, run=run, report=replace(report, tracks=none))).text


@pytest.mark.parametrize("variant", ["trust", "confirm"])
def test_the_depth_image_is_coloured_where_it_has_depth(views: dict[str, RunView], variant: str) -> None:
    """From the recording, or from a record that holds its images."""
    run = views[variant]
    images, sensor = Images(image_source(run.reader)), run.header.calibration.cameras[0].depth
    ref = run.reader.packet(5).depth
    uri = images.depth_uri(ref, sensor)
    assert uri.startswith("data:image/png;base64,") and images.depth_uri(ref, sensor) == uri
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(uri.split(",")[1]), np.uint8), cv2.IMREAD_UNCHANGED)
    depth_m = image_source(run.reader).load_depth(ref, sensor.scale_m)
    np.testing.assert_array_equal(pixels[:, :, 3] > 0, np.isfinite(depth_m))
    brightness = pixels[:, :, :3].sum(2)
    near, far = (depth_m < np.nanquantile(depth_m, 0.1)), (depth_m > np.nanquantile(depth_m, 0.9))
    assert brightness[near].mean() > brightness[far].mean()


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_word_and_gate_on_the_panel_is_explained(views: dict[str, RunView], variant: str) -> None:
    run = views[variant]
    report = run.report(len(run) - 1)
    keys = set()
    for track in report.tracks.ids[:12].tolist():
        page = shown(context(len(run) - 1, run=run, track=track))
        keys |= {e.attributes["data-tip"] for e in page.all() if "data-tip" in e.attributes}
    assert len(keys) > 8 and keys - {""} <= set(TIPS)
    assert all(gate_tip(gate) in TIPS for gate in report.depth.gates)
    assert all(f"depth.loss.{loss}" in TIPS for loss in DEPTH_LOSSES)
    assert all(f"depth.use.{use}" in TIPS for use in DEPTH_USES)


@pytest.mark.parametrize("variant", ["trust", "hold"])
def test_what_depth_costs_is_a_signal_where_there_is_any(views: dict[str, RunView], variant: str) -> None:
    run = views[variant]
    keys = {signal.key for signal, _ in signals.present(context(len(run) - 1, run=run))}
    assert ("depth" in keys) == (variant == "trust")
    total = run.series.cost[-1].sum()
    assert total == pytest.approx(run.report(len(run) - 1).solve.after.total)
    assert not {"depth"} & {signal.key for signal, _ in signals.present(context(20))}


def test_depths_that_agree_lie_on_the_line() -> None:
    z = np.array([0.5, 2.0, 7.0])
    page = parse(scatter(np.arange(3), z, z, 0.02, ["#fff"] * 3, [""] * 3, -1))
    dots = [e for e in page.all() if "data-depth-of" in e.attributes]
    x, y = (np.array([float(e.attributes[name]) for e in dots]) for name in ("cx", "cy"))
    slope = np.diff(y) / np.diff(x)
    assert (np.diff(x) > 0).all() and slope[0] == pytest.approx(slope[1], abs=0.01) and slope[0] < 0


def test_the_histogram_counts_everything_however_far_out() -> None:
    page = parse(histogram(np.array([-100.0, 0.0, 0.1, 4.0, 80.0])))
    assert sum(int(e.attributes["data-count"]) for e in page.all() if "data-count" in e.attributes) == 5
