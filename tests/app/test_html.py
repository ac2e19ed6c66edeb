"""Text never becomes markup, and numbers are printed so that they can be compared."""

import json

import pytest
from fake_reports import parse
from hypothesis import given
from hypothesis import strategies as st

from app.html import Html, brief, chip, fixed, number, send, stacked_bar, table, table_row, tag, text


@given(st.text())
def test_text_survives_the_page_and_is_never_markup(words):
    words = words.replace("\r", "").replace("\0", "")  # an html parser normalises these
    root = parse(tag("p", words, title=words or None)).root
    (p,) = root.children
    assert p.text == words
    assert not p.children
    assert p.attributes.get("title", "") == words


@given(st.text())
def test_a_message_reaches_javascript_as_sent(words):
    (a,) = parse(tag("a", "x", onclick=send(k="knob", key=words))).root.children
    call = a.attributes["onclick"]
    assert call.startswith("vi.send(") and call.endswith(")")
    assert json.loads(call[len("vi.send(") : -1]) == {"k": "knob", "key": words}


def test_markup_is_not_escaped_twice():
    assert text((Html("<b>1</b>"), " < ", 2, None)) == "<b>1</b> &lt; 2"
    assert tag("p", [tag("b", "a"), "&"]) == "<p><b>a</b>&amp;</p>"


def test_attributes_without_value_are_left_out():
    assert tag("p", cls="", title=None, data_tip="x") == '<p data-tip="x"></p>'


@pytest.mark.parametrize(
    ("value", "figures"),
    [
        (None, "–"),
        (float("nan"), "–"),
        (float("inf"), "∞"),
        (-float("inf"), "−∞"),
        (0.0, "0"),
        (-0.0, "0"),
        (150, "150"),
        (-12.34, "−12.3"),
        (0.0123456, "0.0123"),
        (999.9, "1000"),
        (1234567.0, "1.2e6"),
        (3.1e-7, "3.1e-7"),
    ],
)
def test_numbers_have_three_figures(value, figures):
    assert number(value) == figures


@given(st.floats(-1e12, 1e12))
def test_a_printed_number_is_the_number(value):
    printed = float(number(value, 5).replace("−", "-"))
    assert printed == pytest.approx(value, rel=1e-3, abs=1e-300)


def test_brief_drops_trailing_zeros_only_behind_the_point():
    assert [brief(v) for v in (0.25, 2.0, 20, 100, 2.5, 1e-3)] == ["0.25", "2", "20", "100", "2.5", "0.001"]


def test_columns_keep_their_places():
    assert [fixed(v, 2) for v in (1.0, -0.001, -2.345, float("nan"))] == ["1.00", "0.00", "−2.35", "–"]


def test_a_row_has_as_many_cells_as_columns():
    row = table_row(("a", 1), ("", "n"))
    assert [c.attributes.get("class") for c in parse(table((("x", ""), ("y", "n")), [row])).all("td")] == [None, "vi-n"]
    with pytest.raises(ValueError):
        table_row(("a",), ("", "n"))


def test_a_stack_is_as_wide_as_its_share_of_the_whole():
    widths = [e.attributes["style"] for e in parse(stacked_bar([("a", 1.0, "#000"), ("b", 3.0, "#111")], 8.0)).all("i")]
    assert [w.split(";")[0] for w in widths] == ["width:12.50%", "width:37.50%"]


def test_a_stack_of_nothing_is_empty():
    assert not parse(stacked_bar([("a", 0.0, "#000")])).all("i")


def test_a_chip_explains_itself():
    (element,) = parse(chip("m ", 57, tone="prior", tip="margin.m")).root.children
    assert element.text == "m 57"
    assert element.attributes == {"class": "vi-chip vi-prior", "data-tip": "margin.m"}
