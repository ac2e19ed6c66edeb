"""How unknown extrinsics are found, on the page."""

import numpy as np
import pytest
from fake_reports import context, parse, shared_view
from fake_run import FIRST_SOLVE
from hand_eye_run import FIRST, attempts, hand_eye_run

from app.context import RunView
from app.panels import gates, hand_eye
from app.tooltips import TIPS
from vins_core.geometry import so3


@pytest.fixture(scope="module")
def run() -> RunView:
    return RunView(hand_eye_run())  # type: ignore[arg-type]


def shown(run: RunView, frame: int):
    return parse(hand_eye.render(context(frame, run=run)))


def test_it_is_there_only_for_runs_that_do_not_know_their_extrinsics(run):
    assert hand_eye.exists(run) and not hand_eye.exists(shared_view())
    assert "Nothing is known yet" in shown(run, 0).text
    assert "Nothing is known yet" in shown(shared_view(), 20).text


def test_a_waiting_attempt_says_what_to_do_and_the_last_one_that_it_is_found(run):
    assert "rotate the device about two axes" in shown(run, FIRST + 1).text
    assert "Every gate has passed" in shown(run, FIRST_SOLVE).text
    later = shown(run, 25)  # after it, the last attempt stands
    assert f"frame {FIRST_SOLVE}" in later.text and "Every gate has passed" in later.text


def test_the_table_has_the_rotation_and_its_sigma(run):
    page, attempt = shown(run, FIRST_SOLVE), attempts()[-1]
    rows = [[c.text for c in r.children] for r in page.one("tbody").children]
    found = np.degrees(so3.log(attempt.q_b_c))
    for axis, (row, value, sigma) in enumerate(zip(rows, found, attempt.sigma_deg)):
        assert row[0] == "xyz"[axis]
        assert float(row[1].replace("−", "-")) == pytest.approx(value, abs=0.006)
        assert float(row[2]) == pytest.approx(sigma, abs=0.006)
    assert "from given" not in page.text


def test_what_was_given_is_told_beside_what_was_found():
    page = shown(RunView(hand_eye_run(given=True)), FIRST_SOLVE)  # type: ignore[arg-type]
    assert "apart" in page.text and "from given" in page.text and "from what was given" in page.text


def test_every_attempt_has_a_column_that_leads_to_its_frame(run):
    page = shown(run, FIRST_SOLVE)
    lane = page.one(data_attempts=str(FIRST_SOLVE - FIRST + 1))
    goes = [e.attributes["onclick"] for e in lane.walk() if "onclick" in e.attributes]
    assert goes == [f'vi.send({{"k":"frame","i":{k}}})' for k in range(FIRST, FIRST_SOLVE + 1)]


def test_every_gate_is_shown_with_its_parameter_and_explained(run):
    page = shown(run, FIRST + 2)
    assert [e.attributes["data-gate"] for e in page.all() if "data-gate" in e.attributes] == [
        g.name for g in attempts()[2].gates
    ]
    assert {e.attributes["data-tip"] for e in page.all() if "data-tip" in e.attributes} <= set(TIPS)
    assert all(f"gate.{g.knob}" in TIPS for g in attempts()[2].gates)


def test_the_gates_panel_has_a_lamp_for_it_before_all_others(run):
    page = parse(gates.render(context(FIRST_SOLVE, run=run)))
    assert next(e.attributes["data-lamp"] for e in page.all() if "data-lamp" in e.attributes) == "extrinsic rotation"
    plain = parse(gates.render(context(FIRST_SOLVE)))
    assert not plain.all(data_lamp="extrinsic rotation")


def test_a_long_wait_shares_columns():
    frames = list(range(1000))
    assert str(hand_eye._hits(frames)).count("onclick") <= 200
