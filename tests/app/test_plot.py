"""Curves over long runs stay true at any length."""

import re

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from app.widgets.plot import WIDTH, area, line, nice_step, thin, ticks, top_of, x_of


def points(svg: str) -> np.ndarray:
    return np.array([[float(a), float(b)] for a, b in re.findall(r"(-?[\d.]+),(-?[\d.]+)", svg)]).reshape(-1, 2)


@given(st.integers(2, 30_000), st.integers(0, 2**32 - 1))
def test_no_spike_is_lost_by_thinning(n, seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=n)
    values[rng.integers(n)] = 1e3
    values[rng.integers(n)] = -1e3
    x, y = thin(values)
    assert np.nanmax(y) == values.max() and np.nanmin(y) == values.min()
    assert len(y) <= max(2 * WIDTH, 3 * WIDTH)
    assert np.all(np.diff(x) >= 0)


def test_a_gap_stays_a_gap():
    values = np.array([1.0, 2.0, np.nan, 3.0, np.nan, 2.0, 1.0])
    path = re.search(r'd="([^"]*)"', line(values, 4, 40, "#fff"))[1]
    assert path.count("M") == 3
    assert len(points(path)) == 5
    assert "h.5" in path  # a single point between two gaps is still drawn


def test_ends_of_a_curve_are_ends_of_the_run():
    x = points(line(np.arange(5.0), 4, 40, "#fff"))[:, 0]
    assert x[0] == 0 and x[-1] == WIDTH
    assert x_of(0, 1) == 0  # a run of one frame


def test_higher_is_up_and_what_is_too_high_is_cut():
    y = points(line(np.array([0.0, 1.0, 2.0, 100.0]), 2.0, 40, "#fff"))[:, 1]
    assert y[0] > y[1] > y[2] == y[3] >= 0


def test_an_area_lies_between_its_curves():
    low, high = np.array([0.0, 0.0, np.nan, 1.0]), np.array([2.0, 2.0, 2.0, 2.0])
    band = area(low, high, 4.0, 40, "#fff")
    assert band.count("M") == 2 and band.count("Z") == 2
    assert points(band)[:, 1].min() >= 20 - 1e-9


def test_ticks_share_columns_in_a_long_run():
    svg = ticks(np.arange(100_000), 100_000, 0, 9, "#fff")
    assert svg.count("V9") <= 10 * WIDTH + 1


def test_an_axis_is_not_ruled_by_one_spike():
    calm = np.ones(1000)
    calm[500] = 1e6
    assert top_of(calm) < 10
    assert top_of(np.linspace(0, 5, 100)) >= 5
    assert top_of(np.array([np.nan])) == 1.0
    assert top_of(np.zeros(4)) == 1.0


@given(st.floats(1e-3, 1e6), st.integers(2, 20))
def test_steps_are_round_and_few(span, most):
    step = nice_step(span, most)
    assert span / step <= most + 1e-9
    assert f"{step:.0e}"[0] in "125"
