"""Which keyframes other settings would have left out, when the run left out none (REFERENCE L3, L4)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry import poses
from ..loop import gates
from ..loop.consistency import Motion, tangent_covariance
from ..loop.keyframe import LoopKeyframe
from ..loop.step import Moved
from ..params import Loop
from ..report import Gate, all_pass

SETTINGS = frozenset({"skip_first", "every", "min_spacing_m"})
"""Parameters of `loop` that decide which keyframes are used."""


@dataclass(frozen=True)
class Offered:
    """A keyframe as it is offered to the loop stage."""

    T_w_b: np.ndarray  # (7,)
    motion: np.ndarray | None  # (6, 6) covariance of the motion since the one before; None: not known


@dataclass(frozen=True)
class Admission:
    gates: tuple[Gate, ...]
    odometry: np.ndarray | None  # (6, 6) covariance of the motion since the last keyframe used

    @property
    def used(self) -> bool:
        return all_pass(self.gates)


def admissions(
    settings: Iterable[Loop], offered: Iterable[Offered], earlier: Sequence[LoopKeyframe] = ()
) -> Iterator[Admission]:
    """What becomes of keyframes offered one after the other, as `loop.step.admit` decides it.

    `earlier`: the keyframes of the map that the run began with.
    """
    last = earlier[-1].T_w_b if earlier else None
    seen, since, moved = 0, len(earlier), None
    for params, keyframe in zip(settings, offered):
        judged: tuple[Gate, ...] = (gates.start(params, seen),)
        if last is not None:
            moved_m = float(np.linalg.norm(keyframe.T_w_b[:3] - last[:3]))
            judged += (gates.every(params, since), gates.spacing(params, moved_m))
        here = Moved(keyframe.T_w_b, None)
        moved = moved.on(keyframe.T_w_b, keyframe.motion) if moved else here
        admission = Admission(judged, tangent_covariance(moved.motion) if moved.motion else None)
        yield admission
        seen, since = seen + 1, since + 1
        if admission.used:
            last, since = keyframe.T_w_b, 1
            moved = Moved(keyframe.T_w_b, Motion(poses.IDENTITY, np.zeros((6, 6))))
