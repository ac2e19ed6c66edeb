"""Looking into the back end at any frame of a run: each question restores the frame and answers for it alone.

    the window's turn   solved_window      the estimator just before anything left the window
    is it the optimum?  optimum            the same window through IPOPT
    the prior           prior, marginalization
    uncertainty         uncertainty        3-sigma ellipsoids of poses and landmarks

With the parameters of the run the answers are about what happened; with others, about what would have happened.
Raises RunError when the frame cannot be restored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrival import Arrival, receive
from .params import Params
from .record.fork import state_before
from .record.reader import RunReader
from .solver.covariance import Covariances, covariances
from .solver.ipopt import Comparison, compare_optimum
from .solver.problem import hold_oldest
from .solver.trust_region import rules
from .whatif import recorded_tracks
from .window.prior_analysis import MarginalizationAnalysis, PriorAnalysis, analyse_marginalization, analyse_prior
from .window.step import Solved, solve_window


@dataclass(frozen=True)
class Turn:
    """A frame of a run in the middle of its window's turn."""

    arrival: Arrival
    solved: Solved


def solved_window(run: RunReader, k: int, params: Params | None = None) -> Turn | None:
    """Frame k after its solve, before anything left; None while there is no window to solve."""
    params = params or run.header.params_at(k)
    calibration = run.header.calibration
    state = state_before(run, k)
    arrival = receive(params, calibration, state, run.packet(k), recorded_tracks(run, k, params), {})
    if not arrival.ready:
        return None
    requests = state.closure.requests if state.closure and params.loop.enabled else ()
    return Turn(arrival, solve_window(params, arrival.calibration, arrival.state.window, {}, requests))


def optimum(run: RunReader, k: int, params: Params | None = None) -> Comparison | None:
    """Is frame k at its optimum?  About 0.3 s."""
    params = params or run.header.params_at(k)
    turn = solved_window(run, k, params)
    if turn is None:
        return None
    return compare_optimum(turn.solved.assembly.problem, turn.solved.solution, rules(params.solver).holds_gauge)


def marginalization(run: RunReader, k: int, params: Params | None = None) -> MarginalizationAnalysis | None:
    """H before and after what left the window in frame k; None when nothing did."""
    params = params or run.header.params_at(k)
    turn = solved_window(run, k, params)
    if turn is None:
        return None
    gravity = turn.arrival.calibration.gravity_m_s2
    return analyse_marginalization(params, turn.solved.judged, gravity, turn.arrival.keyframe.is_keyframe)


def prior(run: RunReader, k: int) -> PriorAnalysis | None:
    """The prior after frame k; None while there is none."""
    window = run.state(k).window
    if window.prior is None:
        return None
    return analyse_prior(window.prior, window, run.header.params_at(k).marginalization.eigen_threshold)


@dataclass(frozen=True)
class Uncertainty:
    """Marginal covariances of a solved window, relative to position and yaw of its oldest frame."""

    frames: np.ndarray  # (n,) frame of each pose
    ids: np.ndarray  # (M,) track of each landmark
    covariances: Covariances


def uncertainty(run: RunReader, k: int, params: Params | None = None) -> Uncertainty | None:
    """How well frame k knows its poses and landmarks; None without a solved window, or when it is singular."""
    turn = solved_window(run, k, params)
    if turn is None:
        return None
    assembly = turn.solved.assembly
    states = hold_oldest(turn.solved.solution.states, assembly.problem.initial.poses[0], not assembly.problem.inertial)
    known = covariances(assembly.problem, states)
    frames = np.array([f.frame for f in turn.solved.window.frames])
    return None if known is None else Uncertainty(frames, assembly.ids, known)


def yaw_leakage(run: RunReader) -> np.ndarray:
    """(frames,) what each frame's new prior claims to know of yaw, 1/rad^2; NaN where none was made."""
    return np.array([np.nan if s.yaw_information is None else s.yaw_information for s in run.summaries])
