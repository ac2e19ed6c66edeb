"""How the rotation between camera and IMU is found where the calibration does not know it: estimate, sigma, gates.

One strip per axis of the camera, an attempt per frame, with one standard deviation to either side; below them what the
gates wait for.  Only attempts have a column here: they end where initialisation succeeds.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vins_core import params as parameters
from vins_core.geometry import so3
from vins_core.initialization.hand_eye import stage
from vins_core.report import FrameSummary, HandEyeReport

from ..context import PanelContext, RunView
from ..html import (
    Html,
    chip,
    empty,
    fixed,
    frame_link,
    heading,
    key_cap,
    muted,
    number,
    panel,
    row,
    send,
    strong,
    table,
    table_row,
    tag,
    term,
    text,
    unit,
)
from ..palette import BAD, ESTIMATE, SELECTION, TRUTH
from ..widgets.gate import gate_list
from ..widgets.plot import WIDTH, area, line, svg, x_of

TITLE = "Hand-eye"
ICON = "GIZMO"
KEY = "hand_eye"

HEIGHT, GAP = 42, 3
MIN_SPAN_DEG, MAX_SPAN_DEG = 0.5, 15.0
"""Of a strip, to either side of its middle."""


def exists(run: RunView) -> bool:
    return run.header.calibration.extrinsics == "unknown" and run.header.calibration.has_imu


def render(ctx: PanelContext) -> str:
    tries = [s for s in ctx.run.summaries if s.hand_eye is not None and s.hand_eye.q_b_c is not None]
    shown = next((s for s in reversed(tries) if s.frame <= ctx.frame), None)
    if shown is None:
        sentence = "Nothing is known yet of how the camera is turned."
        return panel(KEY, empty(sentence, "It takes a few frames with tracks: press ", key_cap("→"), "."))
    report = ctx.run.report(shown.frame).hand_eye
    assert report is not None
    return panel(KEY, _verdict(ctx, shown, report), *_rotation(ctx, report), *_convergence(ctx, tries), *_gates(report))


def _verdict(ctx: PanelContext, shown: FrameSummary, report: HandEyeReport) -> Html:
    at = () if shown.frame == ctx.frame else (muted("  frame "), frame_link(shown.frame, shown.frame))
    if not report.found:
        return tag("div", stage(report).outcome, *at, cls="vi-outcome")
    words = "Every gate has passed." if report.accepted else "Found earlier; this attempt does not pass every gate."
    return tag("div", strong("Found. "), words, *at, cls="vi-outcome vi-good")


def _rotation(ctx: PanelContext, report: HandEyeReport) -> Iterator[Html]:
    assert report.q_b_c is not None and report.sigma_deg is not None and report.b_g is not None
    yield heading("camera in the body", f"from {report.n_pairs} pairs of frames", "hand_eye.rotation")
    given, found = _given(ctx.run), np.degrees(so3.log(report.q_b_c))
    names: list[tuple[str, str]] = [("about", ""), ("found °", "n"), ("σ °", "n")]
    columns = [list("xyz"), [fixed(float(v), 2) for v in found], [fixed(float(v), 2) for v in report.sigma_deg]]
    if given is not None:
        away = _away_deg(report.q_b_c, given)
        names += [("given °", "n"), ("apart °", "n")]
        columns += [[fixed(float(v), 2) for v in rows] for rows in (np.degrees(so3.log(given)), away)]
    kinds = [kind for _, kind in names]
    yield table(names, (table_row(cells, kinds) for cells in zip(*columns)))
    bias = ", ".join(number(float(v), 2) for v in report.b_g)
    chips = [
        chip("b_g ", strong(bias), unit("rad/s"), tip="hand_eye.bias"),
        chip("time offset ", strong(number(1e3 * (report.td_s or 0.0), 2)), unit("ms"), tip="hand_eye.td"),
    ]
    if given is not None:
        apart = float(np.linalg.norm(_away_deg(report.q_b_c, given)))
        chips.append(chip("from given ", strong(number(apart)), unit("deg"), tip="hand_eye.given"))
    yield row(*chips)


def _convergence(ctx: PanelContext, tries: list[FrameSummary]) -> Iterator[Html]:
    """Strips over all attempts; the last one, or what was given, is their middle."""
    known = [s.hand_eye for s in tries if s.hand_eye is not None]
    q, sigma = (np.array([getattr(h, name) for h in known]) for name in ("q_b_c", "sigma_deg"))
    given = _given(ctx.run)
    away = _away_deg(q, q[-1] if given is None else given)
    frames = [s.frame for s in tries]
    here = int(np.searchsorted(frames, ctx.frame, side="right")) - 1
    note = "° from the last attempt" if given is None else "° from what was given"
    yield heading("attempts", note, "hand_eye.attempts")
    names, strips, values = [], [], []
    for axis, name in enumerate("xyz"):
        span = _span(away[:, axis], sigma[:, axis])
        names.append(_name(name, f"± {number(span, 2)}°", "hand_eye.attempts"))
        strips.append(_band(away[:, axis], sigma[:, axis], span))
        values.append((fixed(float(away[here, axis]), 2), "deg"))
    for name, gate, series, unit_name, tip in (
        ("worst σ", "init.hand_eye_max_sigma_deg", sigma.max(1), "deg", "hand_eye.sigma"),
        (
            "singular",
            "init.hand_eye_min_singular",
            np.array([h.singular_value for h in known]),
            "",
            "hand_eye.singular",
        ),
    ):
        limit = float(parameters.get(ctx.run.header.params, gate))
        top = max(4.0 * limit, 1e-6) if unit_name else max(1.1 * float(series.max()), 2.0 * limit, 1e-6)
        names.append(_name(name, f"limit {number(limit, 2)}{'°' if unit_name else ''}", tip))
        strips.append(_curve(series, top, limit))
        values.append((number(float(series[here])), unit_name))
    lane = tag("div", *strips, _hits(frames), _playhead(here, len(frames)), cls="vi-lane", data_attempts=len(frames))
    cells = (tag("div", tag("span", v, unit(u)), cls="vi-value", style=_TALL) for v, u in values)
    yield tag(
        "div",
        tag("div", *names, cls="vi-names"),
        lane,
        tag("div", *cells, cls="vi-values"),
        cls="vi-plots",
    )


def _gates(report: HandEyeReport) -> Iterator[Html]:
    failed = sum(not g.passed for g in report.gates if g.decides)
    yield heading("gates", f"{failed} not passed" if failed else "all passed", "hand_eye.gates")
    yield gate_list(report.gates)


# Numbers


def _given(run: RunView) -> np.ndarray | None:
    """(4,) what the calibration says all the same; the identity stands for nothing."""
    T_b_c = run.header.calibration.cameras[0].T_b_c
    return None if np.array_equal(T_b_c[:3, :3], np.eye(3)) else so3.from_matrix(T_b_c[:3, :3])


def _away_deg(q: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(..., 3) about the axes of the camera."""
    return np.degrees(so3.difference(q, reference))


def _span(away: np.ndarray, sigma: np.ndarray) -> float:
    """Half of a strip's height: the later half of the attempts fits, a wild beginning is cut."""
    later = slice(len(away) // 2, None)
    return float(np.clip(1.2 * np.max(np.abs(away[later]) + sigma[later]), MIN_SPAN_DEG, MAX_SPAN_DEG))


# Strips

_TALL = f"height:{HEIGHT}px;margin-bottom:{GAP}px"


def _name(name: str, note: str, tip: str) -> Html:
    return tag("div", term(name, tip), tag("span", note, cls="vi-max"), cls="vi-name", style=_TALL)


def _band(away: np.ndarray, sigma: np.ndarray, span: float) -> Html:
    low, high = away - sigma + span, away + sigma + span
    middle = _rule(HEIGHT / 2, TRUTH)
    band = area(low, high, 2 * span, HEIGHT, f"{ESTIMATE}44")
    return _strip(band, middle, line(away + span, 2 * span, HEIGHT, ESTIMATE))


def _curve(values: np.ndarray, top: float, limit: float) -> Html:
    return _strip(line(values, top, HEIGHT, ESTIMATE), _rule(HEIGHT - limit / top * (HEIGHT - 2) - 1, BAD))


def _strip(*body: Html) -> Html:
    return tag("div", svg(HEIGHT, *body), cls="vi-strip", style=_TALL)


def _rule(y: float, colour: str) -> Html:
    return Html(
        f'<path d="M0,{y:.1f}H{WIDTH}" stroke="{colour}" stroke-opacity=".6" stroke-dasharray="4 4" '
        'vector-effect="non-scaling-stroke"/>'
    )


def _hits(frames: list[int]) -> Html:
    """What a click on an attempt does; long waits share columns."""
    columns = frames if len(frames) <= 200 else frames[:: len(frames) // 200 + 1]
    width = 100.0 / len(columns)
    return text(
        tag(
            "i",
            style=f"position:absolute;top:0;bottom:0;left:{k * width:.2f}%;width:{width:.2f}%",
            onclick=send(k="frame", i=frame),
            title=f"frame {frame}",
        )
        for k, frame in enumerate(columns)
    )


def _playhead(here: int, n: int) -> Html:
    x = 100.0 * float(x_of(here, n)) / WIDTH
    return tag("i", style=f"position:absolute;top:0;bottom:0;left:{x:.2f}%;width:2px;margin-left:-1px;"
               f"background:{SELECTION};pointer-events:none")  # fmt: skip
