"""Gates: every comparison of a frame, and where to look when there was none."""

import dataclasses

from fake_reports import FIRST_SOLVE, context, gate_values, lost_again, parse, run_with
from synthetic_flight import fly, lively

from app.panels import gates
from app.tooltips import TIPS, gate_tip
from vins_core.initialization.step import initialize
from vins_core.params import Params
from vins_core.report import Gate, InitReport, InitStage, Status


def page(frame, **changes):
    return parse(gates.render(context(frame, **changes)))


def names(markup):
    return [e.attributes["data-gate"] for e in markup.all("span") if "data-gate" in e.attributes]


def test_every_gate_of_the_frame_is_shown():
    for frame in (5, 10, FIRST_SOLVE, 30):
        report = context(frame).report
        if report.initialization is not None or report.status is Status.TRACKING:
            assert sorted(names(page(frame))) == sorted(g.name for g in gate_values(report))


def test_an_attempt_lights_a_lamp_for_every_stage():
    lamps = {e.attributes["data-lamp"]: e.attributes["class"] for e in page(FIRST_SOLVE).all("div")
             if "data-lamp" in e.attributes}  # fmt: skip
    assert tuple(lamps) == gates.STAGES
    passed = {s.name for s in context(FIRST_SOLVE).report.initialization.stages}
    assert {name for name, cls in lamps.items() if "vi-ok" in cls} == passed


def test_lamps_are_in_the_order_of_a_real_attempt():
    flight = fly(lively())
    _, attempt = initialize(Params(), flight.calibration, flight.window, flight.history)
    assert attempt.succeeded
    assert tuple(stage.name for stage in attempt.stages) == gates.STAGES
    for stage in attempt.stages:
        assert f"stage.{stage.name}" in TIPS
        assert all(gate_tip(gate) in TIPS for gate in stage.gates)


def test_a_stage_of_another_version_gets_a_lamp_too():
    report = context(10).report
    odd = InitReport((InitStage("crystal ball", (), ""),), False, -1, None, None, None)
    markup = page(10, report=dataclasses.replace(report, initialization=odd))
    assert any(e.attributes.get("data-lamp") == "crystal ball" for e in markup.all("div"))


def test_the_failed_stage_comes_first_with_its_reason():
    report = context(10).report
    stages = (
        InitStage("excitation", (Gate("excitation", 0.6, ">=", 0.25, "init.min_excitation", "m/s^2"),), ""),
        InitStage(
            "relative pose", (Gate("matches", 12, ">", 20, "init.min_matches"),), "too few tracks", {"slot": 2.0}
        ),
    )
    attempt = InitReport(stages, False, -1, None, None, None)
    markup = page(10, report=dataclasses.replace(report, initialization=attempt))
    assert [e.attributes["data-stage"] for e in markup.all("div") if "data-stage" in e.attributes] == [
        "relative pose",
        "excitation",
    ]
    assert "too few tracks" in markup.text and "8 short" in markup.text and "slot 2" in markup.text


def test_values_of_a_stage_are_read_with_their_units():
    values = {"turned_deg": 3.25, "b_g_x": 0.001, "b_g_y": -0.02, "b_g_z": 0.0, "residual_m": 0.012, "points": 140.0}
    assert list(gates._values(values)) == [
        ("turned", "3.25", "deg"),
        ("b_g", "0.00100, −0.0200, 0", ""),
        ("residual", "0.0120", "m"),
        ("points", "140", ""),
    ]


def test_while_the_window_fills_the_first_attempt_is_named():
    markup = page(4)
    assert "the window must hold 11 frames" in markup.text
    assert any(e.attributes["onclick"] == 'vi.send({"k":"frame","i":10})' for e in markup.all("a", cls="vi-link"))


def test_between_attempts_the_last_one_explains():
    silent = dataclasses.replace(context(11).report, initialization=None)
    markup = page(11, run=run_with(silent), report=silent)
    assert "The last attempt, at frame 10, failed" in markup.text
    assert "excitation" in names(markup)


def test_a_run_that_was_never_tried_says_so():
    plain = [dataclasses.replace(context(k).report, initialization=None, status=Status.FILLING) for k in range(45)]
    markup = page(5, run=run_with(*plain), report=plain[5])
    assert "No attempt was made yet" in markup.text


def test_while_tracking_the_initialisation_is_a_link():
    markup = page(30)
    assert f"Initialised at frame {FIRST_SOLVE}" in markup.text
    assert not [e for e in markup.all("div") if "data-lamp" in e.attributes]


def test_why_not_comes_first_while_initialising():
    def order(frame):
        return [e.text for e in page(frame).all(cls="vi-h")]

    assert order(10)[0].startswith("initialisation")
    assert order(30)[0].startswith("keyframe")


def test_a_keyframe_is_a_decision_not_a_failure():
    frame = next(k for k in range(20, 40) if context(k).report.keyframe.is_keyframe)
    markup = page(frame)
    assert "Keyframe: " in markup.text and f"about frame {frame - 1}" in markup.text
    labels = [e.attributes["aria-label"] for e in markup.all("svg") if "aria-label" in e.attributes]
    assert "triggered" in labels
    assert "failed" not in labels


def test_the_first_frame_decides_about_no_keyframe():
    assert "Decided from the second frame on" in page(0).text


def test_health_that_failed_comes_first_with_its_sentence():
    report = lost_again(context(30).report)
    markup = page(30, report=report, run=run_with(report))
    assert "the bias is too large" in markup.text and "0.6 over" in markup.text
    assert names(markup)[-len(report.health.gates)] == "accelerometer bias"


def test_after_a_restart_health_names_it():
    silent = dataclasses.replace(context(31).report, health=None, status=Status.FILLING)
    markup = page(31, run=run_with(lost_again(context(30).report), silent), report=silent)
    assert "Restarted at frame 30" in markup.text


def test_before_the_first_solve_health_says_when():
    assert f"the first is at frame {FIRST_SOLVE}" in page(5).text


def test_losses_are_counted_here_too():
    frame = next(k for k in range(20, 40) if len(context(k).report.tracks.lost_ids) > 2)
    tracks = context(frame).report.tracks
    assert f"{len(tracks.lost_ids)} lost" in page(frame).text
