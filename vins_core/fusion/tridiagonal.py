"""A chain's normal equations: a symmetric block-tridiagonal matrix, eliminated from one end to the other.

    D_0 = H_00,    G_k = D_k^-1 H_k,k+1,    D_k+1 = H_k+1,k+1 - H_k,k+1' G_k

The elimination is the Kalman filter in information form, the way back the Rauch-Tung-Striebel smoother; the blocks of
the inverse on the diagonal are the covariances of the nodes:

    S_n = D_n^-1,    S_k = D_k^-1 + G_k S_k+1 G_k'
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack


class BlockTridiagonal:
    """H with n blocks (n, t, t) on and n - 1 blocks (k, k + 1) above the diagonal.

    LinAlgError when H is not positive definite.
    """

    def __init__(self, diagonal: np.ndarray, above: np.ndarray):
        n, t = diagonal.shape[:2]
        wanted = np.zeros((n, t, 2 * t))  # what D_k^-1 is multiplied with: the identity and H_k,k+1
        wanted[:, :, :t] = np.eye(t)
        wanted[:-1, :, t:] = above
        solved = np.empty_like(wanted)
        D = diagonal[0]
        for k in range(n):
            _, solved[k], failed = lapack.dposv(D, wanted[k])
            if failed:
                raise np.linalg.LinAlgError(f"block {k} is not positive definite")
            if k < n - 1:
                D = diagonal[k + 1] - above[k].T @ solved[k, :, t:]
        self._inverse, self._G = solved[:, :, :t], solved[:-1, :, t:]

    def solve(self, b: np.ndarray) -> np.ndarray:
        """x with H x = b, (n, t)."""
        x = b.copy()
        for k, G in enumerate(self._G):
            x[k + 1] -= x[k] @ G
        x = np.einsum("kab,kb->ka", self._inverse, x)
        for k in range(len(x) - 2, -1, -1):
            x[k] -= self._G[k] @ x[k + 1]
        return x

    def covariances(self) -> np.ndarray:
        """Diagonal blocks of the inverse, (n, t, t), symmetric."""
        S = self._inverse.copy()
        for k in range(len(S) - 2, -1, -1):
            S[k] += self._G[k] @ S[k + 1] @ self._G[k].T
        return 0.5 * (S + np.swapaxes(S, 1, 2))
