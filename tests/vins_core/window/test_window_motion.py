"""How sure the window is of the motion between its last two keyframes."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_window as sw

from vins_core import params as settings
from vins_core.geometry import poses, so3
from vins_core.params import Params
from vins_core.report import KeyframeReport
from vins_core.sensors import Calibration
from vins_core.solver.covariance import relative_poses
from vins_core.window.step import estimate, solve_window

PARAMS = settings.replace(Params(), {"window.max_iterations": 30})
CALIBRATION = Calibration((), sw.NOISE, sw.GRAVITY)
KEYFRAME = KeyframeReport(True, "", 20.0, 20.0, 100, 50, 10, ())


def motion(params, flight, keyframe=KEYFRAME):
    return estimate(params, CALIBRATION, flight.window, keyframe, None, {}).window_report.motion


def test_the_motion_claims_half_of_its_error_because_the_rays_of_anchors_count_as_exact():
    """Six degrees of freedom, noise as the model has it: this is the factor of 2 in `loop.drift_inflation`."""
    squared = []
    for seed in range(12):
        flight = sw.make(seed, pixel_sigma=PARAMS.window.pixel_sigma)
        turn = solve_window(PARAMS, CALIBRATION, flight.window, {})
        C = motion(PARAMS, flight)
        T, true = (poses.between(*(np.concatenate([f.p_w_b, f.q_w_b]) for f in w.frames[-3:-1]))
                   for w in (turn.solved, flight.truth))  # fmt: skip
        e = np.concatenate([T[:3] - true[:3], so3.difference(T[3:], true[3:])])
        squared.append(e @ np.linalg.solve(C, e))
    assert 1.5 < np.sqrt(np.mean(squared) / 6) < 3.0


def test_what_the_solver_leaves_says_the_same_as_linearising_anew():
    flight = sw.make(3)
    plain = settings.replace(PARAMS, {"solver.curved_below": 0.0})  # else H has the curvature of the robust loss
    turn = solve_window(plain, CALIBRATION, flight.window, {})
    (anew,) = relative_poses(turn.assembly.problem, turn.solution.states, [(8, 9)])
    np.testing.assert_allclose(motion(plain, flight), anew, rtol=1e-9)


@pytest.mark.parametrize(("enabled", "is_keyframe"), [(False, True), (True, False)])
def test_it_is_worked_out_only_where_a_loop_may_need_it(enabled, is_keyframe):
    params = settings.replace(PARAMS, {"loop.enabled": enabled})
    assert motion(params, sw.make(1), replace(KEYFRAME, is_keyframe=is_keyframe)) is None
