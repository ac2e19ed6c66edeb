"""The prior and the marginalisation that made it, as the page draws them: matrices with named blocks.

Camera and IMU cannot see where the whole window stands (x, y, z) nor its heading.  Moving every pose along such a
direction n must cost nothing: n' Lambda n is the information that leaked into it because parts of the prior were
linearised at different estimates (SPEC 6.2, vins_core/solver/spectrum.py).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vins_core import examine
from vins_core.record.reader import RunReader
from vins_core.report import BlockReport

from .context import RunView
from .widgets.matrix import MatrixBlock

FREE = 1e-2
"""Information below it, 1/m^2 or 1/rad^2, is none: a standard deviation of 10 m or 10 rad."""


@dataclass(frozen=True)
class PriorView:
    """What marginalisation left behind after a frame."""

    blocks: tuple[MatrixBlock, ...]
    information: np.ndarray  # (n, n)
    eigenvalues: np.ndarray  # (n,) ascending
    rank: int
    leaks: np.ndarray  # (4,) information along spectrum.GAUGE where the prior was linearised, 1/m^2 and 1/rad^2
    cost: float  # at the current states
    held_cost: float  # the part of it that no solve can lower
    held: tuple[str, ...]  # what of the calibration is held besides position and yaw


def prior_view(run: RunReader, frame: int) -> PriorView | None:
    """None while there is no prior."""
    seen = examine.prior(run, frame)
    if seen is None:
        return None
    return PriorView(
        matrix_blocks(seen.blocks),
        seen.information,
        seen.spectrum.eigenvalues,
        seen.spectrum.rank,
        seen.first.information,
        seen.cost,
        seen.held_cost,
        seen.held,
    )


@dataclass(frozen=True)
class DepartureView:
    """The information that marginalisation started from, in its own order: dropped, then kept."""

    kind: str
    blocks: tuple[MatrixBlock, ...]  # all inverse depths are one
    information: np.ndarray  # (m + n, m + n)
    m: int
    kept: tuple[MatrixBlock, ...]  # columns counted from the first kept one
    fill_in: np.ndarray  # (n, n) what is left, only where kept blocks knew nothing of each other before; else 0

    @property
    def share(self) -> float:
        """Of the entries among what is kept, how many are new."""
        return float((self.fill_in != 0).mean()) if self.fill_in.size else 0.0


def departure_view(run: RunView, frame: int) -> DepartureView | None:
    """What left after a frame, worked out from the record once more; None when nothing did."""
    seen = examine.marginalization(run.reader, frame)
    if seen is None:
        return None
    blocks = matrix_blocks(seen.blocks)
    kept = tuple(replace(b, start=b.start - seen.m) for b in blocks if not b.dropped)
    return DepartureView(seen.kind, blocks, seen.before, seen.m, kept, np.where(seen.fill_in, seen.after, 0.0))


_NAME = re.compile(r"(pose|speed_bias) (\d+|\?) \(frame (\d+)\)")


def matrix_blocks(blocks: Sequence[BlockReport]) -> tuple[MatrixBlock, ...]:
    """Every block with its columns; all inverse depths together."""
    depths = [b for b in blocks if b.name.startswith("inv_depth")]
    found = []
    for block in blocks:
        if block in depths[1:]:
            continue
        if depths and block is depths[0]:
            size = sum(b.size for b in depths)
            found.append(MatrixBlock(f"{len(depths)} inverse depths", "depths", block.index, size, dropped=True))
            continue
        match = _NAME.fullmatch(block.name)
        short, frame = block.name.replace("extrinsic cam", "ex")[:4], -1
        if match:
            kind, slot, number = match.groups()
            short, frame = f"{'x' if kind == 'pose' else 'vb'}{slot}", int(number)
        found.append(MatrixBlock(block.name.replace("_", "-"), short, block.index, block.size, frame, block.dropped))
    return tuple(found)
