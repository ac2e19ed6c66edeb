from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from loop_world import ODOMETRY, keyframe, pose, remembered, vocabulary

from vins_core import params as parameters
from vins_core.geometry import poses
from vins_core.loop import step
from vins_core.loop.consistency import Motion, from_tangent, tangent_covariance
from vins_core.loop.presets import PRESETS
from vins_core.loop.rejudge import LIMITS, rejudge, smallest_change
from vins_core.params import DECLARATIONS, Loop, Params
from vins_core.report import LoopOutcome

GAP = 5
PARAMS = Loop(min_gap=GAP)
PATH = [(place, i) for place in range(6) for i in range(4)]


def lap(n=None, noise_px=0.7, seed=0):
    """Keyframes past six places, four at each, a little further and turned with every one."""
    return [
        keyframe(
            pose((0.15 * i, 0.1 * i, 0.0), yaw_deg=4.0 * i),
            place=place,
            number=number,
            noise_px=noise_px,
            flips=10,
            seed=seed,
        )
        for number, (place, i) in enumerate(PATH[:n])
    ]


@pytest.fixture(scope="module")
def state():
    return remembered(lap())


@pytest.fixture(scope="module")
def again():
    return keyframe(pose((0.2, 0.0, 0.05), yaw_deg=5), place=2, number=99, noise_px=0.7, flips=10, seed=1)


def test_a_place_seen_before_is_found_and_a_new_one_is_not(state, again):
    report = step.detect(PARAMS, state, again)
    assert report.outcome is LoopOutcome.ACCEPTED
    assert PATH[report.accepted.match][0] == 2
    elsewhere = keyframe(pose(), place=30, number=99)
    assert step.detect(PARAMS, state, elsewhere).outcome is LoopOutcome.FEW_MATCHES
    by_score = replace(PARAMS, score="absolute", min_score=0.1)
    assert step.detect(by_score, state, elsewhere).outcome is LoopOutcome.NOT_SIMILAR
    assert step.detect(by_score, state, again).outcome is LoopOutcome.ACCEPTED


def test_scores_are_judged_against_that_of_the_previous_keyframe(state):
    """The image before shows the same, so that a place that shares little with both cannot be the same."""
    before, now = (keyframe(pose((0.1 * i, 0, 0)), place=30, number=98 + i, flips=10, seed=i) for i in (0, 1))
    report = step.detect(replace(PARAMS, min_score_ratio=0.3), step.remember(state, before), now)
    assert report.outcome is LoopOutcome.NOT_SIMILAR
    ratio = next(g for g in report.candidates[0].gates if g.name == "score").value
    assert ratio == report.candidates[0].score / report.neighbour_score


def test_the_best_score_is_verified_first_and_nothing_after_a_loop(state, again):
    report = step.detect(PARAMS, state, again)
    scores = [c.score for c in report.candidates]
    assert scores == sorted(scores, reverse=True) and report.candidates[0].accepted
    assert all(c.matches is None and c.outcome is LoopOutcome.NOT_CHOSEN for c in report.candidates[1:])


def test_evaluating_everything_changes_no_decision(state, again):
    for query in (again, keyframe(pose(), place=30, number=99)):
        hasty, thorough = (step.detect(PARAMS, state, query, every) for every in (False, True))
        assert (hasty.outcome, hasty.gates) == (thorough.outcome, thorough.gates)
        for a, b in zip(hasty.candidates, thorough.candidates, strict=True):
            assert (a.match, a.outcome) == (b.match, b.outcome) and b.gates[: len(a.gates)] == a.gates


def test_recent_keyframes_are_never_candidates():
    state = step.begin(vocabulary().limits)
    for here in [keyframe(pose(), number=i, seed=i) for i in range(GAP + 3)]:  # the same place all the time
        report = step.detect(PARAMS, state, here)
        n = len(state)
        assert {c.match for c in report.candidates} <= set(range(max(n - GAP, 0)))
        assert (report.outcome is LoopOutcome.ACCEPTED) == (n > GAP)
        assert report.outcome in (LoopOutcome.ACCEPTED, LoopOutcome.TOO_RECENT)
        state = step.remember(state, here)


def test_parity_verifies_the_oldest_candidate_only(state, again):
    oldest = replace(PARAMS, order="oldest", score="absolute")
    report = step.detect(oldest, state, again, evaluate_all=True)
    best = step.detect(PARAMS, state, again, evaluate_all=True)
    assert report.accepted.match == min(c.match for c in best.candidates if c.gates[1].passed)
    others = [c for c in report.candidates if not c.accepted]
    assert others and all(c.outcome is LoopOutcome.NOT_CHOSEN for c in others)


def test_an_image_without_points_is_not_distinctive(state):
    blank = replace(keyframe(pose(), number=99), bag=vocabulary().bag_of(np.zeros((0, 32), np.uint8)))
    assert step.detect(PARAMS, state, blank).outcome is LoopOutcome.NOT_DISTINCTIVE


def test_too_few_landmarks_are_told_first(state):
    poor = keyframe(pose(), place=2, number=99, n_landmarks=10)
    assert step.detect(PARAMS, state, poor).outcome is LoopOutcome.FEW_LANDMARKS


def test_any_pair_can_be_asked_about(state, again):
    state = step.remember(state, again)
    query = len(state) - 1
    report = step.examine(PARAMS, state, query, 0)  # another place, that retrieval never proposed
    (found,) = report.candidates
    assert not found.accepted and found.outcome is LoopOutcome.NOT_CHOSEN
    assert next(g for g in found.gates if g.name == "rank").value > PARAMS.candidates
    detected = step.detect(PARAMS, remembered(lap()), again).accepted
    (asked,) = step.examine(PARAMS, state, query, detected.match).candidates
    assert asked.gates == detected.gates and asked.accepted


def test_only_earlier_keyframes_can_be_asked_about(state):
    for query, match in ((3, 3), (2, 3), (len(state), 0), (3, -1)):
        with pytest.raises(IndexError, match="expected"):
            step.examine(PARAMS, state, query, match)


def test_a_fork_appends_to_a_list_of_its_own(state, again):
    early = remembered(lap(8))
    main, fork = step.remember(early, again), step.remember(early, lap(9)[8])
    assert len(main) == len(fork) == 9
    assert main.keyframes[8].descriptors is again.descriptors is not fork.keyframes[8].descriptors
    assert main.keyframes[7] is fork.keyframes[7]
    assert step.remember(main, lap(9)[8]).keyframes is main.keyframes


def test_thinning_leaves_out_what_its_gates_say():
    """VINS' start-up, thinning and spacing (REFERENCE L3, L4)."""
    used, state = [], step.begin(vocabulary().limits)
    thin = Loop(skip_first=2, every=3, min_spacing_m=0.0)
    for k in lap(12):
        state, gates = step.admit(thin, state, k.T_w_b)
        if all(g.passed for g in gates):
            used.append(k.frame)
            state = step.remember(state, k)
    assert used == [2, 5, 8, 11]
    first = lap(1)[0]
    state = step.remember(step.begin(vocabulary().limits), first)
    _, gates = step.admit(Loop(min_spacing_m=0.5), state, np.add(first.T_w_b, [0.2, 0.2, 0.2, 0, 0, 0, 0]))
    assert [g.name for g in gates if not g.passed] == ["spacing"]


def random_limits(rng):
    """Limits near where decisions are, drawn at random."""
    return {
        "loop.candidates": int(rng.integers(1, 5)),
        "loop.order": str(rng.choice(["best", "oldest"])),
        "loop.score": str(rng.choice(["relative", "absolute"])),
        "loop.min_score_ratio": float(rng.uniform(0, 1)),
        "loop.min_score": float(rng.uniform(0.01, 0.4)),
        "loop.min_neighbour_score": float(rng.uniform(0, 0.4)),
        "loop.min_matches": int(rng.integers(6, 60)),
        "loop.min_epipolar": int(rng.integers(6, 60)),
        "loop.min_inliers": int(rng.integers(6, 60)),
        "loop.max_rms_px": float(rng.uniform(0.5, 3)),
        "loop.max_sigma_m": float(rng.uniform(0.001, 0.03)),
        "loop.max_tilt_deg": float(rng.uniform(0.1, 1.0)),
        "loop.max_heading_deg": float(rng.uniform(1, 15)),
        "loop.max_distance_m": float(rng.uniform(0.1, 0.6)),
    }


def test_other_limits_judged_from_the_gates_decide_as_a_run_with_them(state, again):
    consistency = {"loop.consistency", "loop.drift_inflation", "loop.max_drift"}  # test_loop_consistency.py
    consistency |= {"loop.sure_drift", "loop.min_agreement", "loop.agreement_span"}
    assert {f"loop.{name}" for name in LIMITS} - consistency == set(random_limits(np.random.default_rng(0)))
    queries = [again, *(keyframe(k.T_w_b, place=p, number=50 + p, noise_px=1.0, flips=20, seed=3)
                        for p, k in zip(range(6), lap(6)))]  # fmt: skip
    recorded = [step.detect(PARAMS, state, q, evaluate_all=True) for q in queries]
    rng, changed = np.random.default_rng(5), 0
    for _ in range(40):
        chosen = random_limits(rng)
        some = {k: chosen[k] for k in rng.permutation(list(chosen))[: rng.integers(1, 5)]}
        params = parameters.replace(Params(), {"loop.min_gap": GAP} | some).loop
        for query, report in zip(queries, recorded):
            told, run = rejudge(params, state.limits, report), step.detect(params, state, query)
            assert (told.accepted and told.accepted.match) == (run.accepted and run.accepted.match)
            assert told.gates == run.gates and told.outcome is run.outcome
            changed += (report.accepted is None) != (run.accepted is None)
    assert changed > 20


def test_a_report_that_stopped_early_cannot_be_judged_again(state, again):
    with pytest.raises(ValueError, match="evaluate_all"):
        rejudge(PARAMS, state.limits, step.detect(PARAMS, state, again))


def test_the_smallest_change_is_just_enough(state, again):
    strict = replace(PARAMS, min_matches=58, max_distance_m=0.1, max_sigma_m=0.001, candidates=2)
    recorded = step.detect(strict, state, again, evaluate_all=True)
    assert recorded.accepted is None
    change = smallest_change((*recorded.gates, *recorded.candidates[0].gates))
    assert {"loop.max_distance_m", "loop.max_sigma_m"} <= set(change)
    base = {f"loop.{name}": getattr(strict, name) for name in ("min_gap", "min_matches", "candidates")}
    base |= {"loop.max_distance_m": 0.1, "loop.max_sigma_m": 0.001}
    enough = parameters.replace(Params(), base | change).loop
    told, run = rejudge(enough, state.limits, recorded).accepted, step.detect(enough, state, again).accepted
    assert told.match == run.match == recorded.candidates[0].match
    for key in change:
        without = parameters.replace(Params(), base | {k: v for k, v in change.items() if k != key}).loop
        found = rejudge(without, state.limits, recorded).candidates[0]
        assert not found.accepted


def test_no_change_helps_where_nothing_was_measured(state):
    report = step.examine(PARAMS, state, 20, 0)  # two places
    assert smallest_change(report.candidates[0].gates) is None


@pytest.mark.parametrize("name", list(PRESETS))
def test_presets_are_valid_settings_of_the_loop_stage(name, state, again):
    settings = PRESETS[name]
    assert set(settings) <= {k for k in DECLARATIONS if k.startswith("loop.")}
    params = parameters.replace(Params(), settings | {"loop.min_gap": GAP}).loop
    assert step.detect(params, state, again).outcome is LoopOutcome.ACCEPTED


def test_the_motion_since_the_last_keyframe_used_passes_over_those_left_out():
    laps, thin, state = lap(12), Loop(every=3), step.begin(vocabulary().limits)
    used = []
    for number, k in enumerate(laps):
        state, judged = step.admit(thin, state, k.T_w_b, ODOMETRY if number else None)
        if all(g.passed for g in judged):
            used.append(step.odometry(state))
            state = step.remember(state, replace(k, odometry=used[-1]))
    assert used[0] is None and len(used) == 4
    along = Motion(poses.IDENTITY, np.zeros((6, 6)))
    for a, b in pairwise(laps[:4]):
        along = along.then(from_tangent(poses.between(a.T_w_b, b.T_w_b), ODOMETRY))
    np.testing.assert_allclose(used[1], tangent_covariance(along), rtol=1e-9, atol=1e-15)


def test_a_session_that_odometry_does_not_join_begins_a_tree_of_its_own():
    state = remembered(lap(3))
    state, _ = step.admit(PARAMS, state, lap(4)[3].T_w_b, None)
    assert step.odometry(state) is None
    state = step.remember(state, replace(lap(4)[3], odometry=None))
    assert state.node(2).odometry.tree == 0 and state.node(3).odometry.tree == 3
