"""The prior as the record holds it: its information, block by block, and what it claims to know but cannot.

    Lambda = J'J,   J, r from marginalisation (SPEC 6.1, seed 000.3.3.4)

Camera and IMU cannot see where the whole window stands (x, y, z) nor its heading.  Moving every pose along such a
direction n at the current estimate must cost nothing: n' Lambda n is the information that leaked into it because parts
of the prior were linearised at different estimates (SPEC 6.2).  Heading turns about the centroid of the poses, so that
it does not mix with position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vins_core.geometry import so3
from vins_core.window.state import BlockKey, Prior, WindowFrame, WindowState

from .widgets.matrix import MatrixBlock

DIRECTIONS = ("x", "y", "z", "yaw")
FREE = 1e-2
"""Information below it, 1/m^2 or 1/rad^2, is none: a standard deviation of 10 m or 10 rad."""


@dataclass(frozen=True)
class PriorView:
    """What marginalisation left behind after a frame."""

    blocks: tuple[MatrixBlock, ...]
    information: np.ndarray  # (n, n)
    eigenvalues: np.ndarray  # (n,) ascending
    rank: int
    leaks: np.ndarray  # (4,) information along DIRECTIONS, 1/m^2 and 1/rad^2


def prior_view(window: WindowState, threshold: float) -> PriorView | None:
    """None while there is no prior; `threshold`: eigenvalues at or below count as zero."""
    prior = window.prior
    if prior is None:
        return None
    eigenvalues = np.sort(np.linalg.svd(prior.J, compute_uv=False) ** 2)
    return PriorView(
        blocks=matrix_blocks(prior, [f.frame for f in window.frames]),
        information=prior.J.T @ prior.J,
        eigenvalues=eigenvalues,
        rank=int((eigenvalues > threshold).sum()),
        leaks=leaked(prior, window),
    )


def matrix_blocks(prior: Prior, frames: list[int]) -> tuple[MatrixBlock, ...]:
    """Every block with its columns; slots are those of the window after sliding."""
    blocks, start = [], 0
    for key in prior.blocks:
        blocks.append(MatrixBlock(*_names(key, frames), start, key.size, -1 if key.kind == "extrinsic" else key.id))
        start += key.size
    return tuple(blocks)


def _names(key: BlockKey, frames: list[int]) -> tuple[str, str]:
    """(in words, on the edge of the matrix)."""
    if key.kind == "extrinsic":
        return f"extrinsic of camera {key.id}", "ex"
    slot = frames.index(key.id) if key.id in frames else "?"
    if key.kind == "pose":
        return f"pose {slot} (frame {key.id})", f"x{slot}"
    return f"velocity and biases {slot} (frame {key.id})", f"vb{slot}"


def leaked(prior: Prior, window: WindowState) -> np.ndarray:
    """(4,) information along x, y, z and yaw at the current estimate."""
    return (np.square(prior.J @ gauge_directions(prior, window))).sum(0)


def gauge_directions(prior: Prior, window: WindowState) -> np.ndarray:
    """(n, 4) tangents of moving the whole window by 1 m along x, y, z and turning it by 1 rad about gravity."""
    by_frame = {f.frame: f for f in window.frames}
    poses = [by_frame[b.id].p_w_b for b in prior.blocks if b.kind == "pose" and b.id in by_frame]
    centre = np.mean(poses, axis=0) if poses else np.zeros(3)
    rows = [_tangent(b, by_frame.get(b.id), centre) for b in prior.blocks]
    return np.concatenate(rows) if rows else np.zeros((0, 4))


def _tangent(block: BlockKey, frame: WindowFrame | None, centre: np.ndarray) -> np.ndarray:
    tangent = np.zeros((block.size, 4))
    if frame is None or block.kind == "extrinsic":
        return tangent
    up = np.array([0.0, 0.0, 1.0])
    if block.kind == "pose":
        tangent[:3, :3] = np.eye(3)
        tangent[:3, 3] = np.cross(up, frame.p_w_b - centre)
        tangent[3:, 3] = so3.rotate(so3.inverse(frame.q_w_b), up)
    else:
        tangent[:3, 3] = np.cross(up, frame.v_w_b)
    return tangent
