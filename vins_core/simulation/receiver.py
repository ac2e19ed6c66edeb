"""What a GPS receiver makes of the way of its antenna: noise, gross outliers, an outage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..fusion.geodesy import EnuFrame
from ..sensors import GpsFix

START = EnuFrame(48.137, 11.575, 519.0)


@dataclass(frozen=True)
class Receiver:
    rate_hz: float = 5.0
    first_s: float = 0.03  # stamp of the first fix: none falls on a frame
    sigma_m: tuple[float, float, float] = (1.0, 1.0, 1.0)
    p_b_gps: tuple[float, float, float] = (0.6, 0.0, 0.8)  # 1 m from the body
    outlier_share: float = 0.05
    outlier_m: float = 10.0  # the smallest; beyond it exponential with the same mean
    outage_s: tuple[float, float] = (45.0, 75.0)


def measure(
    receiver: Receiver,
    t_s: np.ndarray,
    antenna_e: np.ndarray,
    start: EnuFrame,
    noise: np.random.Generator,
    gross: np.random.Generator,
) -> tuple[tuple[GpsFix, ...], np.ndarray]:
    """Fixes of the antenna at (m, 3) in the ENU frame `start` at times (m,), but for the outage; which are outliers.

    noise, gross: what noise and outliers are drawn from; two of them, and fewer fixes are the first of more.
    """
    error, draws = noise.normal(size=(len(t_s), 3)) * receiver.sigma_m, gross.random((len(t_s), 3))
    outlier = draws[:, 0] < receiver.outlier_share
    far = receiver.outlier_m * (1.0 - np.log1p(-draws[:, 1]))
    angle = 2 * np.pi * draws[:, 2]
    off = np.where(outlier, far, 0.0)[:, None] * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    measured = np.stack(start.to_geodetic(antenna_e + error + off), 1)
    heard = ~((t_s >= receiver.outage_s[0]) & (t_s <= receiver.outage_s[1]))
    covariance = np.diag(np.square(receiver.sigma_m))
    fixes = tuple(
        GpsFix(round(t * 1e9), lat, lon, alt, covariance, 0)
        for t, (lat, lon, alt) in zip(t_s[heard].tolist(), measured[heard].tolist())
    )
    return fixes, outlier[heard]
