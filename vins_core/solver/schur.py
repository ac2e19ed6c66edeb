"""The arrow system solved by eliminating the inverse depths, whose block is diagonal (Schur complement).

S = H - W' h^-1 W,      S dc = -(g - W' h^-1 g_l),      dl = -(g_l + W dc) / h
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from .linearize import NormalEquations


def solve_damped(
    system: NormalEquations, damping_c: np.ndarray, damping_l: np.ndarray, damping_oldest: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray] | None:
    """(dc, dl) of the system with damping added to its diagonals; None when it is not positive definite.

    `damping_oldest` (6, 6) is added to the block of the oldest pose.
    """
    h = system.h + damping_l
    S, b = eliminate(system, h)
    S.reshape(-1)[:: len(S) + 1] += damping_c
    if damping_oldest is not None:
        S[:6, :6] += damping_oldest
    factor, info = lapack.dpotrf(S.T, lower=1, clean=0, overwrite_a=1)
    if info:
        return None
    dc, _ = lapack.dpotrs(factor, -b, lower=1)
    return dc, -(system.g_l + system.W @ dc[: system.W.shape[1]]) / h


def eliminate(system: NormalEquations, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S, b): what the cameras know once the landmarks with information `h` are gone, S dc = -b.

    Landmarks without information (h = 0) are left out.
    """
    P = system.W.shape[1]
    inverse = np.divide(1.0, h, out=np.zeros_like(h), where=h > 0)
    V = system.W * np.sqrt(inverse)[:, None]
    S, b = system.H.copy(), system.g.copy()
    S[:P, :P] -= V.T @ V
    b[:P] -= (inverse * system.g_l) @ system.W
    return S, b
