"""The state of GPS fusion: a window of moments with fixes, what is known of the first, and the newest frame.

It is bounded, whatever the length of the run.  Only moments with fixes are nodes; the odometry between them is one
increment, and `ahead` is that from the newest node to the newest frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..geometry import poses, so3
from ..report import FixVerdict
from ..sensors import GpsFix
from .chain import Prior
from .drift import Increment, nothing
from .geodesy import EnuFrame


@dataclass(frozen=True)
class OdometryPose:
    """A frame as the odometry has it."""

    t_ns: int
    T_o_b: np.ndarray  # (7,) p and q wxyz


@dataclass(frozen=True)
class Anchor:
    """A fix that may count, in frame `e`."""

    t_ns: int
    lever_o: np.ndarray  # (3,) from the body at the node to the antenna at t_ns, in the axes of `o`
    z_e: np.ndarray  # (3,)
    covariance: np.ndarray  # (3, 3)


@dataclass(frozen=True)
class Node:
    """A frame with fixes."""

    t_ns: int
    p_o_b: np.ndarray  # (3,)
    increment: Increment  # from the node before
    anchors: tuple[Anchor, ...]


@dataclass(frozen=True)
class GpsState:
    """`x`, `used` and `covariance` are those of the last solve; with a prior the next one starts from there."""

    origin: EnuFrame | None = None
    recent: tuple[OdometryPose, ...] = ()  # frames between which a late fix may lie, the newest last
    early: tuple[GpsFix, ...] = ()  # fixes newer than the newest frame
    nodes: tuple[Node, ...] = ()
    prior: Prior | None = None  # on the first node; None: nothing is known of how the worlds lie
    x: np.ndarray = field(default_factory=lambda: np.zeros((0, 8)))  # (n, 8)
    used: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))  # (m,) of the nodes' anchors, in order
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))  # (t, t) of the newest node
    aligned: bool = False  # fixes count
    ahead: Increment = field(default_factory=nothing)
    last_used_ns: int = -1  # stamp of the newest fix that counts

    @property
    def anchors(self) -> tuple[Anchor, ...]:
        return tuple(a for n in self.nodes for a in n.anchors)

    @property
    def verdicts(self) -> tuple[FixVerdict, ...]:
        """Of the anchors, in order."""
        if not self.aligned:
            return (FixVerdict.OPEN,) * len(self.anchors)
        return tuple(FixVerdict.USED if u else FixVerdict.GATED for u in self.used)


def restart(state: GpsState) -> GpsState:
    """After the odometry began anew: the earth stays where it is, all else is unknown."""
    return GpsState(origin=state.origin)


def forget(state: GpsState) -> GpsState:
    """As if fixes came only from now on: the odometry goes on, and is aligned anew."""
    return GpsState(origin=state.origin, recent=state.recent, early=state.early)


@dataclass(frozen=True)
class Track:
    """Consecutive frames of one odometry."""

    t_ns: np.ndarray  # (n,) int64, increasing
    T_o_b: np.ndarray  # (n, 7)

    @staticmethod
    def of(frames: tuple[OdometryPose, ...]) -> Track:
        return Track(np.array([f.t_ns for f in frames], np.int64), np.array([f.T_o_b for f in frames]).reshape(-1, 7))

    def __len__(self) -> int:
        return len(self.t_ns)

    def gap_s(self, t_ns: int) -> float | None:
        """Time between the frames around t; None outside of the track."""
        k = self._later(t_ns)
        return None if k is None else float(self.t_ns[k] - self.t_ns[max(k - 1, 0)]) * 1e-9

    def at(self, t_ns: int) -> np.ndarray:
        """T_o_b (7,) at a time between two frames: on the straight line, turning evenly."""
        k = self._later(t_ns)
        if k is None:
            raise ValueError(f"stamp {t_ns} is not on the track")
        if self.t_ns[k] == t_ns:
            return self.T_o_b[k]
        a, b = self.T_o_b[k - 1], self.T_o_b[k]
        share = (t_ns - self.t_ns[k - 1]) / (self.t_ns[k] - self.t_ns[k - 1])
        turned = poses.between(a, b)
        return np.concatenate([a[:3] + share * (b[:3] - a[:3]), so3.retract(a[3:], share * so3.log(turned[3:]))])

    def _later(self, t_ns: int) -> int | None:
        """The first frame at t or after it, unless t lies outside."""
        if not len(self) or not self.t_ns[0] <= t_ns <= self.t_ns[-1]:
            return None
        return int(np.searchsorted(self.t_ns, t_ns))
