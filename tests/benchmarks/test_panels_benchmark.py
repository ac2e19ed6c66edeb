"""Milliseconds to render each panel of a tracked frame (target: 5 ms for 150 tracks).

pytest tests/benchmarks/test_panels_benchmark.py --benchmark-enable
"""

import pytest
from fake_reports import context

from app.panel_view import PANELS


@pytest.mark.parametrize("key", PANELS)
def test_render(benchmark, key):
    ctx = context(40, track=int(context(40).report.tracks.ids[5]))
    assert benchmark(PANELS[key].render, ctx)


@pytest.mark.parametrize("key", [key for key, module in PANELS.items() if hasattr(module, "backdrop")])
def test_backdrop(benchmark, key):
    assert benchmark(PANELS[key].backdrop, context(20))
