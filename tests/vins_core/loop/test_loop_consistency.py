"""What odometry allows: covariances along the graph of keyframes, and the loops that fit them."""

from dataclasses import replace

import numpy as np
import pytest

from vins_core.geometry import poses, so3
from vins_core.loop import consistency
from vins_core.loop.consistency import Motion, from_tangent, relation, tangent_covariance
from vins_core.loop.step import decide
from vins_core.params import Loop
from vins_core.report import LoopCandidate, LoopOutcome, LoopReport

PARAMS = Loop(drift_inflation=1.0, max_drift=6.0, sure_drift=4.0, min_agreement=2, agreement_span=5)
STEP = np.diag([0.02**2] * 3 + [0.002**2] * 3)  # covariance of each motion
LOOP = np.diag([0.01**2] * 3 + [0.002**2] * 3)
LAP = 40


def circle(n, start=0):
    """Poses of a body on a circle of 3 m, `LAP` to a lap, looking ahead."""
    angle = 2 * np.pi * np.arange(start, start + n) / LAP
    q = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], -1)
    return np.column_stack([3 * np.cos(angle), 3 * np.sin(angle), 0 * angle, q])


class Story:
    """Keyframes one after the other, each with at most one candidate, and what became of them."""

    def __init__(self, T_w_b, params=PARAMS, breaks=(0,), true=None):
        self.T, self.params, self.breaks = T_w_b, params, breaks
        self.true = T_w_b if true is None else true
        self.nodes, self.candidates = [], []

    def node(self, k):
        return self.nodes[k]

    def advance(self, match=None, T_match_query=None):
        k = len(self.nodes)
        joined = k not in self.breaks
        before = self.T[k - 1] if k else None
        arrived = consistency.arrive(self.node, k, self.T[k], before, STEP if joined else None)
        found = []
        if match is not None:
            T = poses.between(self.true[match], self.true[k]) if T_match_query is None else T_match_query
            bare = LoopCandidate(k, match, 0.5, (), LoopOutcome.ACCEPTED, None, T, LOOP)
            found = [consistency.judge(self.params, arrived, bare)]
        report = decide(LoopReport(k, k, k, 0, 0, None, (), (), LoopOutcome.TOO_RECENT), found)
        self.nodes.append(consistency.settle(arrived, report))
        self.candidates += report.candidates
        return report.outcome

    def walk(self, n):
        for _ in range(n):
            self.advance()
        return self


def shifted(T, metres):
    """A relative pose that is wrong by so much."""
    return T + np.array([metres, 0, 0, 0, 0, 0, 0])


def drift(story):
    return next(g.value for g in story.candidates[-1].gates if g.name == "drift")


def test_covariance_of_two_motions_is_that_of_samples():
    rng = np.random.default_rng(0)
    a, b = (from_tangent(T, C) for T, C in zip(circle(2, start=3), (STEP, LOOP)))
    both = a.then(b)

    def sample(motion, n=20_000):
        xi = rng.multivariate_normal(np.zeros(6), motion.covariance, n)
        return poses.compose(np.concatenate([xi[:, :3], so3.exp(xi[:, 3:])], 1), motion.T_a_b)

    apart = poses.correction(poses.compose(sample(a), sample(b)), both.T_a_b)
    xi = np.concatenate([apart[:, :3], so3.log(apart[:, 3:])], 1)
    np.testing.assert_allclose(np.cov(xi.T), both.covariance, atol=0.04 * both.covariance.max())


def test_tangent_and_twist_say_the_same():
    A = np.random.default_rng(1).normal(size=(6, 6))
    T = circle(1, start=7)[0]
    np.testing.assert_allclose(tangent_covariance(from_tangent(T, A @ A.T)), A @ A.T, atol=1e-12)


def test_a_way_is_the_motions_along_it():
    story = Story(circle(30)).walk(30)
    direct = relation(story.node, 5, 25)
    along = Motion(poses.IDENTITY, np.zeros((6, 6)))
    for k in range(6, 26):
        along = along.then(from_tangent(poses.between(story.T[k - 1], story.T[k]), STEP))
    np.testing.assert_allclose(direct.T_a_b, along.T_a_b, atol=1e-12)
    np.testing.assert_allclose(direct.covariance, along.covariance, atol=1e-12)
    back = relation(story.node, 25, 5)
    there_and_back = direct.then(Motion(back.T_a_b, np.zeros((6, 6))))
    np.testing.assert_allclose(there_and_back.T_a_b, poses.IDENTITY, atol=1e-12)
    np.testing.assert_allclose(relation(story.node, 9, 9).covariance, 0, atol=1e-18)


def test_the_distance_of_consistent_loops_has_six_degrees_of_freedom():
    rng = np.random.default_rng(2)
    P = from_tangent(circle(1, start=4)[0], STEP)
    squared = []
    for _ in range(2000):
        xi = rng.multivariate_normal(np.zeros(6), P.covariance + LOOP)
        T = poses.compose(np.concatenate([xi[:3], so3.exp(xi[3:])]), P.T_a_b)
        squared.append(consistency.distance(Motion(T, LOOP), P) ** 2)
    assert np.mean(squared) == pytest.approx(6.0, abs=0.4)


def test_a_wrong_room_is_refused_however_many_agree():
    story = Story(circle(3 * LAP)).walk(2 * LAP)
    aside = [story.advance(k, shifted(poses.between(story.T[k], story.T[2 * LAP + k]), 5.0)) for k in range(12)]
    assert set(aside) == {LoopOutcome.INCONSISTENT}
    assert drift(story) > 2 * PARAMS.max_drift
    assert story.advance(12) is LoopOutcome.ACCEPTED  # and the right one is welcome


def test_agreement_cannot_be_had_from_loops_that_the_bound_refuses():
    story = Story(circle(3 * LAP)).walk(2 * LAP)
    for k in range(4):
        story.advance(k, shifted(poses.between(story.T[k], story.T[2 * LAP + k]), 5.0))
    assert all(g.value == 0 for c in story.candidates for g in c.gates if g.name == "agreement")


def drifted(sigmas):
    """A second lap that is off to one side by so much, and loops that know."""
    T = circle(2 * LAP)
    sigma = np.sqrt(relation(Story(T).walk(LAP + 1).node, 0, LAP).covariance[2, 2])
    T[LAP:, 2] += sigmas * sigma
    return Story(T, true=circle(2 * LAP)).walk(LAP)


def test_a_surprising_loop_waits_until_others_ask_for_the_same():
    story = drifted(5.0)
    assert [story.advance(k) for k in range(4)] == [LoopOutcome.UNCONFIRMED] * 2 + [LoopOutcome.ACCEPTED] * 2
    lone = drifted(5.0)
    lone.advance(0)
    lone.walk(PARAMS.agreement_span)
    assert lone.advance(PARAMS.agreement_span + 1) is LoopOutcome.UNCONFIRMED  # the other was too long ago


def test_a_loop_within_the_bound_waits_for_nobody():
    assert drifted(2.0).advance(0) is LoopOutcome.ACCEPTED
    assert drifted(9.0).advance(0) is LoopOutcome.INCONSISTENT


def test_what_disagrees_does_not_confirm():
    story = Story(circle(3 * LAP), replace(PARAMS, sure_drift=0.0, max_drift=100.0)).walk(LAP)
    for k in range(6):  # each to another side
        T = poses.between(story.T[k], story.T[LAP + k])
        assert story.advance(k, shifted(T, 0.4 * (-1) ** k * (k + 1))) is LoopOutcome.UNCONFIRMED


def test_a_second_session_is_joined_by_loops_that_agree_and_held_to_them_from_then_on():
    story = Story(np.concatenate([circle(LAP), circle(LAP)]), breaks=(0, LAP)).walk(LAP)
    outcomes = [story.advance(k) for k in range(4)]
    assert outcomes == [LoopOutcome.UNCONFIRMED] * 2 + [LoopOutcome.ACCEPTED] * 2
    assert relation(story.node, 3, LAP + 3) is not None and relation(story.node, 3, LAP) is None
    aside = shifted(poses.between(story.T[4], story.T[LAP + 4]), 3.0)
    assert story.advance(4, aside) is LoopOutcome.INCONSISTENT


def test_after_loops_that_agree_only_the_drift_since_counts():
    def spread(story):
        return relation(story.node, 20, len(story.nodes) - 1).spread_m2

    without, with_loops = (Story(circle(4 * LAP)).walk(2 * LAP) for _ in range(2))
    for k in range(20):
        without.advance()
        with_loops.advance(k)
    assert spread(with_loops) < 0.1 * spread(without)


def test_a_loop_that_nobody_confirms_tightens_nothing():
    alone, none = (Story(circle(4 * LAP)).walk(2 * LAP) for _ in range(2))
    assert alone.advance(0) is LoopOutcome.ACCEPTED
    none.advance()
    a, b = (relation(s.node, 0, 2 * LAP) for s in (alone, none))
    np.testing.assert_array_equal(a.covariance, b.covariance)


def test_without_the_gate_everything_is_as_before():
    story = Story(circle(3 * LAP), replace(PARAMS, consistency=False)).walk(2 * LAP)
    aside = shifted(poses.between(story.T[0], story.T[2 * LAP]), 5.0)
    assert story.advance(0, aside) is LoopOutcome.ACCEPTED
    assert story.candidates[-1].gates == ()
