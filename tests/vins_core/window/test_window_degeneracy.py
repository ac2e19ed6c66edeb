"""Standing still and turning on the spot are told apart, and from moving."""

from dataclasses import replace

import numpy as np
import pytest

from vins_core.geometry import so3
from vins_core.params import Health
from vins_core.window import degeneracy
from vins_core.window.state import Observations, WindowFrame

POINTS = np.random.default_rng(0).uniform([-2, -2, 3], [2, 2, 6], (40, 3))


def frame(k: int, p: np.ndarray, turn_rad: float) -> WindowFrame:
    q = so3.exp(np.array([0.0, turn_rad, 0.0]))
    rays = so3.rotate(so3.inverse(q), POINTS - p)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    seen = Observations(np.arange(len(rays)), rays, np.zeros((len(rays), 2)), np.zeros((len(rays), 2)))
    zero = np.zeros(3)
    return WindowFrame(k, k * 10**8, True, seen, None, p, q, zero, zero, zero)


def window(step_m: float, step_rad: float) -> tuple[WindowFrame, ...]:
    return tuple(frame(k, np.array([k * step_m, 0.0, 0.0]), k * step_rad) for k in range(11))


@pytest.mark.parametrize(
    ("step_m", "step_rad", "says"),
    [(0.0, 0.0, "standing still"), (0.0, 0.02, "pure rotation"), (0.05, 0.0, ""), (0.05, 0.02, "")],
)
def test_the_missing_motion_is_named(step_m, step_rad, says):
    (gate,), sentence = degeneracy.check(Health(), window(step_m, step_rad), np.eye(3))
    assert gate.passed == (says == "")
    assert sentence.startswith(says) and bool(sentence) == bool(says)
    assert not gate.decides


def test_a_window_that_shares_no_tracks_is_not_called_still():
    frames = (*window(0.0, 0.0)[:-1], frame(10, np.zeros(3), 0.0))
    lonely = Observations(
        frames[-1].observations.ids + 1000,
        *(getattr(frames[-1].observations, n) for n in ("rays", "uv_px", "velocity")),
    )
    (gate,), sentence = degeneracy.check(Health(), (*frames[:-1], replace(frames[-1], observations=lonely)), np.eye(3))
    assert gate.value is None and sentence == ""
