"""The final trajectory: all frames and all fixes in one problem, once, off the frame path.

The same chain as the window's (chain.py) with every frame a node, so a frame inside an outage is placed by the fixes on
both sides, with its covariance.  Time and memory grow with the number of frames and with nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .. import params
from ..factors.robust import Loss
from ..geometry import so3
from ..report import FixReport, FixVerdict
from ..sensors import GpsFix
from .align import Alignment, align
from .chain import Chain, Fixes, Linearizer, first_prior, free_components, full_covariance
from .drift import SCALE, between
from .gate import admit, chi2_gate
from .geodesy import EnuFrame
from .judge import judge
from .state import Anchor, Track
from .window import lay_out

NEIGHBOURHOOD = 25
"""Fixes on either side among which only the worst is taken out in one round."""


@dataclass(frozen=True)
class Smoothed:
    """The final trajectory in `e`, east-north-up at `origin`."""

    origin: EnuFrame
    t_ns: np.ndarray  # (n,) int64
    T_e_b: np.ndarray  # (n, 7)
    covariance: np.ndarray  # (n, 6, 6) of p_e_b in m and of R_e_o, turned on the side of o, in rad
    q_e_o: np.ndarray  # (n, 4) how the odometry's world is turned
    scale: np.ndarray  # (n,) by how much the odometry is too short, as a share
    scale_sigma: np.ndarray  # (n,)
    fixes: tuple[FixReport, ...]  # in order of time
    iterations: int


@dataclass(frozen=True)
class Posed:
    """The problem of a whole run, from where it starts."""

    chain: Chain
    x: np.ndarray  # (n, 8)
    used: np.ndarray  # (m,) bool


def smooth(
    settings: params.Gps,
    p_b_gps: ArrayLike,
    t_ns: np.ndarray,
    T_o_b: np.ndarray,
    fixes: Sequence[GpsFix],
    origin: EnuFrame | None = None,
) -> Smoothed | str:
    """Frames (n,) with their odometry poses (n, 7) and all fixes; instead of a trajectory, why there is none.

    p_b_gps (3,): where the antenna is on the body, m.  origin: by default the first fix that passes the gates.
    """
    track, fixes = Track(t_ns, T_o_b), sorted(fixes, key=lambda f: f.t_ns)
    admissions, nodes = [], []
    known: set[int] = set()
    for fix in fixes:
        node = min(int(np.searchsorted(t_ns, fix.t_ns)), len(t_ns) - 1)
        admission, origin = admit(settings, p_b_gps, origin, track, node, fix, known)
        admissions.append(admission)
        if admission.anchor is not None:
            known.add(fix.t_ns)
            nodes.append(node)
    anchors = [a.anchor for a in admissions if a.anchor is not None]
    if origin is None or not anchors:
        return "no fix passed the gates"
    posed = pose(settings, track, anchors, np.array(nodes))
    if isinstance(posed, str):
        return posed
    try:
        result = judge(settings, Linearizer(posed.chain), posed.x, posed.used, NEIGHBOURHOOD)
    except np.linalg.LinAlgError:
        return "the fixes do not hold the trajectory"

    x, covariance = result.solution.x, full_covariance(posed.chain.free, result.covariances)
    reports, judged = [], iter(zip(result.used.tolist(), result.chi2.tolist()))
    for admission in admissions:
        anchor, gates, verdict = admission.anchor, admission.gates, FixVerdict.GATED
        if anchor is not None:
            is_used, chi2 = next(judged)
            gates, verdict = (*gates, chi2_gate(settings, chi2)), FixVerdict.USED if is_used else FixVerdict.GATED
        z_e, R = (None, None) if anchor is None else (anchor.z_e, anchor.covariance)
        reports.append(FixReport(admission.t_ns, verdict, gates, z_e, R, None, None))
    q_e_b = so3.normalize(so3.multiply(x[:, 3:7], T_o_b[:, 3:]))
    return Smoothed(
        origin=origin,
        t_ns=t_ns,
        T_e_b=np.concatenate([x[:, :3], q_e_b], 1),
        covariance=covariance[:, :6, :6],
        q_e_o=x[:, 3:7],
        scale=x[:, 7],
        scale_sigma=np.sqrt(covariance[:, SCALE, SCALE]),
        fixes=tuple(reports),
        iterations=result.solution.iterations,
    )


def pose(settings: params.Gps, track: Track, anchors: list[Anchor], nodes: np.ndarray) -> Posed | str:
    """The problem of all frames and the anchors at frames `nodes` (m,), laid out by the first that align."""
    p_o_b = track.T_o_b[:, :3]
    fixes = Fixes(
        nodes,
        np.array([a.lever_o for a in anchors]).reshape(-1, 3),
        np.array([a.z_e for a in anchors]).reshape(-1, 3),
        np.array([a.covariance for a in anchors]).reshape(-1, 3, 3),
    )
    found = _first_alignment(settings, p_o_b[nodes] + fixes.lever_o, fixes)
    if found is None:
        return "no heading: the odometry has not moved far enough, or the fixes contradict it"
    x = lay_out(p_o_b, found.yaw_rad, found.shift_e, fixes)
    chain = Chain(
        free_components(settings),
        between(settings, np.diff(p_o_b, axis=0), np.diff(track.t_ns) * 1e-9),
        fixes,
        first_prior(settings, x[0]),
        Loss(settings.loss, settings.loss_scale),
    )
    return Posed(chain, x, np.ones(len(fixes), bool))


def _first_alignment(settings: params.Gps, antenna_o: np.ndarray, fixes: Fixes) -> Alignment | None:
    """Of the first fixes, twice as many each time, thinned to a window's worth."""
    count, last = settings.min_fixes, None
    while count < 2 * len(fixes):
        rows = np.unique(np.linspace(0, min(count, len(fixes)) - 1, settings.window).round().astype(np.int64))
        found = align(antenna_o[rows], fixes.z_e[rows], fixes.covariance[rows])
        last = found or last
        if found and np.rad2deg(found.sigma_rad) <= settings.max_yaw_sigma_deg:
            return found
        count *= 2
    return last
