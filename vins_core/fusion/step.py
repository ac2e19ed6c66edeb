"""GPS fusion, a frame on one page (SPEC 8.2; REFERENCE 19; seed 004, GPS section).

Loosely coupled: the odometry's poses T_o_b are taken as they are, with an error that grows along the way (drift.py),
and fixes hold them to the earth.  The cost of a frame is bounded: only the moments of a window are open, what came
before is a prior.  The pose of a frame is its estimate right after its own step; smooth.py gives the final trajectory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .. import params
from ..geometry import heading, poses, so3
from ..report import FixReport, FixRevision, FixVerdict, Gate, GpsReport, GpsStatus, all_pass
from ..sensors import GpsFix
from . import window
from .chain import free_components, full_covariance, predict, predict_covariance
from .drift import ROTATION, SCALE, SIZE, between, compose, nothing
from .gate import Admission, admit, chi2_gate, refuse
from .state import Anchor, GpsState, Node, OdometryPose, Track, forget

YAW = 5
"""Of the error state."""


@dataclass(frozen=True)
class _Prediction:
    """What the odometry says of the newest frame."""

    x: np.ndarray  # (8,)
    covariance: np.ndarray  # (7, 7), dp in `e`

    def innovation(self, anchor: Anchor) -> tuple[np.ndarray, np.ndarray]:
        """A fix minus its expectation, (3,), with the covariance (3, 3)."""
        H = np.zeros((3, SIZE))
        H[:, :3] = np.eye(3)
        H[:, ROTATION] = -so3.to_matrix(self.x[3:7]) @ so3.skew(anchor.lever_o)
        expected = self.x[:3] + so3.rotate(self.x[3:7], anchor.lever_o)
        return anchor.z_e - expected, H @ self.covariance @ H.T + anchor.covariance


@dataclass(frozen=True)
class _Intake:
    """What the anchors of one frame led to."""

    innovations: tuple[tuple[np.ndarray, np.ndarray], ...] = ()  # of each anchor; none before the alignment
    chi2: tuple[float, ...] = ()  # of each anchor against all other fixes and the odometry
    iterations: int = 0
    outcome: str = ""


def step(
    settings: params.Gps, p_b_gps: ArrayLike, state: GpsState, frame: OdometryPose, fixes: Sequence[GpsFix]
) -> tuple[GpsState, GpsReport]:
    """The next frame of the odometry with the fixes that arrived since the last one, in any order.

    p_b_gps (3,): where the antenna is on the body, m.  Stamps of frames and fixes are of one clock; a frame's is that
    of its pose (t_image + td).  After the odometry began anew, `state.restart` comes first.
    """
    if state.prior is not None and len(state.prior.gradient) != len(free_components(settings)):
        state = forget(state)  # other parameters now: what is known is not what is asked
    before = dict(zip((a.t_ns for a in state.anchors), state.verdicts))
    state = _advance(settings, state, frame)
    state, admissions = _admit(settings, p_b_gps, state, frame, fixes)
    anchors = tuple(a.anchor for a in admissions if a.anchor is not None)
    intake = _Intake()
    if anchors:
        state, intake = _take_in(settings, state, frame, anchors)
    return state, _report(settings, state, frame, before, admissions, intake)


def _advance(settings: params.Gps, state: GpsState, frame: OdometryPose) -> GpsState:
    """The odometry's way to the frame; frames too old for any fix are forgotten."""
    ahead = state.ahead
    if state.recent:
        last = state.recent[-1]
        if frame.t_ns <= last.t_ns:
            raise ValueError(f"frame at {frame.t_ns} ns comes after one at {last.t_ns} ns")
        moved = frame.T_o_b[:3] - last.T_o_b[:3]
        ahead = compose(ahead, between(settings, moved, (frame.t_ns - last.t_ns) * 1e-9))
    old = [k for k, f in enumerate(state.recent) if frame.t_ns - f.t_ns > settings.max_age_s * 1e9]
    return replace(state, ahead=ahead, recent=(*state.recent[old[-1] if old else 0 :], frame))


def _admit(
    settings: params.Gps, p_b_gps: ArrayLike, state: GpsState, frame: OdometryPose, fixes: Sequence[GpsFix]
) -> tuple[GpsState, list[Admission]]:
    """The fixes up to this frame, judged by themselves; those after it wait for the next."""
    track, origin = Track.of(state.recent), state.origin
    known = {a.t_ns for a in state.anchors}
    admissions, early = [], []
    for fix in sorted((*state.early, *fixes), key=lambda f: f.t_ns):
        if fix.t_ns <= frame.t_ns:
            admission, origin = admit(settings, p_b_gps, origin, track, len(track) - 1, fix, known, frame.t_ns)
            admissions.append(admission)
            if admission.anchor is not None:
                known.add(fix.t_ns)
        elif fix.t_ns - frame.t_ns > settings.max_age_s * 1e9:
            admissions.append(refuse(settings, fix, frame.t_ns))
        else:
            early.append(fix)
    return replace(state, origin=origin, early=tuple(early)), admissions


def _take_in(
    settings: params.Gps, state: GpsState, frame: OdometryPose, anchors: tuple[Anchor, ...]
) -> tuple[GpsState, _Intake]:
    """One more node in the window: predict, compare, solve, judge, and align anew if most fixes disagree."""
    state = window.slide(settings, state)
    node = Node(frame.t_ns, frame.T_o_b[:3], state.ahead if state.nodes else nothing(), anchors)
    innovations: tuple[tuple[np.ndarray, np.ndarray], ...] = ()
    outcome, found = "", None
    if state.prior is not None:
        prediction = _predict(settings, state)
        innovations = tuple(prediction.innovation(a) for a in anchors) if state.aligned else ()
        found = window.extend(settings, state, node, prediction.x)
        if found is None or not _agreement(settings, found.judgement.used).passed:
            outcome, found = "the alignment was lost: most fixes disagree with it", None
    held, nodes = found is not None, (*state.nodes, node)
    found = found or window.begin(settings, nodes)
    state = replace(state, nodes=nodes, ahead=nothing(), aligned=state.aligned and held)
    if found is None:
        state = replace(state, prior=None, x=np.zeros((0, 8)), used=np.zeros(0, bool), covariance=np.zeros((0, 0)))
        return state, _Intake(innovations, outcome=outcome)

    judgement = found.judgement
    covariance = judgement.covariances[-1]
    full = len(nodes) >= settings.window
    aligned = state.aligned or all_pass(_alignment_gates(settings, judgement.used, covariance, full))
    linear = full and yaw_sigma_deg(settings, covariance) <= window.LINEAR_YAW_DEG
    state = replace(
        state,
        prior=found.chain.prior if held or aligned or linear else None,
        x=judgement.solution.x,
        used=judgement.used,
        covariance=covariance,
        aligned=aligned,
    )
    used = [a.t_ns for a, verdict in zip(state.anchors, state.verdicts) if verdict is FixVerdict.USED]
    state = replace(state, last_used_ns=max((state.last_used_ns, *used)))
    chi2 = tuple(judgement.chi2[-len(anchors) :].tolist()) if aligned else ()
    return state, _Intake(innovations, chi2, judgement.solution.iterations, outcome)


def _predict(settings: params.Gps, state: GpsState) -> _Prediction:
    """The newest frame by the newest node and the odometry since."""
    covariance = full_covariance(free_components(settings), state.covariance)
    return _Prediction(predict(state.x[-1], state.ahead), predict_covariance(state.x[-1], state.ahead, covariance))


def _agreement(settings: params.Gps, used: np.ndarray) -> Gate:
    """Asked only of as many fixes as an alignment needs."""
    share = float(np.mean(used)) if len(used) >= settings.min_fixes else 1.0
    return Gate("used_share", share, ">=", settings.min_used_share, "gps.min_used_share")


def _why_not(state: GpsState, gates: tuple[Gate, ...]) -> str:
    if not state.nodes:
        return "no fix passed the gates so far"
    if not len(state.x):
        return "the odometry has not moved far enough for a heading, or the fixes contradict it"
    return f"fixes do not count yet because of {', '.join(g.name for g in gates if not g.passed)}"


def _outage(settings: params.Gps, state: GpsState, frame: OdometryPose) -> Gate:
    since_s = max(0.0, (frame.t_ns - state.last_used_ns) * 1e-9)
    return Gate("outage_s", since_s, "<=", settings.max_outage_s, "gps.max_outage_s", "s", decides=False)


def _alignment_gates(settings: params.Gps, used: np.ndarray, covariance: np.ndarray, full: bool) -> tuple[Gate, ...]:
    """`covariance` of the newest node, empty without a solution.  A full window must do with the heading it has."""
    sigma_deg = yaw_sigma_deg(settings, covariance) if covariance.size else None
    knob = "full_yaw_sigma_deg" if full else "max_yaw_sigma_deg"
    return (
        Gate("fixes", int(used.sum()), ">=", settings.min_fixes, "gps.min_fixes"),
        Gate("yaw_sigma_deg", sigma_deg, "<=", getattr(settings, knob), f"gps.{knob}", "deg"),
        _agreement(settings, used),
    )


def yaw_sigma_deg(settings: params.Gps, covariance: np.ndarray) -> float:
    """Of the heading, in the covariance (t, t) of a node."""
    k = int(np.flatnonzero(free_components(settings) == YAW)[0])
    return float(np.rad2deg(np.sqrt(covariance[k, k])))


def _report(
    settings: params.Gps,
    state: GpsState,
    frame: OdometryPose,
    before: dict[int, FixVerdict],
    admissions: list[Admission],
    intake: _Intake,
) -> GpsReport:
    verdicts = dict(zip((a.t_ns for a in state.anchors), state.verdicts))
    status, outcome = GpsStatus.FUSING, intake.outcome
    gates: tuple[Gate, ...] = (_agreement(settings, state.used), _outage(settings, state, frame))
    if not state.aligned:
        gates = _alignment_gates(settings, state.used, state.covariance, len(state.nodes) >= settings.window)
        status = GpsStatus.ALIGNING if state.nodes else GpsStatus.WAITING
        outcome = outcome or _why_not(state, gates)
    known = _predict(settings, state) if len(state.x) else None
    pose = known if state.aligned else None
    T_e_b = T_e_o = None
    if pose is not None:
        q_e_b = so3.normalize(so3.multiply(pose.x[3:7], frame.T_o_b[3:]))
        T_e_b = np.concatenate([pose.x[:3], q_e_b])
        T_e_o = poses.correction(T_e_b, frame.T_o_b)
    certain = settings.scale_sigma == 0
    return GpsReport(
        status=status,
        fixes=tuple(_fix_reports(settings, admissions, intake, verdicts)),
        revised=tuple(FixRevision(t, v) for t, v in verdicts.items() if t in before and before[t] is not v),
        gates=gates,
        outcome=outcome,
        origin=None if state.origin is None else state.origin.coordinates,
        T_e_o=T_e_o,
        T_e_b=T_e_b,
        covariance=None if pose is None else pose.covariance[:6, :6],
        yaw_deg=None if known is None else float(np.rad2deg(heading.turn(known.x[3:7]))),
        yaw_sigma_deg=None if known is None else float(np.rad2deg(np.sqrt(known.covariance[YAW, YAW]))),
        scale=None if pose is None else float(pose.x[7]),
        scale_sigma=None if pose is None else (0.0 if certain else float(np.sqrt(pose.covariance[SCALE, SCALE]))),
        n_window=len(state.nodes),
        iterations=intake.iterations,
    )


def _fix_reports(
    settings: params.Gps, admissions: list[Admission], intake: _Intake, verdicts: dict[int, FixVerdict]
) -> Iterator[FixReport]:
    k = 0  # anchors so far
    for admission in admissions:
        anchor, gates = admission.anchor, admission.gates
        if anchor is None:
            yield FixReport(admission.t_ns, FixVerdict.GATED, gates, None, None, None, None)
            continue
        innovation, covariance = intake.innovations[k] if intake.innovations else (None, None)
        if intake.chi2:
            gates = (*gates, chi2_gate(settings, intake.chi2[k]))
        k += 1
        verdict = verdicts[anchor.t_ns]
        yield FixReport(anchor.t_ns, verdict, gates, anchor.z_e, anchor.covariance, innovation, covariance)
