"""What a fix must pass before it may count, each as a gate with value, limit and parameter (SPEC 8.2).

The checks of a fix by itself come first; the chi-square against prediction or neighbours (judge.py) needs an alignment.
VINS-Fusion has none of them (REFERENCE H6) and pairs a fix with a frame within 10 ms, else drops it (H2).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .. import params
from ..geometry import so3
from ..report import Gate, all_pass
from ..sensors import GpsFix
from .geodesy import EnuFrame
from .state import Anchor, Track


@dataclass(frozen=True)
class Admission:
    t_ns: int
    gates: tuple[Gate, ...]
    anchor: Anchor | None  # None when a gate has failed


def admit(
    settings: params.Gps,
    p_b_gps: ArrayLike,
    origin: EnuFrame | None,
    track: Track,
    node: int,
    fix: GpsFix,
    known: Collection[int] = (),
    now_ns: int | None = None,
) -> tuple[Admission, EnuFrame | None]:
    """A fix as an anchor of frame `node` of the track; the first one that passes is the origin.

    p_b_gps (3,): the antenna on the body, m.  known: stamps of fixes that were admitted before.  now_ns: stamp of the
    newest frame, if lateness matters.
    """
    covariance, sigmas = weight(settings, fix)
    gap_s = track.gap_s(fix.t_ns)
    gates = (
        Gate("status", fix.status, ">=", settings.min_status, "gps.min_status"),
        Gate("position_known", float(_is_position(fix)), ">=", 1.0),
        Gate("stamp_is_new", float(fix.t_ns not in known), ">=", 1.0),
        Gate("smallest_sigma_m", sigmas[0] if sigmas else None, ">=", settings.min_sigma_m, "gps.min_sigma_m", "m"),
        Gate("horizontal_sigma_m", sigmas[1] if sigmas else None, "<=", settings.max_sigma_m, "gps.max_sigma_m", "m"),
        *(() if now_ns is None else (_age(settings, fix, now_ns),)),
        Gate("frame_gap_s", gap_s, "<=", settings.max_gap_s, "gps.max_gap_s", "s"),
    )
    if not all_pass(gates):
        return Admission(fix.t_ns, gates, None), origin
    origin = origin or EnuFrame.at(fix)
    T_o_b = track.at(fix.t_ns)
    arm_b = np.asarray(p_b_gps, float) if settings.lever_arm else np.zeros(3)
    lever_o = T_o_b[:3] + so3.rotate(T_o_b[3:], arm_b) - track.T_o_b[node, :3]
    return Admission(fix.t_ns, gates, Anchor(fix.t_ns, lever_o, origin.position(fix), covariance)), origin


def refuse(settings: params.Gps, fix: GpsFix, now_ns: int) -> Admission:
    """A fix so far ahead of the frames that its clock must be another one."""
    return Admission(fix.t_ns, (_age(settings, fix, now_ns),), None)


def weight(settings: params.Gps, fix: GpsFix) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Covariance (3, 3) by which a fix is weighted; its smallest and its largest horizontal standard deviation.

    None instead of these when the fix has no covariance and none is assumed.
    """
    C = np.asarray(fix.covariance_enu_m2, float)
    if settings.covariance == "sigma":
        C = np.eye(3) * C[0, 0] ** 2 if C[0, 0] > 0 else np.zeros((3, 3))
    C = 0.5 * (C + C.T) * settings.sigma_scale**2
    known = bool(np.isfinite(C).all()) and np.linalg.eigvalsh(C)[0] > 0
    if not known:
        if not settings.assumed_sigma_m:
            return C, None
        C = np.eye(3) * (settings.assumed_sigma_m * settings.sigma_scale) ** 2
    return C, (float(np.sqrt(np.linalg.eigvalsh(C)[0])), float(np.sqrt(np.linalg.eigvalsh(C[:2, :2])[1])))


def chi2_gate(settings: params.Gps, chi2: float | None) -> Gate:
    return Gate("chi2", chi2, "<=", settings.max_chi2, "gps.max_chi2")


def _age(settings: params.Gps, fix: GpsFix, now_ns: int) -> Gate:
    return Gate("stamp_off_s", abs(now_ns - fix.t_ns) * 1e-9, "<=", settings.max_age_s, "gps.max_age_s", "s")


def _is_position(fix: GpsFix) -> bool:
    values = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
    return bool(np.isfinite(values).all()) and abs(fix.latitude_deg) <= 90.0
